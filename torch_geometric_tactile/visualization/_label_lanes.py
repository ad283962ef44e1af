r"""Lanes of the classes or labels over time, and the legends beside a panel."""

from typing import TYPE_CHECKING, Any

import numpy as np

from torch_geometric_tactile.visualization._predicted_trial import PredictedTrial, thin_codes
from torch_geometric_tactile.visualization._style import (
    TINY,
    current_theme,
    ink_on,
    plain_text,
    series_color,
    wrap_text,
)
from torch_geometric_tactile.visualization._time_panels import style_lanes

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.lines import Line2D

_LEGEND_WIDTH = 18  # letters in a line of a legend
_PANEL_WIDTH = 88  # letters of the smallest size in the width of a panel


def draw_class_lanes(ax: "Axes", trial: PredictedTrial, outputs: list[int]) -> None:
    r"""Draws a lane of the predicted class and, if it is known, a lane of the true class.

    Args:
        ax (matplotlib.axes.Axes): The panel.
        trial (PredictedTrial): The trial.
        outputs (list of int): Outputs of the model that have a colour, in the order of the palette.
    """
    predicted = np.array([p[0] if p else "" for p in trial.predicted], dtype=str)
    lanes = [("predicted", trial.answer_edges, predicted)]
    if trial.truth is not None:
        source = shorten_middle(trial.truth.source, 14)
        lanes.append((f"true ({source})", trial.edges, trial.truth.value))
    colors = {trial.names[i]: series_color(k) for k, i in enumerate(outputs)}
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
    edges, code = thin_codes(edges, np.where(names[code] == "", -1, code))
    starts = np.flatnonzero(np.append(True, code[1:] != code[:-1]))
    stops = np.append(starts[1:], len(code))
    for start, stop in zip(starts.tolist(), stops.tolist(), strict=True):
        if code[start] < 0:
            continue
        name = str(names[code[start]])
        color = colors.get(name, current_theme().faint)
        x, end = float(edges[start]), float(edges[stop])
        ax.fill_between([x, end], lane - 0.4, lane + 0.4, color=color, linewidth=0)
        if len(name) + 1 <= _PANEL_WIDTH * (end - x) / width:
            _write_name(ax, (x + end) / 2, lane, name, color)


def _write_name(ax: "Axes", x: float, y: float, name: str, color: str) -> None:
    from matplotlib.colors import to_rgb

    ink = ink_on(to_rgb(color))
    ax.text(
        x,
        y,
        shorten_middle(name, len(name)),
        ha="center",
        va="center_baseline",
        fontsize=TINY,
        color=ink,
    )


def draw_label_lanes(ax: "Axes", trial: PredictedTrial, outputs: list[int]) -> None:
    r"""Draws a lane for each label: a thick bar where the label is predicted, and a thin bar where
    it is true.

    Args:
        ax (matplotlib.axes.Axes): The panel.
        trial (PredictedTrial): The trial.
        outputs (list of int): Outputs of the model that have a colour, in the order of the palette.
    """
    for lane, i in enumerate(outputs):
        is_predicted = np.array(
            [trial.names[i] in labels for labels in trial.predicted], dtype=np.int64
        )
        limits = (lane - 0.42, lane + 0.18)
        _draw_bars(ax, trial.answer_edges, is_predicted, limits, series_color(lane))
        if trial.truth is not None:
            is_true = (trial.truth.value[:, i] == 1).astype(np.int64)
            limits = (lane + 0.24, lane + 0.42)
            _draw_bars(ax, trial.edges, is_true, limits, current_theme().ink)
    style_lanes(ax, [shorten_middle(trial.names[i], 20) for i in outputs])
    if trial.truth is not None:
        text = f"thin: true\n({shorten_middle(trial.truth.source, 14)})"
        draw_side_legend(ax, [legend_line(current_theme().ink, "-")], [text])


def _draw_bars(
    ax: "Axes", edges: np.ndarray, is_on: np.ndarray, limits: tuple[float, float], color: str
) -> None:
    if len(is_on) == 0:
        return
    edges, is_on = thin_codes(edges, is_on)
    starts = np.flatnonzero(np.diff(np.append(0, is_on)) == 1)
    stops = np.flatnonzero(np.diff(np.append(is_on, 0)) == -1) + 1
    ax.broken_barh(
        [(edges[a], edges[b] - edges[a]) for a, b in zip(starts, stops, strict=True)],
        (limits[0], limits[1] - limits[0]),
        color=color,
        linewidth=0,
    )


def legend_line(color: str, style: str = "-", **properties: Any) -> "Line2D":
    r"""Returns the legend handle of a line, with further properties of matplotlib."""
    from matplotlib.lines import Line2D

    return Line2D([], [], **{"color": color, "linestyle": style, "linewidth": 2.0, **properties})


def draw_side_legend(ax: "Axes", handles: list["Line2D"], labels: list[str]) -> None:
    r"""Draws a legend to the right of a panel."""
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


def shorten_middle(name: str, max_length: int) -> str:
    r"""Returns a name on one line. The middle of a long name is left out, because names with the
    same beginning often differ at the end.
    """
    if len(name) > max_length:
        head = (max_length - 3) // 2
        name = f"{name[:head]}...{name[-(max_length - 3 - head) :]}"
    return plain_text(name.replace("\n", " ")) or " "


def legend_name(name: str) -> str:
    r"""Returns a name on at most two short lines."""
    if len(name) > 2 * _LEGEND_WIDTH:
        head, tail = name[: _LEGEND_WIDTH - 3], name[-_LEGEND_WIDTH:]
        return f"{plain_text(head)}...\n{plain_text(tail)}"
    return wrap_text(name, _LEGEND_WIDTH) or " "
