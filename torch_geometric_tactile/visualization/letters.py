r"""Pictures of presses on a tactile array."""

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import torch

from torch_geometric_tactile._checks import need
from torch_geometric_tactile.sensors import TaxelLayout, letter_array
from torch_geometric_tactile.visualization._style import (
    MAX_WIDTH,
    SMALL,
    current_theme,
    new_figure,
    plain_text,
    title_axes,
    title_figure,
)
from torch_geometric_tactile.visualization._taxel_map import draw_taxels, value_colors, value_scale

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_MAX_PANEL_WIDTH = 1.05  # inches
_HIGH_QUANTILE = 0.995  # quantile of the positive readings at the end of the colour scale
_RELATIVE_DIAMETER = 1.12  # of circles; above 1, circles cover most of the gaps between them


def plot_presses(
    readings: np.ndarray,
    titles: Sequence[str],
    layout: TaxelLayout | None = None,
    *,
    columns: int = 7,
    limits: tuple[float, float] | None = None,
    cmap: str = "sequential",
    label: str = "reading",
    title: str | None = None,
) -> "Figure":
    r"""Draws presses on a flat array side by side: as images if the layout has an image map,
    otherwise as circles. The :math:`y` axis points downwards, like the rows of an image.

    Args:
        readings (numpy.ndarray): The presses :math:`(P, N)`, or images of them
            :math:`(P, H, W)` with :math:`H \cdot W = N`.
        titles (sequence of str): Titles of the presses.
        layout (TaxelLayout, optional): The pixels (default: :func:`letter_array`).
        columns (int): Number of presses per row.
        limits (tuple of float, optional): Readings at the ends of the colour scale (default: zero
            and the 99.5 % quantile of the readings above zero). The end of the colour bar is
            pointed if there are higher readings.
        cmap (str): Name of a matplotlib colour map, or :obj:`"sequential"` for the colour map of
            the theme.
        label (str): Label of the colour bar, such as the unit of the readings.
        title (str, optional): Title of the picture.

    Raises:
        ImportError: If matplotlib is missing.
        ValueError: If there are no presses, if their shape does not fit the layout, if the number
            of titles differs, or if :obj:`columns` is below one.

    Examples:
        >>> from torch_geometric_tactile.sensors import grid
        >>> presses = np.arange(12.0).reshape(2, 6)
        >>> figure = plot_presses(presses, ["A", "B"], grid(2, 3, pitch=0.001))
        >>> figure.axes[1].get_title()
        'B'
    """
    layout = letter_array() if layout is None else layout
    presses = _checked_presses(readings, titles, layout)
    need(columns >= 1, "'columns' must be at least 1", columns)
    limits = _default_limits(presses) if limits is None else limits
    scale = value_scale(None, limits, cmap)
    rows = math.ceil(len(presses) / columns)
    side = min(_MAX_PANEL_WIDTH, (MAX_WIDTH - 0.7) / columns)
    figure = new_figure(side * columns + 0.7, (side + 0.2) * rows + (0.3 if title else 0.0))
    axes = figure.subplots(rows, columns, squeeze=False)
    for ax in axes.flat:
        ax.set_axis_off()
    for ax, press, text in zip(axes.flat, presses, titles, strict=False):
        _draw_press(ax, press, layout, scale)
        title_axes(ax, plain_text(text), size=SMALL + 0.5, pad=2)
    extend = "max" if np.nanmax(presses, initial=0.0) > limits[1] else "neither"
    figure.colorbar(scale, ax=axes, aspect=40, pad=0.01, label=plain_text(label), extend=extend)
    title_figure(figure, title)
    return figure


def _default_limits(presses: np.ndarray) -> tuple[float, float]:
    # A quantile is used, because a single faulty pixel would darken all other pixels.
    positive = presses[presses > 0]  # excludes NaN, and the many zeros of a slightly touched array
    high = float(np.quantile(positive, _HIGH_QUANTILE)) if len(positive) else 0.0
    return 0.0, max(high, 1e-6)


def _checked_presses(
    readings: np.ndarray, titles: Sequence[str], layout: TaxelLayout
) -> np.ndarray:
    presses = np.asarray(readings, dtype=np.float64)
    if presses.ndim not in (2, 3) or len(presses) == 0:
        raise ValueError(
            f"'readings' must be presses with shape (P, N) or (P, H, W) (got {presses.shape})"
        )
    presses = presses.reshape(len(presses), -1)
    if presses.shape[1] != layout.num_taxels:
        raise ValueError(
            f"'readings' must have one number for each of {layout.num_taxels} taxels (got "
            f"{presses.shape[1]})"
        )
    need(
        len(titles) == len(presses),
        f"'titles' must have {len(presses)}, one per press",
        len(titles),
    )
    return presses


def _draw_press(ax: Any, press: np.ndarray, layout: TaxelLayout, scale: Any) -> None:
    if layout.image_map is not None:
        row, column = layout.image_map.numpy().T
        image = np.full((row.max() + 1, column.max() + 1), np.nan)
        image[row, column] = press
        cmap = scale.cmap.with_extremes(bad=current_theme().grid)
        ax.imshow(image, cmap=cmap, norm=scale.norm, interpolation="nearest")
        return
    plane = layout.pos.double()[:, :2] * 1e3
    pitch = torch.cdist(plane, plane).fill_diagonal_(torch.inf).min() if len(plane) > 1 else 1.0
    diameter = _RELATIVE_DIAMETER * float(pitch)
    colors = value_colors(torch.from_numpy(press), scale)
    draw_taxels(ax, plane, diameter, colors, [False] * len(press), "none", 0.0)
    (left, top), (right, bottom) = plane.amin(dim=0).tolist(), plane.amax(dim=0).tolist()
    radius = diameter / 2
    ax.set_xlim(left - radius, right + radius)
    ax.set_ylim(bottom + radius, top - radius)
    ax.set_aspect("equal")
