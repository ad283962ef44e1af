r"""The figure of the predictions for a trial."""

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
from torch_geometric_tactile.visualization._predicted_trial import PredictedTrial, thin_steps
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
    cover_gaps,
    draw_annotations,
    name_phases,
    shade_phases,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_TRUTH_OPACITY = 0.35  # of the true numbers


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
        draw_label_lanes(panels[1], trial, outputs)
    elif trial.task == "multiclass":
        draw_class_lanes(panels[1], trial, outputs)
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
    if len(trial.edges) == 2:  # a single frame, whose width has no meaning
        panels[-1].set_xticks([0.0])
    figure.align_ylabels(list(panels))
    return figure


def _colored_outputs(trial: PredictedTrial) -> list[int]:
    # Outputs of the model that have a colour, in their order: all, or the most important ones if
    # there are more outputs than colours.
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
    if np.isnan(trial.value).all():  # also without predictions
        text = "no predictions" if len(trial.value) == 0 else "all predictions are missing (NaN)"
        ax.text(
            0.5, 0.5, text, transform=ax.transAxes, ha="center", color=theme.soft, fontsize=SMALL
        )
    handles = [legend_line(color) for _, color, _ in series]
    labels = [legend_name(name) for _, _, name in series]
    if is_number:
        if trial.truth is not None:
            handles.append(legend_line(theme.soft, alpha=_TRUTH_OPACITY, linewidth=3.5))
            labels.append("pale: true")
        if uncolored:
            handles.append(legend_line(theme.soft, "none"))
            labels.append(f"{len(uncolored)} more not drawn")
        ax.set_ylabel("predicted\nnumber" if len(series) == 1 else "predicted\nnumbers")
        ax.margins(y=0.08)
    else:
        ax.set_ylabel("probability")
        ax.set_ylim(-0.03, 1.03)
        if trial.task == "multilabel":
            ax.axhline(0.5, color=theme.faint, linewidth=0.8, linestyle=":")
    open_plot(ax)
    draw_side_legend(ax, handles, labels)


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
