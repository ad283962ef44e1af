r"""Pictures of a hand in the pose given by its joint angles."""

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
# Margins relative to the extent of the hand; the lower margin has space for names.
_MARGIN, _LOWER_MARGIN = 0.048, 0.072


def open_hand(kinematics: HandKinematics) -> Tensor:
    r"""Returns the joint angles of an open hand, as drawn in figures and in the viewer. Each angle
    is zero, or the limit nearest to zero. The thumb of an Allegro hand is turned so that its pads
    are visible.

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
    r"""Draws the taxels of a hand in the pose given by its joint angles, without perspective.

    The default view is along the negative :math:`x` axis of the root link, with :math:`y` to the
    right and :math:`z` up. For an Allegro hand, this shows the palm with the fingertips up.

    Edges within a patch are grey, edges between patches are orange, and an edge without its reverse
    is an arrow. With :obj:`edge_value`, the half of a line next to a taxel has the colour of the
    edge to that taxel, and taxels are small and plain unless they have a :obj:`value`.

    Args:
        layout (TaxelLayout): The layout; its links are links of the hand.
        kinematics (HandKinematics, optional): The hand (default: the right Allegro hand).
        joint (torch.Tensor, optional): Joint angles of one frame in radians (default:
            :func:`open_hand`).
        adjacency (str or torch.Tensor, optional): Edges to draw below the taxels: the name of an
            adjacency of the layout, or directed edges.
        value (torch.Tensor, optional): Values that determine the colours of the taxels instead of
            :obj:`color_by`. Taxels with a missing value (NaN) are plain with a dashed outline.
        edge_value (torch.Tensor, optional): Values that determine the colours of the edges of
            :obj:`adjacency`.
        ax (matplotlib.axes.Axes, optional): Axes to draw on (default: a new figure).
        color_by (str): Segments of one colour: :obj:`"patch"` (tints of the colour of the digit) or
            :obj:`"digit"`.
        names (str, optional): Segments to name below their taxels: :obj:`"patch"` or
            :obj:`"digit"`.
        azimuth (float): Azimuth of the viewer about the :math:`z` axis of the root link, in
            degrees. At 90 degrees, the view is along negative :math:`y`.
        elevation (float): Elevation of the viewer in degrees. At 90 degrees, the view is along
            negative :math:`z`.
        limits (tuple of float, optional): Values at the ends of the colour scale (default: lowest
            and highest value).
        cmap (str): Name of a matplotlib colour map, or :obj:`"sequential"` or :obj:`"diverging"`
            for a colour map of the theme.
        label (str, optional): Label of the colour bar. With :obj:`None`, there is no colour bar.
        edge_limits (tuple of float, optional): Like :obj:`limits`, for the edges.
        edge_cmap (str): Like :obj:`cmap`, for the edges.
        edge_label (str, optional): Like :obj:`label`, for the edges.
        title (str, optional): Title of the picture.

    Shapes:
        - **joint:** :math:`(J,)`
        - **adjacency:** directed edges :math:`(2, |\mathcal{E}|)`; each pair is drawn once
        - **value:** one per taxel :math:`(N,)`
        - **edge_value:** one per directed edge :math:`(|\mathcal{E}|,)`

    Raises:
        ImportError: If matplotlib is missing.
        ValueError: If the shape of :obj:`joint`, :obj:`adjacency`, :obj:`value` or
            :obj:`edge_value` does not fit, if the hand lacks a link of the layout, if
            :obj:`limits` are not increasing, or if :obj:`color_by` or :obj:`names` is unknown.

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
            raise ValueError("'adjacency' must be given with 'edge_value' (got none)")
        edge_value = checked_values("edge_value", edge_value, edge_index.size(-1))
        edge_value = edge_value[(edge_index[0] != edge_index[1]).cpu()]  # no self-loops
    if edge_index is not None:
        edge_index = checked_edges("adjacency", edge_index, layout.num_taxels)
    edge_scale = value_scale(edge_value, edge_limits, edge_cmap)
    kinematics = HandKinematics.allegro() if kinematics is None else kinematics
    pos = _taxel_positions(layout, kinematics, joint)
    plane, depth = _project(pos, azimuth, elevation)
    # The diameter is relative to the spacing of the taxels, so that edges stay visible.
    relative_diameter = 0.845 if edge_index is None else 0.42
    if edge_value is not None and value is None:
        relative_diameter = 0.2
    diameter = relative_diameter * _spacing(pos)
    corners = _corners(plane, pos)
    if ax is None:
        width, height = (corners[1] - corners[0]).tolist()
        num_bars = (value is not None and label is not None) + (
            edge_value is not None and edge_label is not None
        )
        figure_height = 7.0 * min(max(height / width, 0.4), 1.6) + 0.3
        ax = new_figure(7.0 + 0.9 * num_bars, figure_height).add_subplot()

    if value is not None:
        colors = value_colors(value, scale)
    else:
        colors = _plain_colors(layout, color_by if edge_value is None else None)
    missing = [False] * layout.num_taxels if value is None else value.isnan().tolist()
    if edge_index is not None and edge_value is None:
        _draw_edges(ax, plane, edge_index, layout)
    elif edge_index is not None and edge_value is not None:
        _draw_edge_values(ax, plane, edge_index, edge_value, edge_scale, 1.8)
    order = depth.argsort(stable=True).tolist()  # near taxels cover distant taxels
    draw_taxels(
        ax,
        plane[order],
        diameter,
        [colors[i] for i in order],
        [missing[i] for i in order],
        current_theme().outline,
        0.45,
    )
    if names is not None:
        _draw_names(ax, plane, diameter, layout, names)
    bar_scale = None if value is None else scale
    finish_map(ax, corners.tolist(), 6, title, bar_scale, label)
    if edge_value is not None and edge_label is not None:
        draw_color_bar(ax, edge_scale, edge_label)
    return ax.figure.figure


