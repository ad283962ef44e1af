r"""Pictures of network training: losses, accuracy and gradients."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, NamedTuple

from torch_geometric_tactile.visualization._style import (
    TINY,
    current_theme,
    new_figure,
    open_plot,
    plain_text,
    series_color,
    title_axes,
    title_figure,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


class LearningCurves(NamedTuple):
    r"""The losses and the accuracy of a network after each epoch, and the quantiles 0.05, 0.25,
    0.5, 0.75 and 0.95 of the root mean square of the gradients of each layer.

    Examples:
        >>> curves = LearningCurves([2.0, 1.0], [2.1, 1.5], [0.2, 0.6], {})
        >>> curves.test_accuracy[-1]
        0.6
    """

    train_loss: Sequence[float]
    test_loss: Sequence[float]
    test_accuracy: Sequence[float]
    gradients: Mapping[str, Sequence[float]]


def plot_training(curves: Mapping[str, LearningCurves], title: str) -> "Figure":
    r"""Draws the losses and the accuracy over the epochs, and the distribution of the gradients of
    each layer, with one row per network.

    Args:
        curves (Mapping): Learning curves by the name of the network.
        title (str): Title of the picture.

    Raises:
        ImportError: If matplotlib is missing.
        ValueError: If there are no networks, or a network has no epochs.

    Examples:
        >>> curves = LearningCurves([2.0, 1.0], [2.1, 1.5], [0.2, 0.6], {})
        >>> figure = plot_training({"GCN": curves}, "Training of a GCN")
        >>> [ax.get_ylabel() for ax in figure.axes]
        ['cross entropy', 'accuracy in %,\nheld out', 'gradient,\nroot mean square']
    """
    if not curves or not all(curve.train_loss for curve in curves.values()):
        raise ValueError("'curves' must hold networks with at least one epoch (got none)")
    figure = new_figure(8.0, 2.1 * len(curves) + 0.8)
    axes = figure.subplots(len(curves), 3, squeeze=False, width_ratios=[1, 1, 1.1])
    for row, (name, curve) in zip(axes, curves.items(), strict=True):
        _draw_losses(row[0], curve)
        _draw_accuracy(row[1], curve)
        _draw_gradients(row[2], curve.gradients)
        title_axes(row[0], plain_text(name), loc="left", weight="bold")
    for ax in axes[-1][:2]:
        ax.set_xlabel("epoch")
    title_figure(figure, title)
    return figure


def _draw_losses(ax: "Axes", curve: LearningCurves) -> None:
    for losses, name, color in (
        (curve.train_loss, "training", series_color(0)),
        (curve.test_loss, "held out", series_color(1)),
    ):
        ax.plot(range(1, len(losses) + 1), losses, color=color, linewidth=1.5, label=name)
    ax.set_ylim(bottom=0)
    ax.set_ylabel("cross entropy")
    ax.legend(fontsize=8, frameon=False, labelcolor=current_theme().ink)
    open_plot(ax)


def _draw_accuracy(ax: "Axes", curve: LearningCurves) -> None:
    percent = [100 * value for value in curve.test_accuracy]
    ax.plot(range(1, len(percent) + 1), percent, color=series_color(1), linewidth=1.5)
    ax.set_ylim(0, 101)
    ax.set_ylabel("accuracy in %,\nheld out")
    open_plot(ax)


def _draw_gradients(ax: "Axes", gradients: Mapping[str, Sequence[float]]) -> None:
    boxes = [
        {
            "label": plain_text(name),
            "whislo": low,
            "q1": quarter,
            "med": median,
            "q3": three_quarters,
            "whishi": high,
        }
        for name, (low, quarter, median, three_quarters, high) in gradients.items()
    ]
    if boxes:
        line_style = {"color": current_theme().soft}
        ax.bxp(
            boxes,
            showfliers=False,
            boxprops=line_style,
            whiskerprops=line_style,
            capprops=line_style,
            medianprops={"color": series_color(1), "linewidth": 1.8},
        )
        ax.set_yscale("log")
    ax.set_ylabel("gradient,\nroot mean square")
    open_plot(ax)
    for label in ax.get_xticklabels():
        label.set(fontsize=TINY, rotation=30, ha="right", rotation_mode="anchor")
