r"""Shared parts of pictures of taxels on one pad or on a hand."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import torch
from torch import Tensor

from torch_geometric_tactile._checks import need
from torch_geometric_tactile.sensors import TaxelLayout
from torch_geometric_tactile.sensors._checks import check_edges
from torch_geometric_tactile.visualization._style import (
    SMALL,
    colormap,
    current_theme,
    plain_text,
    title_axes,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_DIGIT_COLORS = (0, 2, 3, 1, None, 4, 5)  # indices into the palette; the palm, None, is grey


def view_axes(azimuth: float, elevation: float) -> np.ndarray:
    r"""Returns the unit vectors that point right, up and towards a viewer, as rows :math:`(3, 3)`.

    Args:
        azimuth (float): Azimuth of the viewer about :math:`z` in degrees.
        elevation (float): Elevation of the viewer in degrees.
    """
    a, e = np.deg2rad(azimuth), np.deg2rad(elevation)
    right = [-np.sin(a), np.cos(a), 0.0]
    up = [-np.sin(e) * np.cos(a), -np.sin(e) * np.sin(a), np.cos(e)]
    towards_viewer = [np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)]
    return np.array([right, up, towards_viewer])


def checked_values(name: str, values: Tensor, num_taxels: int) -> Tensor:
    r"""Returns values of taxels in double precision on the CPU.

    Shapes:
        - **values, output:** :math:`(N,)`

    Raises:
        ValueError: If the shape is not :obj:`(num_taxels,)`. The message contains :obj:`name`.
    """
    values = torch.as_tensor(values).detach().cpu().double()
    if values.shape != (num_taxels,):
        raise ValueError(f"'{name}' must have shape ({num_taxels},) (got {tuple(values.shape)})")
    return values


def checked_edges(name: str, edge_index: Tensor, num_taxels: int) -> Tensor:
    r"""Returns directed edges on the CPU, without self-loops.

    Shapes:
        - **edge_index:** :math:`(2, |\mathcal{E}|)`

    Raises:
        ValueError: If the edges are invalid. The message contains :obj:`name`.
    """
    edge_index = check_edges(torch.as_tensor(edge_index).detach().cpu(), num_taxels, f"'{name}'")
    return edge_index[:, edge_index[0] != edge_index[1]]


def value_scale(values: Tensor | None, limits: tuple[float, float] | None, cmap: str) -> Any:
    r"""Returns matplotlib's mapping from values to colours.

    Args:
        values (torch.Tensor, optional): The values.
        limits (tuple of float, optional): Values at the ends of the colour scale (default: the
            range of :obj:`values`).
        cmap (str): Name of the colour map, as in :func:`colormap`.

    Shapes:
        - **values:** :math:`(N,)`; NaN is ignored

    Raises:
        ValueError: If :obj:`limits` are not increasing.
    """
    low, high = _value_limits(values) if limits is None else limits
    need(low < high, f"'limits' must be increasing (got {low} and {high})")

    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize

    return ScalarMappable(Normalize(low, high), colormap(cmap))


def _value_limits(values: Tensor | None) -> tuple[float, float]:
    finite = torch.zeros(0) if values is None else values[values.isfinite()]
    if finite.numel() == 0:
        return 0.0, 1.0
    low, high = float(finite.min()), float(finite.max())
    if low < high:
        return low, high
    half_range = max(abs(low), 1.0) / 2
    return low - half_range, high + half_range


def value_colors(values: Tensor, scale: Any) -> list[tuple[float, ...]]:
    r"""Returns the colour of each value. Missing values (NaN) have the colour of the page.

    Shapes:
        - **values:** :math:`(N,)`
    """
    from matplotlib.colors import to_rgba

    colors = scale.to_rgba(values.nan_to_num().numpy())
    ground = to_rgba(current_theme().ground)
    return [
        ground if is_missing else tuple(color)
        for is_missing, color in zip(values.isnan().tolist(), colors, strict=True)
    ]


def draw_taxels(
    ax: "Axes",
    plane: Tensor,
    diameter: float,
    colors: Sequence[tuple[float, ...]],
    missing: Sequence[bool],
    outline: str,
    linewidth: float,
) -> None:
    r"""Draws the taxels as circles, in order. Missing taxels have a dashed outline.

    Shapes:
        - **plane:** positions in the plane in millimetres :math:`(N, 2)`
    """
    from matplotlib.collections import EllipseCollection

    ax.add_collection(
        EllipseCollection(
            widths=diameter,
            heights=diameter,
            angles=0,
            units="xy",
            offsets=plane.numpy(),
            offset_transform=ax.transData,
            facecolors=list(colors),
            edgecolors=outline,
            linewidths=linewidth,
            linestyles=["--" if is_missing else "-" for is_missing in missing],
            zorder=2,
        )
    )


def finish_map(
    ax: "Axes",
    corners: Sequence[Sequence[float]],
    ticks: int,
    title: str | None,
    scale: Any = None,
    label: str | None = None,
) -> None:
    r"""Sets the limits, the axes in millimetres, the title and the colour bar of a taxel map."""
    from matplotlib.ticker import MaxNLocator

    (left, bottom), (right, top) = corners
    ax.set_xlim(left, right)
    ax.set_ylim(bottom, top)
    ax.set_aspect("equal")
    for axis in (ax.xaxis, ax.yaxis):
        axis.set_major_locator(MaxNLocator(ticks, steps=[1, 2, 5, 10]))
    ax.set_xlabel("mm", fontsize=SMALL)
    ax.set_ylabel("mm", fontsize=SMALL)
    if title is not None:
        title_axes(ax, plain_text(title))
    if scale is not None and label is not None:
        draw_color_bar(ax, scale, label)


def draw_color_bar(ax: "Axes", scale: Any, label: str) -> None:
    r"""Draws a colour bar beside a map."""
    ax.figure.colorbar(scale, ax=ax, shrink=0.9, label=plain_text(label))


def figure_size(plane: Tensor, width: float) -> tuple[float, float]:
    r"""Returns the width and height, in inches, of axes with the proportions of a layout.

    Shapes:
        - **plane:** positions in the plane in millimetres :math:`(N, 2)`
    """
    low, high = map_corners(plane, taxel_diameter(plane))
    ratio = (high[1] - low[1]) / (high[0] - low[0])
    return width, width * min(max(ratio, 0.3), 2.0)


def taxel_diameter(plane: Tensor) -> float:
    r"""Returns the largest diameter, in millimetres, at which circles do not overlap.

    Shapes:
        - **plane:** positions in the plane in millimetres :math:`(N, 2)`
    """
    extent = max(float((plane.amax(dim=0) - plane.amin(dim=0)).max()), 1.0)
    if len(plane) < 2:
        return extent / 4
    nearest = torch.cdist(plane, plane).fill_diagonal_(torch.inf).min()
    # The lower limit keeps taxels visible whose projections coincide.
    return min(max(0.94 * float(nearest), extent / 50), extent / 4)


def map_corners(plane: Tensor, diameter: float) -> tuple[list[float], list[float]]:
    r"""Returns the lower left and upper right corners of a map with a margin of one diameter.

    Shapes:
        - **plane:** positions in the plane in millimetres :math:`(N, 2)`
    """
    return (plane.amin(dim=0) - diameter).tolist(), (plane.amax(dim=0) + diameter).tolist()


def digit_color(digit: int) -> str:
    r"""Returns the colour of a digit. The colour is the same in all pictures."""
    theme = current_theme()
    palette_index = _DIGIT_COLORS[digit % len(_DIGIT_COLORS)]
    return "#8a8f96" if palette_index is None else theme.palette[palette_index]


def segment_colors(
    layout: TaxelLayout, by: Literal["patch", "digit"]
) -> list[tuple[float, float, float]]:
    r"""Returns the colour of each taxel: the colour of its digit or, by patch, a tint of that
    colour.
    """
    from matplotlib.colors import to_rgb

    digits = layout.segments("digit").tolist()
    patches = layout.segments("patch").tolist()
    digit_colors = [to_rgb(digit_color(digit)) for digit in digits]
    if by == "digit":
        return digit_colors
    digit_patches: dict[int, list[int]] = {}
    for digit, patch in dict.fromkeys(zip(digits, patches, strict=True)):
        digit_patches.setdefault(digit, []).append(patch)
    colors = []
    ground = to_rgb(current_theme().ground)
    for color, digit, patch in zip(digit_colors, digits, patches, strict=True):
        # Tints approach the colour of the page. Every second patch is much lighter, so that
        # neighbouring patches differ.
        number = digit_patches[digit].index(patch)
        tint = 0.55 * (number % 2) + 0.3 * number / len(digit_patches[digit])
        red, green, blue = (c + (g - c) * tint for c, g in zip(color, ground, strict=True))
        colors.append((red, green, blue))
    return colors
