r"""The figure of a trial that was predicted: its panels one below the other."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from torch_geometric_tactile.visualization._label_lanes import (
    draw_class_lanes,
    draw_label_lanes,
    draw_side_legend,
    legend_line,
    legend_name,
)
from torch_geometric_tactile.visualization._predicted_trial import PredictedTrial, thinned_steps
from torch_geometric_tactile.visualization._style import (
    SMALL,
    current_theme,
    new_figure,
    open_plot,
    series_color,
    title_figure,
)
from torch_geometric_tactile.visualization._time_panels import (
    LANE_HEIGHT,
    blank_gaps,
    draw_annotations,
    name_phases,
    shade_phases,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_PALE = 0.35  # of the true numbers


def draw_trial(trial: PredictedTrial) -> "Figure":
    r"""Draws a trial that was predicted."""
    shown = _shown(trial)
    lanes = len(shown) if trial.task == "multilabel" else (1 + (trial.truth is not None))
    heights = [2.2, *([LANE_HEIGHT * lanes] if trial.task != "regression" else [])]
    heights += [LANE_HEIGHT * len(trial.lanes)] if trial.lanes else []
    heights += [0.8] if trial.contact is not None else []
    heights += [1.1]
    figure = new_figure(8.0, sum(heights) + 1.5)
    panels = figure.subplots(
        len(heights), 1, sharex=True, squeeze=False, gridspec_kw={"height_ratios": heights}
    )[:, 0]
    title = list(trial.title)
    if trial.share_right is not None:
        title.append(f"{100 * trial.share_right:.1f}\xa0%\xa0right")
    title_figure(figure, "  |  ".join(title))
    _draw_values(panels[0], trial, shown)
    if trial.task == "multilabel":
        draw_label_lanes(panels[1], trial, shown)
    elif trial.task == "multiclass":
        draw_class_lanes(panels[1], trial, shown)
    annotated = panels[1 + (trial.task != "regression")] if trial.lanes else None
    if annotated is not None:
        colors = {trial.names[i]: series_color(k) for k, i in enumerate(shown)}
        draw_annotations(annotated, trial.lanes, colors)
    _draw_touch(list(panels), trial)
    end = max(trial.edges[-1], trial.answer_edges[-1])
    phases = [] if trial.truth is not None and trial.truth.source == "phase" else trial.phases
    for ax in panels[-1 - (trial.contact is not None) :]:
        shade_phases(ax, phases)
    for ax in panels:
        if ax is not annotated:
            blank_gaps(ax, trial.gaps)
    name_phases(panels[0], phases, float(end - trial.edges[0]))
    panels[-1].set_xlim(trial.edges[0], end)
    panels[-1].set_xlabel("time since the first frame (s)")
    if len(trial.edges) == 2:  # of one frame, whose width stands for nothing
        panels[-1].set_xticks([0.0])
    figure.align_ylabels(list(panels))
    return figure


def _shown(trial: PredictedTrial) -> list[int]:
    # The outputs that have a colour, in their order.
    most = len(current_theme().palette)
    if len(trial.names) <= most:
        return list(range(len(trial.names)))
    low, high = (
        f.reduce(
            np.where(np.isnan(trial.value), -s * np.inf, trial.value), axis=0, initial=-s * np.inf
        )
        for f, s in ((np.minimum, -1), (np.maximum, 1))
    )
    if trial.task == "regression":
        order = np.argsort(-np.nan_to_num(high - low, neginf=0.0), kind="stable")
        return sorted(order[:most].tolist())
    number = {name: i for i, name in enumerate(trial.names)}
    count = np.zeros(len(trial.names))
    for labels in trial.predicted:
        count[[number[name] for name in labels]] += 1 / len(trial.predicted)
    if trial.truth is not None and trial.task == "multiclass":
        found, times = np.unique(trial.truth.value, return_counts=True)
        for name, n in zip(found.tolist(), times.tolist(), strict=True):
            if name in number:
                count[number[name]] += n / len(trial.truth.value)
    elif trial.truth is not None:
        count += np.nan_to_num(trial.truth.value).mean(axis=0)
    order = np.lexsort((-high, -count))[:most]
    return sorted([i for i in order.tolist() if count[i] > 0] or order[:1].tolist())


def _draw_values(ax: "Axes", trial: PredictedTrial, shown: list[int]) -> None:
    look = current_theme()
    is_number = trial.task == "regression"
    left_out = [i for i in range(len(trial.names)) if i not in shown]
    series = [(trial.value[:, i], series_color(k), trial.names[i]) for k, i in enumerate(shown)]
    if left_out and not is_number:
        rest = trial.value[:, left_out]
        together = trial.task == "multiclass"
        count = f"{len(left_out)} other{'s' if len(left_out) > 1 else ''}"
        name = f"{count}, together" if together else f"the highest of {count}"
        series.append((rest.sum(axis=1) if together else rest.max(axis=1), look.faint, name))
    if is_number and trial.truth is not None:
        edges, thin = thinned_steps(trial.edges, trial.truth.value[:, shown])
        for k in range(len(shown)):
            color = series_color(k)
            ax.stairs(thin[:, k], edges, baseline=None, color=color, alpha=_PALE, linewidth=3.5)
    edges, thin = thinned_steps(
        trial.answer_edges, np.stack([value for value, _, _ in series], axis=1)
    )
    for k, (_, color, _) in enumerate(series):
        ax.stairs(thin[:, k], edges, baseline=None, color=color, linewidth=1.4)
    if np.isnan(trial.value).all():  # also of none
        text = "no answer" if len(trial.value) == 0 else "all answers are missing (NaN)"
        ax.text(
            0.5, 0.5, text, transform=ax.transAxes, ha="center", color=look.soft, fontsize=SMALL
        )
    handles = [legend_line(color) for _, color, _ in series]
    labels = [legend_name(name) for _, _, name in series]
    if is_number:
        if trial.truth is not None:
            handles.append(legend_line(look.soft, alpha=_PALE, linewidth=3.5))
            labels.append("pale: true")
        if left_out:
            handles.append(legend_line(look.soft, "none"))
            labels.append(f"{len(left_out)} more not drawn")
        ax.set_ylabel("predicted\nnumber" if len(series) == 1 else "predicted\nnumbers")
        ax.margins(y=0.08)
    else:
        ax.set_ylabel("probability")
        ax.set_ylim(-0.03, 1.03)
        if trial.task == "multilabel":
            ax.axhline(0.5, color=look.faint, linewidth=0.8, linestyle=":")
    open_plot(ax)
    draw_side_legend(ax, handles, labels)


def _draw_touch(panels: Sequence["Axes"], trial: PredictedTrial) -> None:
    from matplotlib.ticker import MaxNLocator

    look = current_theme()
    if trial.contact is not None:
        ax = panels[-2]
        edges, thin = thinned_steps(trial.edges, trial.contact[:, None].astype(np.float64))
        ax.stairs(thin[:, 0], edges, fill=True, color=look.faint)
        ax.set_ylim(0, 1.08 * max(float(trial.contact.max()), 1.0))
        ax.yaxis.set_major_locator(MaxNLocator(3, integer=True))
        ax.set_ylabel("taxels in\ncontact")
        open_plot(ax)
    ax = panels[-1]
    edges, thin = thinned_steps(trial.edges, trial.total[:, None])
    ax.stairs(thin[:, 0], edges, baseline=None, color=look.ink, linewidth=1.1)
    ax.set_ylim(0, 1.08 * float(trial.total.max()) or 1.0)
    ax.set_ylabel(f"total pressure\n({trial.unit})")
    ax.yaxis.set_major_locator(MaxNLocator(4))
    open_plot(ax)
