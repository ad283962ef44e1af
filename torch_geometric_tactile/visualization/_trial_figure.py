r"""The figure of the predictions for a trial."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from torch_geometric_tactile.visualization._predicted_trial import (
    PredictedTrial,
    thin_codes,
    thin_steps,
)
from torch_geometric_tactile.visualization._style import (
    SMALL,
    TINY,
    current_theme,
    ink_on,
    new_figure,
    open_plot,
    plain_text,
    series_color,
    title_figure,
    wrap_text,
)
from torch_geometric_tactile.visualization._time_panels import (
    LANE_HEIGHT,
    cover_gaps,
    draw_annotations,
    name_phases,
    shade_phases,
    style_lanes,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D

_TRUTH_OPACITY = 0.35  # opacity of the true numbers
_LEGEND_WIDTH = 18  # letters per line of a legend
_PANEL_WIDTH = 88  # letters of the smallest size per width of a panel


def draw_trial(trial: PredictedTrial) -> "Figure":
    r"""Draws the predictions for a trial in panels, one below the other: probabilities or numbers,
    classes or labels, annotations, taxels in contact and total pressure.
    """
    outputs = _colored_outputs(trial)
    num_lanes = len(outputs) if trial.task == "multilabel" else (1 + (trial.truth is not None))
    heights = [2.2, *([LANE_HEIGHT * num_lanes] if trial.task != "regression" else [])]
    heights += [LANE_HEIGHT * len(trial.lanes)] if trial.lanes else []
    heights += [0.8] if trial.contact is not None else []
    heights += [1.1]
    figure = new_figure(8.0, sum(heights) + 1.5)
    panels = figure.subplots(
        len(heights), 1, sharex=True, squeeze=False, gridspec_kw={"height_ratios": heights}
    )[:, 0]
    title = list(trial.title)
    if trial.accuracy is not None:
        title.append(f"{100 * trial.accuracy:.1f}\xa0%\xa0correct")
    title_figure(figure, "  |  ".join(title))
    _draw_values(panels[0], trial, outputs)
    if trial.task == "multilabel":
        _draw_label_lanes(panels[1], trial, outputs)
    elif trial.task == "multiclass":
        _draw_class_lanes(panels[1], trial, outputs)
    annotation_panel = panels[1 + (trial.task != "regression")] if trial.lanes else None
    if annotation_panel is not None:
        colors = {trial.names[i]: series_color(k) for k, i in enumerate(outputs)}
        draw_annotations(annotation_panel, trial.lanes, colors)
    _draw_touch(list(panels), trial)
    end = max(trial.edges[-1], trial.answer_edges[-1])
    phases = [] if trial.truth is not None and trial.truth.source == "phase" else trial.phases
    for ax in panels[-1 - (trial.contact is not None) :]:
        shade_phases(ax, phases)
    for ax in panels:
        if ax is not annotation_panel:
            cover_gaps(ax, trial.gaps)
    name_phases(panels[0], phases, float(end - trial.edges[0]))
    panels[-1].set_xlim(trial.edges[0], end)
    panels[-1].set_xlabel("time since the first frame (s)")
    if len(trial.edges) == 2:  # the width of a single frame has no meaning
        panels[-1].set_xticks([0.0])
    figure.align_ylabels(list(panels))
    return figure


def _colored_outputs(trial: PredictedTrial) -> list[int]:
    # The outputs of the model that have a colour, in order: all outputs, or the most important
    # outputs if there are more outputs than colours.
    num_colors = len(current_theme().palette)
    if len(trial.names) <= num_colors:
        return list(range(len(trial.names)))
    low, high = (
        f.reduce(
            np.where(np.isnan(trial.value), -s * np.inf, trial.value), axis=0, initial=-s * np.inf
        )
        for f, s in ((np.minimum, -1), (np.maximum, 1))
    )
    if trial.task == "regression":
        order = np.argsort(-np.nan_to_num(high - low, neginf=0.0), kind="stable")
        return sorted(order[:num_colors].tolist())
    output_index = {name: i for i, name in enumerate(trial.names)}
    frequency = np.zeros(len(trial.names))  # among the predictions, plus that among the frames
    for labels in trial.predicted:
        frequency[[output_index[name] for name in labels]] += 1 / len(trial.predicted)
    if trial.truth is not None and trial.task == "multiclass":
        true_names, counts = np.unique(trial.truth.value, return_counts=True)
        for name, count in zip(true_names.tolist(), counts.tolist(), strict=True):
            if name in output_index:
                frequency[output_index[name]] += count / len(trial.truth.value)
    elif trial.truth is not None:
        frequency += np.nan_to_num(trial.truth.value).mean(axis=0)
    order = np.lexsort((-high, -frequency))[:num_colors]
    return sorted([i for i in order.tolist() if frequency[i] > 0] or order[:1].tolist())


def _draw_values(ax: "Axes", trial: PredictedTrial, outputs: list[int]) -> None:
    theme = current_theme()
    is_number = trial.task == "regression"
    uncolored = [i for i in range(len(trial.names)) if i not in outputs]
    series = [(trial.value[:, i], series_color(k), trial.names[i]) for k, i in enumerate(outputs)]
    if uncolored and not is_number:
        values = trial.value[:, uncolored]
        count = f"{len(uncolored)} other{'s' if len(uncolored) > 1 else ''}"
        if trial.task == "multiclass":
            series.append((values.sum(axis=1), theme.faint, f"{count}, together"))
        else:
            series.append((values.max(axis=1), theme.faint, f"the highest of {count}"))
    if is_number and trial.truth is not None:
        edges, thin = thin_steps(trial.edges, trial.truth.value[:, outputs])
        for k in range(len(outputs)):
            color, alpha = series_color(k), _TRUTH_OPACITY
            ax.stairs(thin[:, k], edges, baseline=None, color=color, alpha=alpha, linewidth=3.5)
    edges, thin = thin_steps(
        trial.answer_edges, np.stack([value for value, _, _ in series], axis=1)
    )
    for k, (_, color, _) in enumerate(series):
        ax.stairs(thin[:, k], edges, baseline=None, color=color, linewidth=1.4)
    if np.isnan(trial.value).all():  # also true without predictions
        text = "no predictions" if len(trial.value) == 0 else "all predictions are missing (NaN)"
        ax.text(
            0.5, 0.5, text, transform=ax.transAxes, ha="center", color=theme.soft, fontsize=SMALL
        )
    handles = [_legend_line(color) for _, color, _ in series]
    labels = [_legend_name(name) for _, _, name in series]
    if is_number:
        if trial.truth is not None:
            handles.append(_legend_line(theme.soft, alpha=_TRUTH_OPACITY, linewidth=3.5))
            labels.append("pale: true")
        if uncolored:
            handles.append(_legend_line(theme.soft, "none"))
            labels.append(f"{len(uncolored)} more not drawn")
        ax.set_ylabel("predicted\nnumber" if len(series) == 1 else "predicted\nnumbers")
        ax.margins(y=0.08)
    else:
        ax.set_ylabel("probability")
        ax.set_ylim(-0.03, 1.03)
        if trial.task == "multilabel":
            ax.axhline(0.5, color=theme.faint, linewidth=0.8, linestyle=":")
    open_plot(ax)
    _draw_side_legend(ax, handles, labels)


def _draw_touch(panels: Sequence["Axes"], trial: PredictedTrial) -> None:
    from matplotlib.ticker import MaxNLocator

    theme = current_theme()
    if trial.contact is not None:
        ax = panels[-2]
        edges, thin = thin_steps(trial.edges, trial.contact[:, None].astype(np.float64))
        ax.stairs(thin[:, 0], edges, fill=True, color=theme.faint)
        ax.set_ylim(0, 1.08 * max(float(trial.contact.max()), 1.0))
        ax.yaxis.set_major_locator(MaxNLocator(3, integer=True))
        ax.set_ylabel("taxels in\ncontact")
        open_plot(ax)
    ax = panels[-1]
    edges, thin = thin_steps(trial.edges, trial.total[:, None])
    ax.stairs(thin[:, 0], edges, baseline=None, color=theme.ink, linewidth=1.1)
    ax.set_ylim(0, 1.08 * float(trial.total.max()) or 1.0)
    ax.set_ylabel(f"total pressure\n({trial.unit})")
    ax.yaxis.set_major_locator(MaxNLocator(4))
    open_plot(ax)


def _draw_class_lanes(ax: "Axes", trial: PredictedTrial, outputs: list[int]) -> None:
    r"""Draws a lane with the predicted class and, if it is known, a lane with the true class.

    Args:
        ax (matplotlib.axes.Axes): The panel.
        trial (PredictedTrial): The trial.
        outputs (list of int): Outputs of the model that have a colour, in the order of the palette.
    """
    predicted = np.array([p[0] if p else "" for p in trial.predicted], dtype=str)
    lanes = [("predicted", trial.answer_edges, predicted)]
    if trial.truth is not None:
        source = _shorten_middle(trial.truth.source, 14)
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
        _shorten_middle(name, len(name)),
        ha="center",
        va="center_baseline",
        fontsize=TINY,
        color=ink,
    )


def _draw_label_lanes(ax: "Axes", trial: PredictedTrial, outputs: list[int]) -> None:
    r"""Draws a lane for each label, with a thick bar where the label is predicted and a thin bar
    where it is true.

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
    style_lanes(ax, [_shorten_middle(trial.names[i], 20) for i in outputs])
    if trial.truth is not None:
        text = f"thin: true\n({_shorten_middle(trial.truth.source, 14)})"
        _draw_side_legend(ax, [_legend_line(current_theme().ink, "-")], [text])


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


def _legend_line(color: str, style: str = "-", **properties: Any) -> "Line2D":
    r"""Returns the legend handle of a line, with further properties of matplotlib."""
    from matplotlib.lines import Line2D

    return Line2D([], [], **{"color": color, "linestyle": style, "linewidth": 2.0, **properties})


def _draw_side_legend(ax: "Axes", handles: list["Line2D"], labels: list[str]) -> None:
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


def _shorten_middle(name: str, max_length: int) -> str:
    r"""Returns a name on one line. The middle of a long name is omitted, because names with the
    same beginning often differ at the end.
    """
    if len(name) > max_length:
        head = (max_length - 3) // 2
        name = f"{name[:head]}...{name[-(max_length - 3 - head) :]}"
    return plain_text(name.replace("\n", " ")) or " "


def _legend_name(name: str) -> str:
    r"""Returns a name on at most two short lines."""
    if len(name) > 2 * _LEGEND_WIDTH:
        head, tail = name[: _LEGEND_WIDTH - 3], name[-_LEGEND_WIDTH:]
        return f"{plain_text(head)}...\n{plain_text(tail)}"
    return wrap_text(name, _LEGEND_WIDTH) or " "
