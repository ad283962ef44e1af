r"""Above which probability class 1 of two is predicted, chosen on a validation part."""

from typing import get_args

import numpy as np
import torch
from torch import Tensor

from torch_geometric_tactile._typing import ThresholdMetric
from torch_geometric_tactile.training._collected_metrics import KeptScores, Task

THRESHOLD_METRICS: tuple[ThresholdMetric, ...] = get_args(ThresholdMetric)


def check_threshold(threshold: float | str | None, task: Task) -> None:
    r"""Checks that a threshold is a probability or the name of a metric, and fits its task."""
    if threshold is None:
        return
    if task != "multiclass":
        raise ValueError(
            f"'threshold' must be left out for task='{task}', it needs two classes (got "
            f"{threshold!r})"
        )
    is_name = isinstance(threshold, str)
    if threshold not in THRESHOLD_METRICS if is_name else not 0 <= float(threshold) <= 1:
        raise ValueError(
            "'threshold' must be a probability, or the metric that chooses it on the "
            f"validation part, one of {list(THRESHOLD_METRICS)} (got {threshold!r})"
        )


def choose_threshold(
    score: np.ndarray, y: np.ndarray, metric: ThresholdMetric, default: float = 0.5
) -> float:
    r"""Returns the threshold with the best metric; of equals, the one nearest to the default. It
    lies halfway between two scores, or is the default itself.

    Examples:
        >>> choose_threshold(np.array([0.1, 0.2, 0.3, 0.4]), np.array([0, 0, 1, 1]), "accuracy")
        0.25

    Shapes:
        - **score:** Higher where class 1 is expected :math:`(S,)`.
        - **y:** Classes 0 and 1 :math:`(S,)`, of the validation part.
    """
    if metric not in THRESHOLD_METRICS:
        raise ValueError(f"'metric' must be one of {list(THRESHOLD_METRICS)} (got '{metric}')")
    score, y = np.asarray(score, dtype=np.float64), np.asarray(y).astype(bool)
    if not len(score) or np.isnan(score).any():
        raise ValueError(f"'score' must hold numbers, none of them NaN (got {score[:10]})")
    if y.all() or not y.any():
        return default
    levels, place = np.unique(score, return_inverse=True)
    # With a threshold above the first i of the different scores, what lies below it is class 0.
    below = [
        np.concatenate(
            [[0], np.cumsum(np.bincount(place.reshape(-1)[mask], minlength=len(levels)))]
        )
        for mask in (y, ~y)
    ]
    found, wrong = (n[-1] - n for n in below)
    value = _values(metric, found, wrong, int(y.sum()), int((~y).sum()))
    edges = np.concatenate([[min(levels[0], default) - 1e-6], levels, [max(levels[-1], default)]])
    low, high = edges[:-1], edges[1:]
    # A score above the threshold is of class 1, so that the lower edge belongs to an interval.
    at_default = (low <= default) & ((default < high) | (np.arange(len(low)) == len(low) - 1))
    threshold = np.where(at_default, default, (low + high) / 2)
    best = np.flatnonzero(value >= value.max() - 1e-12)
    return float(threshold[best[np.abs(threshold[best] - default).argmin()]])


def _values(
    metric: str, found: np.ndarray, wrong: np.ndarray, positive: int, negative: int
) -> np.ndarray:
    # Of each threshold, with the numbers of samples of class 1 and 0 above it.
    missed, right = positive - found, negative - wrong
    if metric == "accuracy":
        return np.asarray((found + right) / (positive + negative))
    if metric == "balanced_accuracy":
        return np.asarray((found / positive + right / negative) / 2)
    of_positive = 2 * found / (2 * found + wrong + missed)
    if metric == "f1_positive":
        return np.asarray(of_positive)
    return np.asarray((of_positive + 2 * right / (2 * right + wrong + missed)) / 2)


class BestThreshold(KeptScores):
    r"""The threshold of :func:`choose_threshold` over all batches, of probabilities of two classes
    :math:`(B, 2)`.
    """

    def __init__(self, metric: ThresholdMetric) -> None:
        super().__init__()
        self.metric = metric

    def compute(self) -> Tensor:
        r"""Returns the threshold for all samples so far."""
        score, y = (value.numpy(force=True) for value in self.kept())
        threshold = choose_threshold(score[:, 1], y, self.metric)
        return torch.tensor(threshold, dtype=torch.float64)
