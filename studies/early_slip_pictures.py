r"""Pictures of how early a slip is announced."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from torch_geometric_tactile._checks import need
from torch_geometric_tactile.visualization._style import (
    draw_legend,
    draw_series,
    new_figure,
    open_plot,
    plain_text,
    title_axes,
    title_figure,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


class AlarmCurves(NamedTuple):
    r"""Recall and false alarms of one early-slip method, from one or more trainings.

    Args:
        recall (array-like): Part of the slipping grasps with an alarm, training by training
            :math:`(R, L)`; NaN where there was nothing to count.
        false_alarms (array-like): Part of the holding grasps with an alarm at the same moments
            :math:`(R, L)`.

    Examples:
        >>> curves = AlarmCurves(np.array([[0.9, 0.5]]), np.array([[0.05, 0.02]]))
        >>> curves.recall.shape  # one training, two moments before the onset
        (1, 2)
    """

    recall: np.ndarray
    false_alarms: np.ndarray


def plot_early_slip(
    seconds: Sequence[float], methods: Mapping[str, AlarmCurves], title: str
) -> "Figure":
    r"""Draws recall and false alarms against the time that is left before the onset of slip, which
    is at the right end. Lines are means over trainings, bands one standard deviation; where there
    was one training only, the points are hollow.

    Args:
        seconds (sequence of float): Times before the onset in seconds :math:`(L,)`.
        methods (Mapping of str to AlarmCurves): The curves of each method by its name.
        title (str): Title of the picture.

    Raises:
        ImportError: If matplotlib is missing.
        ValueError: If there is no method, or its curves are of other times.

    Examples:
        >>> curves = AlarmCurves(np.array([[0.9, 0.5]]), np.array([[0.05, 0.02]]))
        >>> figure = plot_early_slip([0.1, 0.5], {"LSTM": curves}, "Early slip")
        >>> figure.axes[0].get_title()
        'slipping grasps with an alarm'
    """
    need(methods, "'methods' must hold at least one method (got none)")
    time = np.asarray(seconds, dtype=np.float64)

    from matplotlib.ticker import MaxNLocator

    figure = new_figure(8.0, 4.1)
    left, right = figure.subplots(1, 2, sharey=True)
    for i, (name, curves) in enumerate(methods.items()):
        for ax, values in ((left, curves.recall), (right, curves.false_alarms)):
            _draw(ax, time, _checked(name, values, len(time)), plain_text(name), i)
    for ax, what in (
        (left, "slipping grasps with an alarm"),
        (right, "holding grasps with an alarm\nat the same moments"),
    ):
        title_axes(ax, what)
        ax.set_xlabel("seconds before the onset of slip")
        ax.set_xlim(time.max() * 1.03, 0.0)
        ax.xaxis.set_major_locator(MaxNLocator(5))
        open_plot(ax)
    left.set_ylim(0.0, 1.02)
    left.set_ylabel("part of the grasps")
    handles, labels = left.get_legend_handles_labels()
    has_hollow = any(np.atleast_2d(curves.recall).shape[0] < 2 for curves in methods.values())
    columns = 1 if max(map(len, labels), default=0) > 60 else 2
    draw_legend(figure, handles, labels, columns=columns, has_hollow=has_hollow)
    title_figure(figure, title)
    return figure


def _checked(name: str, values: np.ndarray, size: int) -> np.ndarray:
    values = np.atleast_2d(np.asarray(values, dtype=np.float64))
    if values.ndim != 2 or values.shape[1] != size:
        raise ValueError(
            f"the curves of '{name}' must have {size} times, as 'seconds' (got shape "
            f"{values.shape})"
        )
    return values


def _draw(ax: "Axes", time: np.ndarray, values: np.ndarray, name: str, index: int) -> None:
    counted = ~np.isnan(values).all(axis=0)
    if not counted.any():
        return
    time, values = time[counted], values[:, counted]
    mean, deviation = np.nanmean(values, axis=0), np.nanstd(values, axis=0)
    draw_series(
        ax,
        index,
        time,
        mean,
        (time, mean - deviation, mean + deviation) if len(values) > 1 else None,
        label=name,
        markersize=4,
        alpha=0.18,
    )
