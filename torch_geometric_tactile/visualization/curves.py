r"""Pictures of a number along an axis."""

from collections.abc import Mapping, Sequence
from math import isfinite
from typing import TYPE_CHECKING

from torch_geometric_tactile.visualization._new_figure import new_figure
from torch_geometric_tactile.visualization._style import (
    HOLLOW,
    current_theme,
    hollow_handle,
    open_plot,
    plain_text,
    series_color,
    series_marker,
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
    r"""Draws means along an axis, one line for each of several series, with a band of one standard
    deviation to either side. The points of a series without any deviation, such as that of one
    seed, are hollow, and the legend says so.

    Args:
        curves (Mapping): Points of each series: place on the axis, mean and standard deviation (NaN
            for none).
        xlabel (str): What the axis is.
        ylabel (str): What is drawn, with its unit.
        title (str): Title of the picture.

    Raises:
        ImportError: If matplotlib is missing.
        ValueError: If there is no point.

    Examples:
        >>> curves = {"GCN": [(1, 80.0, 1.5), (2, 84.0, 1.0)]}
        >>> figure = plot_curves(curves, "neighbours k", "accuracy in %", "Accuracy by k")
        >>> figure.axes[0].get_xlabel()
        'neighbours k'
    """
    if not any(curves.values()):
        raise ValueError("'curves' must hold at least one point (got none)")
    figure = new_figure(7.0, 4.0 + 0.2 * len(curves))
    ax = figure.subplots()
    for i, (name, points) in enumerate(curves.items()):
        color = series_color(i)
        places, means = [p[0] for p in points], [p[1] for p in points]
        known = [(x, mean, sd) for x, mean, sd in points if isfinite(sd)]
        ax.plot(
            places,
            means,
            color=color,
            marker=series_marker(i),
            markersize=5.0,
            markerfacecolor=color if known else current_theme().ground,
            linewidth=1.6,
            label=plain_text(name),
        )
        ax.fill_between(
            [x for x, _, _ in known],
            [mean - sd for _, mean, sd in known],
            [mean + sd for _, mean, sd in known],
            color=color,
            alpha=0.15,
            linewidth=0,
        )
    every = sorted({point[0] for points in curves.values() for point in points})
    if len(every) <= 20:
        ax.set_xticks(every)
    open_plot(ax)
    ax.set_xlabel(plain_text(xlabel))
    ax.set_ylabel(plain_text(ylabel))
    handles, labels = ax.get_legend_handles_labels()
    if not all(any(isfinite(sd) for _, _, sd in points) for points in curves.values()):
        handles, labels = [*handles, hollow_handle()], [*labels, HOLLOW]
    figure.legend(handles, labels, loc="outside lower center", ncols=1 if len(labels) < 4 else 2)
    title_figure(figure, title)
    return figure
