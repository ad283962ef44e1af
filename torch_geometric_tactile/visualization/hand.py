r"""Pictures of a whole hand in the pose of its joints."""

from typing import TYPE_CHECKING, Any, Literal

import torch
from torch import Tensor

from torch_geometric_tactile.sensors import HandKinematics, TaxelLayout
from torch_geometric_tactile.sensors._views import open_angles
from torch_geometric_tactile.visualization._style import TEXT, current_theme, new_figure, plain_text
from torch_geometric_tactile.visualization._taxel_map import (
    checked_edges,
    checked_values,
    draw_color_bar,
    draw_taxels,
    finish_map,
    segment_colors,
    value_colors,
    value_scale,
    view_axes,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_NAME_SIZES = {"patch": 6.5, "digit": TEXT + 0.5}  # points
# In shares of the extent; names are drawn in the lower one.
_MARGIN, _LOWER_MARGIN = 0.048, 0.072


def open_hand(kinematics: HandKinematics) -> Tensor:
    r"""Returns the joint angles of an open hand, as figures and the viewer draw it: all angles
    zero, or the limit next to it, and an Allegro hand's thumb turned so that its pads are seen.

    Args:
        kinematics (HandKinematics): The hand.

    Shapes:
        - **output:** joint angles in radians :math:`(J,)`

    Examples:
        >>> open_hand(HandKinematics.allegro())[12:]
        tensor([0.2630, 1.1000, 0.0000, 0.0000])
    """
    return open_angles(kinematics)


def plot_hand(
    layout: TaxelLayout,
    kinematics: HandKinematics | None = None,
    joint: Tensor | None = None,
    adjacency: str | Tensor | None = None,
    value: Tensor | None = None,
    edge_value: Tensor | None = None,
    *,
    ax: "Axes | None" = None,
    color_by: Literal["patch", "digit"] = "digit",
    names: Literal["patch", "digit"] | None = None,
    azimuth: float = 0.0,
    elevation: float = 0.0,
    limits: tuple[float, float] | None = None,
    cmap: str = "sequential",
    label: str | None = "reading",
    edge_limits: tuple[float, float] | None = None,
    edge_cmap: str = "plasma",
    edge_label: str | None = "edge value",
    title: str | None = None,
) -> "Figure":
    r"""Draws the taxels of a hand in the pose of its joints, without perspective.

    The viewer looks against the root link's :math:`x` axis, which for an Allegro hand points out of
    the palm: with :math:`y` to the right and :math:`z` up, its palm is seen with the fingertips up.
    Edges within a patch are grey, edges between patches orange, and an edge without its reverse is
    an arrow. With :obj:`edge_value`, the half of a line next to a taxel has the colour of the edge
    to that taxel, and taxels are small and plain unless :obj:`value` colours them.

    Args:
        layout (TaxelLayout): The layout; its links are links of the hand.
        kinematics (HandKinematics, optional): The hand. The right Allegro hand if left out.
        joint (torch.Tensor, optional): Joint angles of one frame in radians; :func:`open_hand` if
            left out.
        adjacency (str or torch.Tensor, optional): Edges to draw below the taxels: the name of an
            adjacency of the layout, or directed edges.
        value (torch.Tensor, optional): Values that colour the taxels, instead of :obj:`color_by`; a
            missing value (NaN) stays plain with a dashed outline.
        edge_value (torch.Tensor, optional): What colours the edges of :obj:`adjacency`.
        ax (matplotlib.axes.Axes, optional): Where to draw. A new figure if left out.
        color_by (str): Which taxels share a colour, those of a :obj:`"patch"` (tints of its digit's
            colour) or of a :obj:`"digit"`.
        names (str, optional): What to name below its taxels, each :obj:`"patch"` or each
            :obj:`"digit"`.
        azimuth (float): How far the viewer walks around the root link's :math:`z` axis, in degrees;
            at 90 the view is against :math:`y`.
        elevation (float): How far the viewer rises, in degrees; at 90 the view is against
            :math:`z`.
        limits (tuple of float, optional): Values at the ends of the colour scale; lowest and
            highest value if left out.
        cmap (str): Name of matplotlib's colour map, or :obj:`"sequential"` or :obj:`"diverging"`
            for that of all pictures.
        label (str, optional): Label of the colour bar. No colour bar if :obj:`None`.
        edge_limits (tuple of float, optional): As :obj:`limits`, of the edges.
        edge_cmap (str): As :obj:`cmap`, of the edges.
        edge_label (str, optional): As :obj:`label`, of the edges.
        title (str, optional): Title of the picture.

    Shapes:
        - **joint:** :math:`(J,)`
        - **adjacency:** directed edges :math:`(2, |\mathcal{E}|)`; each pair is drawn once
        - **value:** one per taxel :math:`(N,)`
        - **edge_value:** one per directed edge :math:`(|\mathcal{E}|,)`

    Raises:
        ImportError: If matplotlib is missing.
        ValueError: If :obj:`joint`, :obj:`adjacency`, :obj:`value` or :obj:`edge_value` does not
            fit, a link of the layout is not one of the hand, :obj:`limits` do not rise, or
            :obj:`color_by` or :obj:`names` is unknown.

    Examples:
        >>> from torch_geometric_tactile.sensors import allegro_uskin
        >>> figure = plot_hand(allegro_uskin(), value=torch.rand(384), label="force (N)")
        >>> [ax.get_ylabel() for ax in figure.axes]  # the hand and its colour bar
        ['mm', 'force (N)']
    """
    for key, by in (("color_by", color_by), ("names", names)):
        if by not in _NAME_SIZES and not (key == "names" and by is None):
            raise ValueError(f"'{key}' must be 'patch' or 'digit' (got '{by}')")
    if value is not None:
        value = checked_values("value", value, layout.num_taxels)
    scale = value_scale(value, limits, cmap)
    edge_index = layout.edge_index(adjacency) if isinstance(adjacency, str) else adjacency
    if edge_value is not None:
        if edge_index is None:
            raise ValueError("'adjacency' must be given where 'edge_value' is (got none)")
        edge_value = checked_values("edge_value", edge_value, edge_index.size(-1))
        edge_value = edge_value[(edge_index[0] != edge_index[1]).cpu()]  # no self-loops
    if edge_index is not None:
        edge_index = checked_edges("adjacency", edge_index, layout.num_taxels)
    edge_scale = value_scale(edge_value, edge_limits, edge_cmap)
    kinematics = HandKinematics.allegro() if kinematics is None else kinematics
    pos = _taxel_places(layout, kinematics, joint)
    plane, depth = _view(pos, azimuth, elevation)
    share = 0.845 if edge_index is None else 0.42
    if edge_value is not None and value is None:
        share = 0.2
    diameter = share * _spacing(pos)
    corners = _corners(plane, pos)
    if ax is None:
        width, height = (corners[1] - corners[0]).tolist()
        bars = (value is not None and label is not None) + (
            edge_value is not None and edge_label is not None
        )
        tall = 7.0 * min(max(height / width, 0.4), 1.6) + 0.3
        ax = new_figure(7.0 + 0.9 * bars, tall).add_subplot()

    from matplotlib.colors import to_rgba

    look = current_theme()
    missing = [False] * layout.num_taxels
    colors: list[tuple[float, ...]] = [to_rgba(look.plain)] * layout.num_taxels
    if value is not None:
        missing = value.isnan().tolist()
        colors = value_colors(value, scale)
    elif edge_value is None:
        colors = [to_rgba(color) for color in segment_colors(layout, color_by)]
    if edge_index is not None and edge_value is None:
        _draw_edges(ax, plane, edge_index, layout)
    elif edge_index is not None and edge_value is not None:
        _draw_edge_values(ax, plane, edge_index, edge_value, edge_scale, 1.8)
    order = depth.argsort(stable=True).tolist()
    draw_taxels(
        ax,
        plane[order],
        diameter,
        [colors[i] for i in order],
        [missing[i] for i in order],
        look.outline,
        0.45,
    )
    if names is not None:
        _draw_names(ax, plane, diameter, layout, names)
    shown = None if value is None else scale
    finish_map(ax, corners.tolist(), 6, title, shown, label)
    if edge_value is not None and edge_label is not None:
        draw_color_bar(ax, edge_scale, edge_label)
    return ax.figure.figure


def _taxel_places(layout: TaxelLayout, kinematics: HandKinematics, joint: Tensor | None) -> Tensor:
    joint = torch.as_tensor(open_hand(kinematics) if joint is None else joint).detach().cpu()
    if joint.shape != (kinematics.num_joints,):
        raise ValueError(
            f"'joint' must be one frame, of shape ({kinematics.num_joints},) "
            f"(got {tuple(joint.shape)})"
        )
    return kinematics.taxel_pose(layout, joint).pos.double() * 1e3


def _view(pos: Tensor, azimuth: float, elevation: float) -> tuple[Tensor, Tensor]:
    seen = pos @ torch.from_numpy(view_axes(azimuth, elevation)).to(pos).T
    # To a nanometre, so that rounding does not order taxels of one depth.
    return seen[:, :2], seen[:, 2].mul(1e6).round()


def _spacing(pos: Tensor) -> float:
    if len(pos) < 2:
        return 4.0
    # In space, not in the plane: circles keep their size while the viewer walks.
    nearest = torch.cdist(pos, pos).fill_diagonal_(torch.inf).amin(dim=1)
    extent = float((pos.amax(dim=0) - pos.amin(dim=0)).max())
    return max(float(nearest.median()), extent / 100) or 4.0


def _corners(plane: Tensor, pos: Tensor) -> Tensor:
    low, high = plane.amin(dim=0), plane.amax(dim=0)
    extent = max(float((high - low).max()), 2 * _spacing(pos))
    below = low.new_tensor([_MARGIN, _LOWER_MARGIN])
    return torch.stack([low - extent * below, high + extent * _MARGIN])


def _draw_names(
    ax: "Axes", plane: Tensor, diameter: float, layout: TaxelLayout, by: Literal["patch", "digit"]
) -> None:
    segments = layout.segments(by)
    for i, name in enumerate(layout.patch_names if by == "patch" else layout.digit_names):
        places = plane[segments == i]
        if len(places):
            low, high = places.amin(dim=0), places.amax(dim=0)
            ax.text(
                float(low[0] + high[0]) / 2,
                float(low[1]) - diameter,
                plain_text(name),
                fontsize=_NAME_SIZES[by],
                color=current_theme().ink,
                ha="center",
                va="top",
                zorder=4,
            )


def _draw_edges(ax: "Axes", plane: Tensor, edge_index: Tensor, layout: TaxelLayout) -> None:
    r"""Draws each pair once, in the colour of its kind, and edges without their reverse as arrows.

    Shapes:
        - **plane:** The taxels in the plane, in millimetres :math:`(N, 2)`.
        - **edge_index:** Directed edges :math:`(2, |\mathcal{E}|)`.
    """
    from matplotlib.collections import LineCollection
    from matplotlib.patches import FancyArrowPatch

    look = current_theme()
    pieces, joins, arrows = _sorted_edges(edge_index, layout)
    for pairs, color, kind in (
        (pieces, look.soft, "within a patch"),
        (joins, look.join, "between patches"),
    ):
        if len(pairs):
            ax.add_collection(
                LineCollection(
                    list(plane[pairs].numpy()), colors=color, linewidths=0.7, zorder=1, label=kind
                )
            )
    for i, (tail, head) in enumerate(plane[arrows].tolist()):
        ax.add_patch(
            FancyArrowPatch(
                tail,
                head,
                arrowstyle="-|>",
                mutation_scale=12,
                shrinkA=0,
                shrinkB=2,
                color=look.one_way,
                linewidth=1.6,
                zorder=3,
                label="one way only" if i == 0 else None,
            )
        )


def _draw_edge_values(
    ax: "Axes", plane: Tensor, edge_index: Tensor, value: Tensor, scale: Any, linewidth: float
) -> None:
    r"""Draws each directed edge in the colour of its value: the half next to its target, or all of
    it if it has no reverse.

    Shapes:
        - **plane:** The taxels in the plane, in millimetres :math:`(N, 2)`.
        - **edge_index:** Directed edges :math:`(2, |\mathcal{E}|)`.
        - **value:** Their values :math:`(|\mathcal{E}|,)`.
    """
    from matplotlib.collections import LineCollection

    source, target = edge_index
    returns = _returns(source, target, len(plane)).view(-1, 1)
    start = torch.where(returns, (plane[source] + plane[target]) / 2, plane[source])
    ax.add_collection(
        LineCollection(
            list(torch.stack([start, plane[target]], dim=1).numpy()),
            colors=scale.to_rgba(value.numpy()),
            linewidths=linewidth,
            capstyle="butt",
            zorder=1,
            label="edge value",
        )
    )


def _returns(source: Tensor, target: Tensor, num_taxels: int) -> Tensor:
    return torch.isin(target * num_taxels + source, source * num_taxels + target)


def _sorted_edges(edge_index: Tensor, layout: TaxelLayout) -> tuple[Tensor, Tensor, Tensor]:
    # Pairs within a patch, pairs between patches, and edges without their reverse, all (n, 2).
    num_taxels = layout.num_taxels
    source, target = checked_edges("adjacency", edge_index, num_taxels).unique(dim=1)
    returns = _returns(source, target, num_taxels)
    pairs = torch.stack([source, target], dim=1)
    both = pairs[returns & (source < target)]
    patch = layout.segments("patch")[both]
    within = patch[:, 0] == patch[:, 1]
    return both[within], both[~within], pairs[~returns]