def _plain_colors(
    layout: TaxelLayout, color_by: Literal["patch", "digit"] | None
) -> list[tuple[float, ...]]:
    # The colours of taxels without values: the colours of their segments, or of the theme.
    from matplotlib.colors import to_rgba

    if color_by is None:
        return [to_rgba(current_theme().plain)] * layout.num_taxels
    return [to_rgba(color) for color in segment_colors(layout, color_by)]


def _taxel_positions(
    layout: TaxelLayout, kinematics: HandKinematics, joint: Tensor | None
) -> Tensor:
    # In millimetres.
    joint = torch.as_tensor(open_hand(kinematics) if joint is None else joint).detach().cpu()
    if joint.shape != (kinematics.num_joints,):
        raise ValueError(
            f"'joint' must be one frame with shape ({kinematics.num_joints},) "
            f"(got {tuple(joint.shape)})"
        )
    return kinematics.taxel_pose(layout, joint).pos.double() * 1e3


def _project(pos: Tensor, azimuth: float, elevation: float) -> tuple[Tensor, Tensor]:
    view_pos = pos @ torch.from_numpy(view_axes(azimuth, elevation)).to(pos).T
    # Depth is rounded to a nanometre, so that rounding errors do not order taxels of equal depth.
    return view_pos[:, :2], view_pos[:, 2].mul(1e6).round()


def _spacing(pos: Tensor) -> float:
    if len(pos) < 2:
        return 4.0
    # Spacing is measured in space, not in the plane, so that circles have the same size in all
    # views.
    nearest = torch.cdist(pos, pos).fill_diagonal_(torch.inf).amin(dim=1)
    extent = float((pos.amax(dim=0) - pos.amin(dim=0)).max())
    return max(float(nearest.median()), extent / 100) or 4.0


def _corners(plane: Tensor, pos: Tensor) -> Tensor:
    low, high = plane.amin(dim=0), plane.amax(dim=0)
    extent = max(float((high - low).max()), 2 * _spacing(pos))
    lower_margin = low.new_tensor([_MARGIN, _LOWER_MARGIN])
    return torch.stack([low - extent * lower_margin, high + extent * _MARGIN])


def _draw_names(
    ax: "Axes", plane: Tensor, diameter: float, layout: TaxelLayout, by: Literal["patch", "digit"]
) -> None:
    segments = layout.segments(by)
    for i, name in enumerate(layout.patch_names if by == "patch" else layout.digit_names):
        segment = plane[segments == i]
        if len(segment):
            low, high = segment.amin(dim=0), segment.amax(dim=0)
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
    r"""Draws each pair of opposite edges as one line, which is grey within a patch and orange
    between patches. Edges without their reverse are drawn as arrows.

    Shapes:
        - **plane:** positions in the plane in millimetres :math:`(N, 2)`
        - **edge_index:** directed edges :math:`(2, |\mathcal{E}|)`
    """
    from matplotlib.collections import LineCollection
    from matplotlib.patches import FancyArrowPatch

    theme = current_theme()
    within_patches, between_patches, arrows = _group_edges(edge_index, layout)
    for pairs, color, kind in (
        (within_patches, theme.soft, "within a patch"),
        (between_patches, theme.join, "between patches"),
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
                color=theme.one_way,
                linewidth=1.6,
                zorder=3,
                label="one way only" if i == 0 else None,
            )
        )


def _draw_edge_values(
    ax: "Axes", plane: Tensor, edge_index: Tensor, value: Tensor, scale: Any, linewidth: float
) -> None:
    r"""Draws each directed edge in the colour of its value: the half next to its target, or the
    full line if the edge has no reverse.

    Shapes:
        - **plane:** positions in the plane in millimetres :math:`(N, 2)`
        - **edge_index:** directed edges :math:`(2, |\mathcal{E}|)`
        - **value:** values of the edges :math:`(|\mathcal{E}|,)`
    """
    from matplotlib.collections import LineCollection

    source, target = edge_index
    has_reverse = _has_reverse(source, target, len(plane)).view(-1, 1)
    start = torch.where(has_reverse, (plane[source] + plane[target]) / 2, plane[source])
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


def _has_reverse(source: Tensor, target: Tensor, num_taxels: int) -> Tensor:
    return torch.isin(target * num_taxels + source, source * num_taxels + target)


def _group_edges(edge_index: Tensor, layout: TaxelLayout) -> tuple[Tensor, Tensor, Tensor]:
    # Returns pairs within a patch, pairs between patches, and edges without their reverse (n, 2).
    num_taxels = layout.num_taxels
    source, target = checked_edges("adjacency", edge_index, num_taxels).unique(dim=1)
    has_reverse = _has_reverse(source, target, num_taxels)
    edges = torch.stack([source, target], dim=1)
    pairs = edges[has_reverse & (source < target)]
    patch = layout.segments("patch")[pairs]
    is_within = patch[:, 0] == patch[:, 1]
    return pairs[is_within], pairs[~is_within], edges[~has_reverse]
