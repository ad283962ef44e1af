r"""Pictures of a number along an axis."""

from collections.abc import Mapping, Sequence
from math import isfinite
from typing import TYPE_CHECKING

from torch_geometric_tactile.visualization.figure import new_figure, plain_text
from torch_geometric_tactile.visualization.metrics import _COLORS, _MARKERS, _wrapped

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def plot_curves(
    curves: Mapping[str, Sequence[tuple[float, float, float]]],
    xlabel: str,
    ylabel: str,
    title: str,
) -> "Figure":
    r"""Draws means along an axis, one line for each of several series, with a band of one standard
    deviation to either side.

    Args:
        curves (Mapping): Points of each series: place on the axis, mean and standard deviation (NaN
            for none).
        xlabel (str): What the axis is.
        ylabel (str): What is drawn, with its unit.
        title (str): Title of the picture.

    Raises:
        ImportError: If matplotlib is missing.
        ValueError: If there is no point.
    """
    if not any(curves.values()):
        raise ValueError("'curves' must hold at least one point (got none)")
    figure = new_figure(7.0, 4.4 + 0.2 * len(curves))
    ax = figure.subplots()
    for i, (name, points) in enumerate(curves.items()):
        color = _COLORS[i % len(_COLORS)]
        places, means = [p[0] for p in points], [p[1] for p in points]
        ax.plot(
            places,
            means,
            color=color,
            marker=_MARKERS[i % len(_MARKERS)],
            markersize=5.0,
            linewidth=1.4,
            label=plain_text(name),
        )
        known = [(x, mean, sd) for x, mean, sd in points if isfinite(sd)]
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
    ax.tick_params(labelsize=9)
    ax.grid(color="#dcdcdc", linewidth=0.6)
    ax.set_axisbelow(True)
    ax.set_xlabel(plain_text(xlabel), fontsize=9)
    ax.set_ylabel(plain_text(ylabel), fontsize=9)
    figure.legend(loc="outside lower center", ncols=1, fontsize=9, frameon=False)
    figure.suptitle(_wrapped(title, 80), fontsize=11)
    return figure
