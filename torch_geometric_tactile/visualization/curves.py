r"""Pictures of curves with bands of one standard deviation."""

from collections.abc import Mapping, Sequence
from math import isfinite
from typing import TYPE_CHECKING

from torch_geometric_tactile._checks import need
from torch_geometric_tactile.visualization._style import (
    draw_legend,
    draw_series,
    new_figure,
    open_plot,
    plain_text,
    title_figure,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def plot_curves(
    curves: Mapping[str, Sequence[tuple[float, float, float]]],
    xlabel: str,
    ylabel: str,
    title: str,
) -> "Figure":
    r"""Draws the means of several series as lines, with bands of one standard deviation on either
    side. If a series has no standard deviations, for example because there is one seed, its points
    are hollow. The legend explains hollow points.

    Args:
        curves (Mapping): Points of each series: position on the axis, mean, and standard deviation
            (NaN if there is none).
        xlabel (str): Label of the axis.
        ylabel (str): Name and unit of the means.
        title (str): Title of the picture.

    Raises:
        ImportError: If matplotlib is missing.
        ValueError: If there are no points.

    Examples:
        >>> curves = {"GCN": [(1, 80.0, 1.5), (2, 84.0, 1.0)]}
        >>> figure = plot_curves(curves, "neighbours k", "accuracy in %", "Accuracy by k")
        >>> figure.axes[0].get_xlabel()
        'neighbours k'
    """
    need(any(curves.values()), "'curves' must hold at least one point (got none)")
    figure = new_figure(7.0, 4.0 + 0.2 * len(curves))
    ax = figure.subplots()
    for i, (name, points) in enumerate(curves.items()):
        band = [(x, mean - sd, mean + sd) for x, mean, sd in points if isfinite(sd)]
        draw_series(
            ax,
            i,
            [x for x, _, _ in points],
            [mean for _, mean, _ in points],
            tuple(zip(*band, strict=True)) if band else None,
            label=plain_text(name),
            markersize=5.0,
            alpha=0.15,
        )
    positions = sorted({point[0] for points in curves.values() for point in points})
    if len(positions) <= 20:  # more ticks would overlap
        ax.set_xticks(positions)
    open_plot(ax)
    ax.set_xlabel(plain_text(xlabel))
    ax.set_ylabel(plain_text(ylabel))
    handles, labels = ax.get_legend_handles_labels()
    has_hollow = not all(any(isfinite(sd) for _, _, sd in points) for points in curves.values())
    columns = 1 if len(labels) + has_hollow < 4 else 2
    draw_legend(figure, handles, labels, columns=columns, has_hollow=has_hollow)
    title_figure(figure, title)
    return figure
