r"""Selects the probability above which class 1 of two is predicted, on a validation part."""

from typing import get_args

import numpy as np
import torch
from torch import Tensor

from torch_geometric_tactile._typing import ThresholdMetric
from torch_geometric_tactile.training._collected_metrics import StoredScores, Task

THRESHOLD_METRICS: tuple[ThresholdMetric, ...] = get_args(ThresholdMetric)


def check_threshold(threshold: float | str | None, task: Task) -> None:
    r"""Checks that a threshold is a probability or the name of a metric, and that the task allows a
    threshold.
    """
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
            "'threshold' must be a probability, or the metric that selects it on the "
            f"validation part, one of {list(THRESHOLD_METRICS)} (got {threshold!r})"
        )


def choose_threshold(
    score: np.ndarray, y: np.ndarray, metric: ThresholdMetric, default: float = 0.5
) -> float:
    r"""Returns the threshold with the best metric. Of equally good thresholds, the one nearest to
    the default is returned. It lies halfway between two scores, or is the default itself.

    Examples:
        >>> choose_threshold(np.array([0.1, 0.2, 0.3, 0.4]), np.array([0, 0, 1, 1]), "accuracy")
        0.25

    Shapes:
        - **score:** Scores of class 1 :math:`(S,)`.
        - **y:** Classes 0 and 1 :math:`(S,)`, of the validation part.
    """
    if metric not in THRESHOLD_METRICS:
        raise ValueError(f"'metric' must be one of {list(THRESHOLD_METRICS)} (got '{metric}')")
    score, y = np.asarray(score, dtype=np.float64), np.asarray(y).astype(bool)
    if not len(score) or np.isnan(score).any():
        raise ValueError(f"'score' must hold numbers, none of them NaN (got {score[:10]})")
    if y.all() or not y.any():
        return default
    distinct_scores, rank = np.unique(score, return_inverse=True)
    # Element i counts the samples of class 1, and then of class 0, among the i lowest distinct
    # scores. A threshold above these scores predicts class 0 for them.
    num_below = [
        np.concatenate(
            [[0], np.cumsum(np.bincount(rank.reshape(-1)[mask], minlength=len(distinct_scores)))]
        )
        for mask in (y, ~y)
    ]
    tp, fp = (counts[-1] - counts for counts in num_below)
    values = _metric_values(metric, tp, fp, int(y.sum()), int((~y).sum()))
    edges = np.concatenate(
        [
            [min(distinct_scores[0], default) - 1e-6],
            distinct_scores,
            [max(distinct_scores[-1], default)],
        ]
    )
    low, high = edges[:-1], edges[1:]
    # A score equal to the threshold predicts class 0, so each interval includes its lower edge.
    contains_default = (low <= default) & ((default < high) | (np.arange(len(low)) == len(low) - 1))
    threshold = np.where(contains_default, default, (low + high) / 2)
    best = np.flatnonzero(values >= values.max() - 1e-12)
    return float(threshold[best[np.abs(threshold[best] - default).argmin()]])


def _metric_values(
    metric: str, tp: np.ndarray, fp: np.ndarray, num_positive: int, num_negative: int
) -> np.ndarray:
    # The metric at each threshold, from the numbers of samples of class 1 and class 0 above it.
    fn, tn = num_positive - tp, num_negative - fp
    if metric == "accuracy":
        return np.asarray((tp + tn) / (num_positive + num_negative))
    if metric == "balanced_accuracy":
        return np.asarray((tp / num_positive + tn / num_negative) / 2)
    f1_positive = 2 * tp / (2 * tp + fp + fn)
    if metric == "f1_positive":
        return np.asarray(f1_positive)
    return np.asarray((f1_positive + 2 * tn / (2 * tn + fp + fn)) / 2)


class BestThreshold(StoredScores):
    r"""A metric that computes the threshold of :func:`choose_threshold` from the probabilities
    :math:`(B, 2)` of all batches.
    """

    def __init__(self, metric: ThresholdMetric) -> None:
        super().__init__()
        self.metric = metric

    def compute(self) -> Tensor:
        r"""Returns the threshold for all samples so far."""
        score, y = (tensor.numpy(force=True) for tensor in self.scores_and_targets())
        threshold = choose_threshold(score[:, 1], y, self.metric)
        return torch.tensor(threshold, dtype=torch.float64)
