r"""Pictures of classification results: confusion matrices, ROC curves and accuracies."""

from collections.abc import Mapping, Sequence
from math import ceil, floor, isfinite
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from torch_geometric_tactile._checks import need
from torch_geometric_tactile.visualization._style import (
    DASHES,
    MAX_WIDTH,
    SMALL,
    TEXT,
    colormap,
    current_theme,
    fit_text,
    ink_on,
    new_figure,
    open_plot,
    plain_text,
    series_color,
    series_marker,
    title_axes,
    title_figure,
    wrap_text,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_Accuracy = tuple[float, float]
_AXIS_START = 0.4  # start of the axis of accuracies, unless a result is lower
_ROC_SIZE = 4.4  # inches
_MAX_CLASSES_WITH_COUNTS = 12  # in a matrix with more classes, counts would not be readable


def plot_confusion(matrix: ArrayLike, class_names: Sequence[str], title: str) -> "Figure":
    r"""Draws a confusion matrix with counts and with the percentages of each row. For more than 12
    classes, only percentages are drawn.

    Args:
        matrix (array): Counts. Rows are true classes, and columns are predicted classes.
        class_names (sequence of str): Names of the :math:`C` classes.
        title (str): Title of the picture.

    Shapes:
        - **matrix:** :math:`(C, C)`

    Raises:
        ImportError: If matplotlib is missing.
        ValueError: If :obj:`matrix` is not square, if it does not have one row per name, or if it
            contains numbers that are not counts.

    Examples:
        >>> figure = plot_confusion([[3, 1], [0, 4]], ["stable", "slip"], "Unseen objects")
        >>> [text.get_text() for text in figure.axes[0].texts][:2]
        ['3\n75.0 %', '1\n25.0 %']
    """
    counts = np.asarray(matrix)
    num_classes = len(class_names)
    if counts.shape != (num_classes, num_classes) or num_classes == 0:
        raise ValueError(
            f"'matrix' must have shape ({num_classes}, {num_classes}), one row per class name "
            f"(got {counts.shape})"
        )
    _check_counts("matrix", counts)
    is_large = num_classes > _MAX_CLASSES_WITH_COUNTS
    side = max(3.2, min((0.27 if is_large else 0.8) * num_classes + 0.6, MAX_WIDTH - 1.0))
    figure = new_figure(side + 1.0, side + 0.8)
    ax = figure.add_subplot()
    (_draw_percentages if is_large else _draw_counts)(ax, counts)
    names = [wrap_text(name.replace("_", " "), 12) for name in class_names]
    ax.set_xticks(range(num_classes), names)
    ax.set_yticks(range(num_classes), names)
    ax.set_xlabel("predicted class")
    ax.set_ylabel("true class")
    title_figure(figure, title)
    return figure


def _draw_percentages(ax: "Axes", counts: np.ndarray) -> None:
    percent = 100 * counts / np.maximum(counts.sum(axis=1, keepdims=True), 1)
    texts = [
        "" if value == 0 else f"{value:.0f}" if value >= 99.95 else f"{value:.1f}"
        for value in percent.flat
    ]
    _draw_cells(ax, percent, texts, 100.0, fontsize=6)


def _check_counts(name: str, counts: np.ndarray) -> None:
    if not (np.isfinite(counts) & (counts >= 0) & (counts == np.round(counts))).all():
        raise ValueError(f"'{name}' must hold counts (got fractional or negative numbers)")


def _draw_counts(ax: "Axes", counts: np.ndarray) -> None:
    row_totals = np.broadcast_to(counts.sum(axis=1, keepdims=True), counts.shape)
    shares = counts / np.maximum(row_totals, 1)
    texts = [
        f"{int(count):,}\n" + (f"{100 * share:.1f} %" if row_total else "-")
        for count, share, row_total in zip(counts.flat, shares.flat, row_totals.flat, strict=True)
    ]
    size = TEXT + 1 if len(counts) < 4 else SMALL
    _draw_cells(ax, shares, texts, 1.0, fontsize=size, linespacing=1.3)


def _draw_cells(
    ax: "Axes", shares: np.ndarray, texts: list[str], full_share: float, **properties: Any
) -> None:
    image = ax.imshow(shares, cmap=colormap("share"), vmin=0.0, vmax=full_share)
    for ((row, column), share), text in zip(np.ndenumerate(shares), texts, strict=True):
        if text:
            ink = ink_on(tuple(image.to_rgba(share)))
            ax.text(column, row, text, ha="center", va="center", color=ink, **properties)
    ax.tick_params(length=0)


def plot_label_confusions(
    matrices: ArrayLike, label_names: Sequence[str], title: str, columns: int = 3
) -> "Figure":
    r"""Draws a 2 x 2 confusion matrix (absent and present) for each label, for samples that may
    have several labels.

    Args:
        matrices (array): Counts. The matrix of a label is :obj:`[[true negative, false positive],
            [false negative, true positive]]`.
        label_names (sequence of str): Names of the :math:`C` labels.
        title (str): Title of the picture.
        columns (int): Largest number of labels side by side.

    Shapes:
        - **matrices:** :math:`(C, 2, 2)`

    Raises:
        ImportError: If matplotlib is missing.
        ValueError: If :obj:`matrices` has another shape or contains numbers that are not counts,
            or if :obj:`columns` is below one.

    Examples:
        >>> figure = plot_label_confusions([[[3, 1], [0, 4]]], ["soft"], "Labels")
        >>> figure.axes[0].get_title()
        'soft'
    """
    counts = np.asarray(matrices)
    num_labels = len(label_names)
    if counts.shape != (num_labels, 2, 2) or num_labels == 0:
        raise ValueError(
            f"'matrices' must have shape ({num_labels}, 2, 2), one for each label name "
            f"(got {counts.shape})"
        )
    _check_counts("matrices", counts)
    need(columns >= 1, "'columns' must be at least 1", columns)
    columns = min(columns, num_labels)
    rows = ceil(num_labels / columns)
    figure = new_figure(2.4 * columns + 0.2, 2.6 * rows + 0.5)
    axes = figure.subplots(rows, columns, squeeze=False)
    for ax, name, count in zip(axes.flat, label_names, counts, strict=False):
        _draw_counts(ax, count)
        ax.set_xticks((0, 1), ("no", "yes"))
        ax.set_yticks((0, 1), ("no", "yes"))
        ax.set_xlabel("predicted")
        ax.set_ylabel("true")
        title_axes(ax, wrap_text(name, 26))
    for ax in axes.flat[num_labels:]:
        ax.set_visible(False)
    title_figure(figure, title)
    return figure


def plot_roc(
    curves: Mapping[str, tuple[ArrayLike, ArrayLike, float]], title: str, bold: str | None = None
) -> "Figure":
    r"""Draws receiver operating characteristic (ROC) curves and the diagonal of chance.

    Args:
        curves (Mapping of str to tuple): False positive rates, true positive rates and the area
            under the curve, for each model, class or label.
        title (str): Title of the picture.
        bold (str, optional): Name of a curve to draw black and thick, such as a mean.

    Shapes:
        - **false positive rates, true positive rates:** :math:`(P,)`

    Raises:
        ImportError: If matplotlib is missing.
        ValueError: If there are no curves, or if rates differ in length or lie outside of 0 to 1.

    Examples:
        >>> figure = plot_roc({"SVM": ([0, 0.5, 1], [0, 1, 1], 0.75)}, "Unseen objects")
        >>> [text.get_text() for text in figure.legends[0].get_texts()]
        ['SVM (AUC 0.750)', 'chance (AUC 0.500)']
    """
    need(curves, "'curves' must hold at least one model (got none)")
    need(bold is None or bold in curves, f"'bold' must be the name of a curve (got '{bold}')")
    rates = {}
    for name, (fpr, tpr, _) in curves.items():
        rate = np.asarray(fpr, dtype=float), np.asarray(tpr, dtype=float)
        if rate[0].ndim != 1 or rate[0].shape != rate[1].shape:
            raise ValueError(
                f"'curves' must hold rates with the same length (got {rate[0].shape} and "
                f"{rate[1].shape} for '{name}')"
            )
        if not all(((values >= 0) & (values <= 1)).all() for values in rate):
            raise ValueError(f"'curves' must hold rates from 0 to 1 (got other rates for '{name}')")
        rates[name] = rate
    labels = [plain_text(f"{name} (AUC {auc:.3f})") for name, (_, _, auc) in curves.items()]
    labels.append("chance (AUC 0.500)")
    legend_width = 0.075 * max(len(label) for label in labels) + 0.6
    is_below = legend_width + _ROC_SIZE > MAX_WIDTH
    figure = new_figure(
        _ROC_SIZE + (0.4 if is_below else legend_width), _ROC_SIZE + 0.2 * is_below * len(labels)
    )
    ax = figure.add_subplot()
    theme = current_theme()
    num_colors = len(theme.palette) - (bold is not None)  # the bold curve has the last colour
    handles = []
    for i, (name, rate) in enumerate(rates.items()):
        color, dash = theme.palette[i % num_colors], DASHES[i // num_colors % 3]
        if name == bold:  # drawn below the other curves, which it would hide
            handles += ax.plot(*rate, color=theme.ink, linewidth=3.0, zorder=1.9)
        else:
            handles += ax.plot(*rate, color=color, linestyle=dash, linewidth=1.6)
    handles += ax.plot([0, 1], [0, 1], color=theme.faint, linestyle=":", linewidth=1.2)
    ax.set_xlim(-0.01, 1.01)
    ax.set_ylim(-0.01, 1.01)
    ax.set_aspect("equal")
    ax.set_xlabel("false positive rate")
    ax.set_ylabel("true positive rate")
    open_plot(ax)
    title_figure(figure, title)
    location = "outside lower center" if is_below else "outside right center"
    figure.legend(handles, labels, loc=location)
    return figure


def plot_protocols(
    table: Mapping[str, Mapping[str, Mapping[str, _Accuracy]]], chance: float | None = None
) -> "Figure":
    r"""Draws the accuracy of models under several protocols. There is a line for each model and
    kind of readings, and a panel for each protocol. The means are written in percent beside the
    points.

    The axis runs from 0.4 to 1.0, and starts lower only if a result is lower. Means are drawn as
    points, because the lengths of bars would mislead on an axis that does not start at zero.

    Args:
        table (Mapping): Mean and standard deviation of the accuracy by model, protocol and kind of
            readings. Each kind of readings has a colour. Missing combinations are left out. If the
            standard deviation is NaN, the point is hollow and has no error bar.
        chance (float, optional): Accuracy to mark with a dashed line, such as the accuracy of the
            most frequent class.

    Raises:
        ImportError: If matplotlib is missing.
        ValueError: If there are no results, or if an accuracy lies outside of 0 to 1.

    Examples:
        >>> table = {"SVM": {"by object": {"raw": (0.87, 0.02)}}}
        >>> figure = plot_protocols(table, chance=0.5)
        >>> figure.axes[0].get_title()
        'by object'
    """
    results = [
        (model, protocol, readings, mean, sd)
        for model, protocols in table.items()
        for protocol, kinds in protocols.items()
        for readings, (mean, sd) in kinds.items()
    ]
    need(results, "'table' must hold at least one result (got none)")
    for model, protocol, readings, mean, _ in results:
        if not 0 <= mean <= 1:
            raise ValueError(
                f"'table' must hold accuracies from 0 to 1 (got {mean} for '{model}', "
                f"'{protocol}', '{readings}')"
            )
    # dict.fromkeys keeps the order of first appearance.
    lines = list(dict.fromkeys((model, readings) for model, _, readings, *_ in results))
    models = list(dict.fromkeys(model for model, _ in lines))
    lines.sort(key=lambda line: models.index(line[0]))
    protocols = list(dict.fromkeys(protocol for _, protocol, *_ in results))
    kinds = list(dict.fromkeys(readings for _, readings in lines))
    lower_ends = [mean - (sd if isfinite(sd) else 0.0) for *_, mean, sd in results]
    lowest = min(lower_ends + ([] if chance is None else [chance]))
    limits = (max(0.0, min(_AXIS_START, floor(lowest * 10) / 10)), 1.0)
    names = [", ".join(filter(None, line)) for line in lines]
    names_width = 0.065 * max(map(len, names)) + 0.3
    panel_width = max(0.9, min(1.5, (MAX_WIDTH - names_width) / len(protocols)))
    figure = new_figure(names_width + panel_width * len(protocols), 0.27 * len(lines) + 1.1)
    theme = current_theme()

    from matplotlib.ticker import MaxNLocator

    axes = figure.subplots(1, len(protocols), sharey=True, squeeze=False)[0]
    for ax, protocol in zip(axes, protocols, strict=True):
        for model in models[::2]:
            model_lines = [i for i, line in enumerate(lines) if line[0] == model]
            start, end = model_lines[0] - 0.5, model_lines[-1] + 0.5
            ax.axhspan(start, end, color=theme.band, zorder=0, linewidth=0)
        if chance is not None:
            ax.axvline(chance, color=theme.faint, linestyle="--", linewidth=1)
        for model, result_protocol, readings, mean, sd in results:
            if result_protocol == protocol:
                kind = kinds.index(readings)
                _draw_accuracy(ax, mean, lines.index((model, readings)), sd, kind, limits)
        ax.set_xlim(*limits)
        # Without pruning, the last tick label would touch the first tick label of the next panel.
        ax.xaxis.set_major_locator(MaxNLocator(3, steps=[1, 2, 5, 10], prune="both"))
        ax.tick_params(axis="y", length=0, labelcolor=theme.ink)
        open_plot(ax, "x")
        title_axes(ax, fit_text(protocol, panel_width - 0.1, TEXT))
    axes[0].set_yticks(range(len(lines)), [plain_text(name) for name in names])
    axes[0].set_ylim(len(lines) - 0.5, -0.5)
    axes[len(axes) // 2].set_xlabel("accuracy")
    return figure


def _draw_accuracy(
    ax: "Axes", mean: float, line: int, sd: float, kind: int, limits: tuple[float, float]
) -> None:
    color, ground = series_color(kind), current_theme().ground
    has_spread = isfinite(sd)
    sd = sd if has_spread else 0.0
    ax.errorbar(
        [mean],
        [line],
        xerr=[sd],
        linestyle="none",
        marker=series_marker(kind),
        color=color,
        markersize=5.5,
        markerfacecolor=color if has_spread else ground,
        markeredgecolor=ground if has_spread else color,
        markeredgewidth=0.4 if has_spread else 1.2,
        elinewidth=1.1,
        capsize=1.8,
    )
    # The number is on the side of the point with more space.
    is_left = mean > sum(limits) / 2
    ax.annotate(
        f"{100 * mean:.1f}",
        (mean - sd if is_left else mean + sd, line),
        (-5, 0) if is_left else (5, 0),
        textcoords="offset points",
        ha="right" if is_left else "left",
        va="center_baseline",
        fontsize=SMALL,
        color=current_theme().ink,
        bbox={"facecolor": ground, "edgecolor": "none", "alpha": 0.6, "pad": 0.5},
    )
