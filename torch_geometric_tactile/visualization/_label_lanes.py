r"""Bands of the classes or labels over time, and the legends at the side of a panel."""

from typing import TYPE_CHECKING, Any

import numpy as np

from torch_geometric_tactile.visualization._predicted_trial import PredictedTrial, thinned_codes
from torch_geometric_tactile.visualization._style import (
    TINY,
    current_theme,
    ink_on,
    plain_text,
    series_color,
    wrapped,
)
from torch_geometric_tactile.visualization._time_panels import style_lanes

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.lines import Line2D

_LINE = 18  # letters in a line of a legend
_LETTERS = 88  # of the smallest size in the width of a panel


def draw_class_lanes(ax: "Axes", trial: PredictedTrial, shown: list[int]) -> None:
    r"""Draws a lane of the predicted class, and one of the true class where it is known."""
    predicted = np.array([p[0] if p else "" for p in trial.predicted], dtype=str)
    lanes = [("predicted", trial.answer_edges, predicted)]
    if trial.truth is not None:
        lanes.append(
            (f"true ({shortened(trial.truth.source, 14)})", trial.edges, trial.truth.value)
        )
    colors = {trial.names[i]: series_color(k) for k, i in enumerate(shown)}
    width = max(trial.edges[-1], trial.answer_edges[-1]) - trial.edges[0]
    for lane, (_, edges, classes) in enumerate(lanes):
        _draw_lane(ax, edges, classes, colors, lane, width)
    style_lanes(ax, [name for name, _, _ in lanes])


def _draw_lane(
    ax: "Axes",
    edges: np.ndarray,
    classes: np.ndarray,
    colors: dict[str, str],
    lane: int,
    width: float,
) -> None:
    if len(classes) == 0:
        return
    names, code = np.unique(classes, return_inverse=True)
    edges, code = thinned_codes(edges, np.where(names[code] == "", -1, code))
    starts = np.flatnonzero(np.append(True, code[1:] != code[:-1]))
    stops = np.append(starts[1:], len(code))
    for start, stop in zip(starts.tolist(), stops.tolist(), strict=True):
        if code[start] < 0:
            continue
        name = str(names[code[start]])
        color = colors.get(name, current_theme().faint)
        x, end = float(edges[start]), float(edges[stop])
        ax.fill_between([x, end], lane - 0.4, lane + 0.4, color=color, linewidth=0)
        if len(name) + 1 <= _LETTERS * (end - x) / width:
            _write(ax, (x + end) / 2, lane, name, color)


def _write(ax: "Axes", x: float, y: float, name: str, color: str) -> None:
    from matplotlib.colors import to_rgb

    ink = ink_on(to_rgb(color))
    ax.text(
        x,
        y,
        shortened(name, len(name)),
        ha="center",
        va="center_baseline",
        fontsize=TINY,
        color=ink,
    )


def draw_label_lanes(ax: "Axes", trial: PredictedTrial, shown: list[int]) -> None:
    r"""Draws a lane for each label: a thick bar where it is predicted, a thin one where true."""
    for lane, i in enumerate(shown):
        told = np.array([trial.names[i] in labels for labels in trial.predicted], dtype=np.int64)
        _fill(ax, trial.answer_edges, told, (lane - 0.42, lane + 0.18), series_color(lane))
        if trial.truth is not None:
            true = (trial.truth.value[:, i] == 1).astype(np.int64)
            _fill(ax, trial.edges, true, (lane + 0.24, lane + 0.42), current_theme().ink)
    style_lanes(ax, [shortened(trial.names[i], 20) for i in shown])
    if trial.truth is not None:
        text = f"thin: true\n({shortened(trial.truth.source, 14)})"
        draw_side_legend(ax, [legend_line(current_theme().ink, "-")], [text])


def _fill(
    ax: "Axes", edges: np.ndarray, on: np.ndarray, ends: tuple[float, float], color: str
) -> None:
    if len(on) == 0:
        return
    edges, on = thinned_codes(edges, on)
    starts = np.flatnonzero(np.diff(np.append(0, on)) == 1)
    stops = np.flatnonzero(np.diff(np.append(on, 0)) == -1) + 1
    ax.broken_barh(
        [(edges[a], edges[b] - edges[a]) for a, b in zip(starts, stops, strict=True)],
        (ends[0], ends[1] - ends[0]),
        color=color,
        linewidth=0,
    )


def legend_line(color: str, style: str = "-", **more: Any) -> "Line2D":
    r"""Returns the mark of a line in a legend."""
    from matplotlib.lines import Line2D

    return Line2D([], [], **{"color": color, "linestyle": style, "linewidth": 2.0, **more})


def draw_side_legend(ax: "Axes", handles: list["Line2D"], labels: list[str]) -> None:
    r"""Draws a legend at the right of a panel."""
    ax.legend(
        handles,
        labels,
        loc="upper left",
        bbox_to_anchor=(1.005, 1.03),
        borderaxespad=0,
        fontsize=TINY,
        frameon=False,
        labelcolor=current_theme().ink,
        labelspacing=0.45,
        handlelength=1.4,
    )


def shortened(name: str, longest: int) -> str:
    r"""Returns a name on one line with its middle left out where it is long: names that begin alike
    are told by their ends.
    """
    if len(name) > longest:
        head = (longest - 3) // 2
        name = f"{name[:head]}...{name[-(longest - 3 - head) :]}"
    return plain_text(name.replace("\n", " ")) or " "


def legend_name(name: str) -> str:
    r"""Returns a name on at most two short lines."""
    if len(name) > 2 * _LINE:
        return f"{plain_text(name[: _LINE - 3])}...\n{plain_text(name[-_LINE:])}"
    return wrapped(name, _LINE) or " "
