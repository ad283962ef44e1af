r"""Pictures of taxel layouts."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from torch_geometric_tactile.sensors import TaxelLayout
from torch_geometric_tactile.visualization.figure import new_figure
from torch_geometric_tactile.visualization.style import current_theme, ink_on
from torch_geometric_tactile.visualization.taxel_map import (
    checked_edges,
    checked_values,
    draw_taxels,
    finish_map,
    value_colors,
    value_scale,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_TIE = 1e-6  # relative difference below which two extents count as equal


def layout_plane(layout: TaxelLayout) -> Tensor:
    r"""Projects the taxels onto the plane that faces the viewer of the pad.

    The plane is orthogonal to the mean normal, which points at the viewer; without normals (or
    where they cancel) it holds the two main axes of the positions. The first axis, to the right, is
    the direction of largest extent (variance) in the plane, with its largest component positive;
    the second axis points up. If the extents agree, the axes of the link
    frame decide. The origin is that of the link frame.

    Args:
        layout (TaxelLayout): The layout.

    Shapes:
        - **output:** places in the plane in millimetres :math:`(N, 2)`

    Examples:
        >>> from torch_geometric_tactile.sensors import grid
        >>> layout_plane(grid(1, 3, pitch=0.002))
        tensor([[0., 0.],
                [2., 0.],
                [4., 0.]])
    """
    axes = facing_axes(layout.pos, layout.normal)
    plane: Tensor = (layout.pos.double() @ axes[:2].T * 1e3).float()
    return plane


def facing_axes(pos: Tensor, normal: Tensor | None) -> Tensor:
    r"""Returns the axes of :func:`layout_plane` and the one towards the viewer.

    Args:
        pos (torch.Tensor): Places of the taxels in metres :math:`(N, 3)`.
        normal (torch.Tensor, optional): Their outward normals :math:`(N, 3)`.

    Shapes:
        - **output:** unit axes to the right, up and towards the viewer as rows :math:`(3, 3)`, in
          double
    """
    points = pos.double() - pos.double().mean(dim=0)
    toward = points.new_zeros(3) if normal is None else normal.double().mean(dim=0)
    if float(toward.norm()) > 1e-3:
        toward = toward / toward.norm()
        first = _main_axis(points, toward)
        second = torch.linalg.cross(toward, first)
    else:
        first = _main_axis(points, torch.zeros_like(toward))
        second = _main_axis(points, first)
        toward = torch.linalg.cross(first, second)
    return torch.stack([first, second, toward])


def _main_axis(points: Tensor, excluded: Tensor) -> Tensor:
    allowed = torch.eye(3, dtype=points.dtype) - torch.outer(excluded, excluded)
    points = points @ allowed
    value, vector = torch.linalg.eigh(points.T @ points)
    widest = vector[:, value >= value[-1] * (1 - _TIE)]
    # Each column is a frame axis projected onto the directions of largest extent. The longest is
    # taken: unlike an eigenvector it has a sign, and stays the same where extents are equal.
    candidates = allowed @ widest @ widest.T
    longest = candidates.norm(dim=0).div(_TIE).round().argmax()
    axis = candidates[:, longest]
    return axis / axis.norm()


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
    r"""Draws the taxels of a layout as circles, seen from the side of the pad that is touched.

    Args:
        layout (TaxelLayout): The layout.
        values (torch.Tensor, optional): What colours the taxels; a missing value (NaN) stays white
            with a dashed outline.
        edge_index (torch.Tensor, optional): Edges to draw below the taxels.
        ax (matplotlib.axes.Axes, optional): Where to draw. A new figure if left out.
        limits (tuple of float, optional): Values at the ends of the colour scale; lowest and
            highest value if left out.
        cmap (str): Name of matplotlib's colour map.
        label (str, optional): Label of the colour bar. No colour bar if :obj:`None`.
        title (str, optional): Title of the picture.
        numbers (bool): Whether to number the taxels, from 1 as on the data sheets.

    Shapes:
        - **values:** one per taxel :math:`(N,)`
        - **edge_index:** directed edges :math:`(2, |\mathcal{E}|)`; each pair is drawn once

    Raises:
        ImportError: If matplotlib is missing.
        ValueError: If :obj:`values` or :obj:`edge_index` does not fit the layout, or
            :obj:`limits` do not rise.

    Examples:
        >>> import torch
        >>> from torch_geometric_tactile.sensors import grid
        >>> figure = plot_layout(grid(2, 2, pitch=0.002), torch.arange(4.0), title="Pad")
        >>> figure.axes[0].get_title()
        'Pad'
    """
    if values is not None:
        values = checked_values("values", values, layout.num_taxels)
    edges = None if edge_index is None else _pairs(edge_index, layout.num_taxels)
    scale = value_scale(values, limits, cmap)
    plane = layout_plane(layout)
    if ax is None:
        width, height = figure_size(plane, 5.0)
        ax = new_figure(width, height + 0.3).add_subplot()

    from matplotlib.collections import LineCollection
    from matplotlib.colors import to_rgba

    look = current_theme()
    diameter = _taxel_diameter(plane)
    colors: list[tuple[float, ...]] = [to_rgba(look.band)] * layout.num_taxels
    missing = [False] * layout.num_taxels
    if values is not None:
        missing = values.isnan().tolist()
        colors = value_colors(values, scale)
    if edges is not None:
        ax.add_collection(
            LineCollection(
                list(plane[edges.T].numpy()), colors=look.faint, linewidths=0.8, zorder=1
            )
        )
    draw_taxels(ax, plane, diameter, colors, missing, look.outline, 0.5)
    if numbers:
        _draw_numbers(ax, plane, diameter, colors)
    shown = None if values is None else scale
    finish_map(ax, _corners(plane, diameter), 5, title, shown, label)
    return ax.figure.figure


def figure_size(plane: Tensor, width: float) -> tuple[float, float]:
    r"""Returns width and height in inches of an axes that shows a layout without waste.

    Args:
        plane (torch.Tensor): The taxels in the plane, in millimetres.
        width (float): The width in inches.

    Shapes:
        - **plane:** :math:`(N, 2)`
    """
    low, high = _corners(plane, _taxel_diameter(plane))
    ratio = (high[1] - low[1]) / (high[0] - low[0])
    return width, width * min(max(ratio, 0.3), 2.0)


def _pairs(edge_index: Tensor, num_taxels: int) -> Tensor:
    edges = checked_edges("edge_index", edge_index, num_taxels)
    return edges.sort(dim=0).values.unique(dim=1)


def _taxel_diameter(plane: Tensor) -> float:
    extent = max(float((plane.amax(dim=0) - plane.amin(dim=0)).max()), 1.0)
    if len(plane) < 2:
        return extent / 4
    nearest = torch.cdist(plane, plane).fill_diagonal_(torch.inf).min()
    # Taxels that coincide in the projection must stay visible.
    return min(max(0.94 * float(nearest), extent / 50), extent / 4)


def _corners(plane: Tensor, diameter: float) -> tuple[list[float], list[float]]:
    return (plane.amin(dim=0) - diameter).tolist(), (plane.amax(dim=0) + diameter).tolist()


def _draw_numbers(
    ax: "Axes", plane: Tensor, diameter: float, colors: Sequence[tuple[float, ...]]
) -> None:
    from matplotlib.collections import PathCollection
    from matplotlib.textpath import TextPath
    from matplotlib.transforms import Affine2D

    # Paths in millimetres, not text in points: they fit into their circles at every figure size.
    paths = [TextPath((0, 0), str(i + 1), size=1.0) for i in range(len(plane))]
    boxes = [path.get_extents() for path in paths]
    size = diameter * min(0.45 / boxes[0].height, 0.75 / max(box.width for box in boxes))
    middle = (boxes[0].y0 + boxes[0].y1) / 2
    placed = [
        Affine2D().translate(-(box.x0 + box.x1) / 2, -middle).scale(size).translate(x, y)
        .transform_path(path)
        for path, box, (x, y) in zip(paths, boxes, plane.tolist(), strict=True)
    ]  # fmt: skip
    inks = [ink_on(color) for color in colors]
    ax.add_collection(PathCollection(placed, facecolors=inks, linewidths=0, zorder=3))
