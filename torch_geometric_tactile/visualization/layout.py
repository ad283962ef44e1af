r"""Pictures of taxel layouts."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

from torch import Tensor

from torch_geometric_tactile.sensors import TaxelLayout
from torch_geometric_tactile.sensors._views import facing_sides, pads_side_by_side
from torch_geometric_tactile.visualization._style import (
    SMALL,
    current_theme,
    ink_on,
    new_figure,
    plain_text,
)
from torch_geometric_tactile.visualization._taxel_map import (
    checked_edges,
    checked_values,
    draw_taxels,
    figure_size,
    finish_map,
    map_corners,
    taxel_diameter,
    value_colors,
    value_scale,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


def layout_plane(layout: TaxelLayout) -> Tensor:
    r"""Returns the taxels projected onto the plane that faces the viewer of the pad. Pads on
    several links are placed side by side in the order of their links, as in the viewer.

    The mean normal of a pad points at the viewer. The two axes of the link frame with the largest
    angles to the normal point to the right and up. The origin is the origin of the link frame. With
    several links, the origin is at the left edge of the first pad, and every pad is centred
    vertically.

    Args:
        layout (TaxelLayout): The layout.

    Shapes:
        - **output:** positions in the plane in millimetres :math:`(N, 2)`

    Examples:
        >>> from torch_geometric_tactile.sensors import grid
        >>> layout_plane(grid(1, 3, pitch=0.002))
        tensor([[0., 0.],
                [2., 0.],
                [4., 0.]])
    """
    plane = layout.pos.new_zeros(layout.num_taxels, 2)
    pads = pads_side_by_side(layout)
    for taxels, axes, shift in pads:
        pos = layout.pos[taxels].double() @ axes.T + (shift if len(pads) > 1 else 0.0)
        plane[taxels] = (1e3 * pos[:, :2]).to(plane.dtype)
    return plane


def plot_layout(
    layout: TaxelLayout,
    values: Tensor | None = None,
    edge_index: Tensor | None = None,
    ax: "Axes | None" = None,
    *,
    limits: tuple[float, float] | None = None,
    cmap: str = "viridis",
    label: str | None = "reading",
    title: str | None = None,
    numbers: bool = True,
) -> "Figure":
    r"""Draws the taxels of a layout as circles, seen from the contact side of the pad.

    The picture is not mirrored, and its axes are named after the axes of the link frame. Pads on
    several links are drawn side by side, below the names of the links.

    Args:
        layout (TaxelLayout): The layout.
        values (torch.Tensor, optional): Values that determine the colours of the taxels. Taxels
            with a missing value (NaN) are white with a dashed outline.
        edge_index (torch.Tensor, optional): Edges to draw below the taxels.
        ax (matplotlib.axes.Axes, optional): Axes to draw on (default: a new figure).
        limits (tuple of float, optional): Values at the ends of the colour scale (default: lowest
            and highest value).
        cmap (str): Name of a matplotlib colour map.
        label (str, optional): Label of the colour bar. With :obj:`None`, there is no colour bar.
        title (str, optional): Title of the picture.
        numbers (bool): Whether to write the index of each taxel in the readings.

    Shapes:
        - **values:** one per taxel :math:`(N,)`
        - **edge_index:** directed edges :math:`(2, |\mathcal{E}|)`; each pair is drawn once

    Raises:
        ImportError: If matplotlib is missing.
        ValueError: If :obj:`values` or :obj:`edge_index` does not fit the layout, or
            :obj:`limits` are not increasing.

    Examples:
        >>> import torch
        >>> from torch_geometric_tactile.sensors import grid
        >>> figure = plot_layout(grid(2, 2, pitch=0.002), torch.arange(4.0), title="Pad")
        >>> figure.axes[0].get_title()
        'Pad'
    """
    if values is not None:
        values = checked_values("values", values, layout.num_taxels)
    edges = None if edge_index is None else _undirected_edges(edge_index, layout.num_taxels)
    scale = value_scale(values, limits, cmap)
    plane = layout_plane(layout)
    if ax is None:
        width, height = figure_size(plane, 5.0)
        ax = new_figure(width, height + 0.3).add_subplot()

    from matplotlib.collections import LineCollection
    from matplotlib.colors import to_rgba

    theme = current_theme()
    diameter = taxel_diameter(plane)
    colors: list[tuple[float, ...]] = [to_rgba(theme.band)] * layout.num_taxels
    missing = [False] * layout.num_taxels
    if values is not None:
        missing = values.isnan().tolist()
        colors = value_colors(values, scale)
    if edges is not None:
        ax.add_collection(
            LineCollection(
                list(plane[edges.T].numpy()), colors=theme.faint, linewidths=0.8, zorder=1
            )
        )
    draw_taxels(ax, plane, diameter, colors, missing, theme.outline, 0.5)
    if numbers:
        _draw_numbers(ax, plane, diameter, colors)
    bar_scale = None if values is None else scale
    finish_map(ax, map_corners(plane, diameter), 5, title, bar_scale, label)
    _name_axes(ax, layout, plane, diameter)
    return ax.figure.figure


def _name_axes(ax: "Axes", layout: TaxelLayout, plane: Tensor, diameter: float) -> None:
    pads = pads_side_by_side(layout)
    sides = {facing_sides(axes[2]) for _, axes, _ in pads}
    if len(sides) == 1:  # pads that face different sides have no common axes
        first, second = sides.pop()
        ax.set_xlabel(f"{'xyz'[first]} (mm)", fontsize=SMALL)
        ax.set_ylabel(f"{'xyz'[second]} (mm)", fontsize=SMALL)
    if len(pads) > 1:
        _name_pads(ax, layout, [taxels for taxels, _, _ in pads], plane, diameter)


def _name_pads(
    ax: "Axes", layout: TaxelLayout, pads: Sequence[Tensor], plane: Tensor, diameter: float
) -> None:
    # Each name is above its pad, on the first line where it touches no other name.
    assert layout.link is not None
    ax.figure.figure.draw_without_rendering()  # fixes the scale that the widths of names depend on
    left, right = ax.get_xlim()
    mm_per_pixel = (right - left) / ax.get_window_extent().width
    top = float(plane[:, 1].max()) + diameter
    line_ends: list[float] = []
    for taxels in pads:
        x = plane[taxels, 0]
        name = plain_text(layout.link_names[int(layout.link[taxels[0]])])
        text = ax.text(0.0, top, name, fontsize=SMALL, va="bottom", color=current_theme().ink)
        box = text.get_window_extent()
        width, height = mm_per_pixel * box.width, mm_per_pixel * box.height
        start = min(max(float(x.min() + x.max()) / 2 - width / 2, left), right - width)
        is_free = [end < start for end in line_ends]
        line = is_free.index(True) if True in is_free else len(line_ends)
        line_ends[line : line + 1] = [start + width + 0.5 * height]
        text.set_position((start, top + line * height))
    ax.set_ylim(top=top + len(line_ends) * height + diameter / 2)


def _undirected_edges(edge_index: Tensor, num_taxels: int) -> Tensor:
    edges = checked_edges("edge_index", edge_index, num_taxels)
    return edges.sort(dim=0).values.unique(dim=1)


def _draw_numbers(
    ax: "Axes", plane: Tensor, diameter: float, colors: Sequence[tuple[float, ...]]
) -> None:
    from matplotlib.collections import PathCollection
    from matplotlib.textpath import TextPath
    from matplotlib.transforms import Affine2D

    # Numbers are paths in millimetres, which fit into the circles at every figure size. Text in
    # points would not.
    paths = [TextPath((0, 0), str(i), size=1.0) for i in range(len(plane))]
    boxes = [path.get_extents() for path in paths]
    size = diameter * min(0.45 / boxes[0].height, 0.75 / max(box.width for box in boxes))
    centre = (boxes[0].y0 + boxes[0].y1) / 2
    numbers = [
        Affine2D().translate(-(box.x0 + box.x1) / 2, -centre).scale(size).translate(x, y)
        .transform_path(path)
        for path, box, (x, y) in zip(paths, boxes, plane.tolist(), strict=True)
    ]  # fmt: skip
    inks = [ink_on(color) for color in colors]
    ax.add_collection(PathCollection(numbers, facecolors=inks, linewidths=0, zorder=3))
