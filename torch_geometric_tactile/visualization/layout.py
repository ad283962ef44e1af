r"""Pictures of taxel layouts."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from torch_geometric_tactile.sensors import TaxelLayout
from torch_geometric_tactile.visualization.figure import new_figure, plain_text

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_EDGE_COLOR = "#b0b0b0"
_PLAIN_COLOR = "#d6e4f0"
_MISSING_COLOR = "#ffffff"
_TIE = 1e-6  # relative difference below which two extents count as equal


def layout_plane(layout: TaxelLayout) -> Tensor:
    r"""Projects the taxels onto the plane seen by somebody who looks at the pad.

    The plane is orthogonal to the mean normal, which points at the viewer; without normals (or
    where they cancel) it holds the two main axes of the positions. The first axis, to the right, is
    the direction of largest extent (variance) in the plane, with its largest component positive;
    the second axis points up. Extents that agree count as equal and give way to the axes of the
    link frame. The origin is that of the link frame.

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
    pos = layout.pos.double()
    points = pos - pos.mean(dim=0)
    normal = torch.zeros(3, dtype=pos.dtype)
    if layout.normal is not None:
        normal = layout.normal.double().mean(dim=0)
    if float(normal.norm()) > 1e-3:
        normal = normal / normal.norm()
        first = _main_axis(points, normal)
        second = torch.linalg.cross(normal, first)
    else:
        first = _main_axis(points, torch.zeros_like(normal))
        second = _main_axis(points, first)
    plane: Tensor = (pos @ torch.stack([first, second], dim=1) * 1e3).float()
    return plane


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
    r"""Draws the taxels as circles where somebody who looks at the pad sees them.

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
    """
    values = None if values is None else _checked_values(values, layout.num_taxels)
    edges = None if edge_index is None else _checked_edges(edge_index, layout.num_taxels)
    low, high = _value_limits(values) if limits is None else limits
    if not low < high:
        raise ValueError(f"'limits' must rise (got {low} and {high})")
    plane = layout_plane(layout)
    if ax is None:
        width, height = figure_size(plane, 5.0)
        ax = new_figure(width, height + 0.3).add_subplot()

    from matplotlib import colormaps
    from matplotlib.cm import ScalarMappable
    from matplotlib.collections import EllipseCollection, LineCollection
    from matplotlib.colors import Normalize, to_rgba
    from matplotlib.ticker import MaxNLocator

    diameter = _taxel_diameter(plane)
    scale = ScalarMappable(Normalize(low, high), colormaps[cmap])
    colors = [to_rgba(_PLAIN_COLOR)] * layout.num_taxels
    missing = torch.zeros(layout.num_taxels, dtype=torch.bool)
    if values is not None:
        missing = values.isnan()
        colors = [tuple(color) for color in scale.to_rgba(values.nan_to_num().numpy())]
        colors = [
            to_rgba(_MISSING_COLOR) if gone else color
            for gone, color in zip(missing.tolist(), colors, strict=True)
        ]
    if edges is not None:
        ax.add_collection(
            LineCollection(
                list(plane[edges.T].numpy()), colors=_EDGE_COLOR, linewidths=0.8, zorder=1
            )
        )
    ax.add_collection(
        EllipseCollection(
            widths=diameter,
            heights=diameter,
            angles=0,
            units="xy",
            offsets=plane.numpy(),
            offset_transform=ax.transData,
            facecolors=colors,
            edgecolors="#404040",
            linewidths=0.5,
            linestyles=["--" if gone else "-" for gone in missing.tolist()],
            zorder=2,
        )
    )
    if numbers:
        _draw_numbers(ax, plane, diameter, colors)
    low_corner, high_corner = _corners(plane, diameter)
    ax.set_xlim(low_corner[0], high_corner[0])
    ax.set_ylim(low_corner[1], high_corner[1])
    ax.set_aspect("equal")
    for axis in (ax.xaxis, ax.yaxis):
        axis.set_major_locator(MaxNLocator(5, steps=[1, 2, 5, 10]))
    ax.tick_params(labelsize=8)
    ax.set_xlabel("mm", fontsize=8)
    ax.set_ylabel("mm", fontsize=8)
    if title is not None:
        ax.set_title(plain_text(title), fontsize=10)
    if values is not None and label is not None:
        bar = ax.figure.colorbar(scale, ax=ax, shrink=0.9)
        bar.set_label(plain_text(label), fontsize=9)
        bar.ax.tick_params(labelsize=8)
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


def _checked_values(values: Tensor, num_taxels: int) -> Tensor:
    values = torch.as_tensor(values).detach().cpu().double()
    if values.shape != (num_taxels,):
        raise ValueError(f"'values' must have shape ({num_taxels},) (got {tuple(values.shape)})")
    return values


def _checked_edges(edge_index: Tensor, num_taxels: int) -> Tensor:
    edge_index = torch.as_tensor(edge_index).detach().cpu().long()
    if edge_index.dim() != 2 or edge_index.size(0) != 2:
        raise ValueError(
            f"'edge_index' must have shape (2, num_edges) (got {tuple(edge_index.shape)})"
        )
    if edge_index.numel() and not 0 <= int(edge_index.min()) <= int(edge_index.max()) < num_taxels:
        raise ValueError(
            f"'edge_index' must join taxels 0 to {num_taxels - 1} "
            f"(got {int(edge_index.min())} to {int(edge_index.max())})"
        )
    edge_index = edge_index[:, edge_index[0] != edge_index[1]]
    return edge_index.sort(dim=0).values.unique(dim=1)


def _value_limits(values: Tensor | None) -> tuple[float, float]:
    finite = torch.zeros(0) if values is None else values[values.isfinite()]
    if finite.numel() == 0:
        return 0.0, 1.0
    low, high = float(finite.min()), float(finite.max())
    if low < high:
        return low, high
    half = max(abs(low), 1.0) / 2
    return low - half, high + half


def _taxel_diameter(plane: Tensor) -> float:
    extent = max(float((plane.amax(dim=0) - plane.amin(dim=0)).max()), 1.0)
    if len(plane) < 2:
        return extent / 4
    nearest = torch.cdist(plane, plane).fill_diagonal_(torch.inf).min()
    # Taxels that the projection puts on one another must stay visible.
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
    inks = ["black" if _luminance(color) > 0.45 else "white" for color in colors]
    ax.add_collection(PathCollection(placed, facecolors=inks, linewidths=0, zorder=3))


def _luminance(color: tuple[float, ...]) -> float:
    return 0.299 * color[0] + 0.587 * color[1] + 0.114 * color[2]
