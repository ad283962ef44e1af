r"""Pictures of how networks learnt."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, NamedTuple

from torch_geometric_tactile.visualization.figure import new_figure, plain_text
from torch_geometric_tactile.visualization.metrics import _COLORS, _wrapped

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


class LearningCurves(NamedTuple):
    r"""How a network learnt: losses and accuracy after each epoch, and the quantiles 0.05, 0.25,
    0.5, 0.75 and 0.95 of the size of the gradients of each layer.
    """

    train_loss: Sequence[float]
    test_loss: Sequence[float]
    test_accuracy: Sequence[float]
    gradients: Mapping[str, Sequence[float]]


def plot_training(curves: Mapping[str, LearningCurves], title: str) -> "Figure":
    r"""Draws losses and accuracy over the epochs and the sizes of the gradients, a row for each
    network.

    Args:
        curves (Mapping): How each network learnt, by its name.
        title (str): Title of the picture.

    Raises:
        ImportError: If matplotlib is missing.
        ValueError: If there is no network, or one has no epoch.
    """
    if not curves or not all(curve.train_loss for curve in curves.values()):
        raise ValueError("'curves' must hold networks of at least one epoch (got none)")
    figure = new_figure(10.5, 2.6 * len(curves) + 0.9)
    axes = figure.subplots(len(curves), 3, squeeze=False, width_ratios=[1, 1, 1.1])
    for row, (name, curve) in zip(axes, curves.items(), strict=True):
        _draw_losses(row[0], curve)
        _draw_accuracy(row[1], curve)
        _draw_gradients(row[2], curve.gradients)
        row[0].set_title(plain_text(name), fontsize=10, loc="left")
    for ax in axes[-1][:2]:
        ax.set_xlabel("epoch", fontsize=9)
    figure.suptitle(_wrapped(title, 110), fontsize=11)
    return figure


def _draw_losses(ax: "Axes", curve: LearningCurves) -> None:
    for losses, name, color in (
        (curve.train_loss, "training", _COLORS[0]),
        (curve.test_loss, "held out", _COLORS[1]),
    ):
        ax.plot(range(1, len(losses) + 1), losses, color=color, linewidth=1.4, label=name)
    ax.set_ylim(bottom=0)
    ax.set_ylabel("cross entropy", fontsize=9)
    ax.legend(fontsize=8, frameon=False)
    _finish(ax)


def _draw_accuracy(ax: "Axes", curve: LearningCurves) -> None:
    percent = [100 * value for value in curve.test_accuracy]
    ax.plot(range(1, len(percent) + 1), percent, color=_COLORS[1], linewidth=1.4)
    ax.set_ylim(0, 101)
    ax.set_ylabel("accuracy in %, held out", fontsize=9)
    _finish(ax)


def _draw_gradients(ax: "Axes", gradients: Mapping[str, Sequence[float]]) -> None:
    boxes = [
        {"label": plain_text(name), "whislo": low, "q1": q1, "med": median, "q3": q3, "whishi": top}
        for name, (low, q1, median, q3, top) in gradients.items()
    ]
    if boxes:
        ax.bxp(boxes, showfliers=False, medianprops={"color": _COLORS[1], "linewidth": 1.6})
        ax.set_yscale("log")
    ax.set_ylabel("gradient, root mean square", fontsize=9)
    _finish(ax)
    for label in ax.get_xticklabels():
        label.set(fontsize=6, rotation=25, ha="right", rotation_mode="anchor")


def _finish(ax: "Axes") -> None:
    ax.tick_params(labelsize=8)
    ax.grid(color="#dcdcdc", linewidth=0.6)
    ax.set_axisbelow(True)
