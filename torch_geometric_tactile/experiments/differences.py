r"""Differences of two models on the same samples, with their uncertainty."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from torch_geometric_tactile.experiments.judgement import Judgement
from torch_geometric_tactile.experiments.scores import sample_scores


class Difference(NamedTuple):
    r"""The score of a model less that of another on the same splits.

    Args:
        mean (float): The mean over the splits.
        over_splits (float): Its standard error over the splits, which takes them for independent
            although they share training samples; NaN for less than two.
        over_trials (float): Its standard error over the trials (the samples, where there are no
            trials): samples of one trial count as one observation, however many there are.
        num_splits (int): Number of splits.
        num_trials (int): Number of trials.
    """

    mean: float
    over_splits: float
    over_trials: float
    num_splits: int
    num_trials: int

    @property
    def error(self) -> float:
        r"""The larger of both standard errors."""
        found = [e for e in (self.over_splits, self.over_trials) if math.isfinite(e)]
        return max(found) if found else math.nan

    @property
    def is_beyond_noise(self) -> bool:
        r"""Whether the mean is more than twice the larger standard error from zero."""
        return math.isfinite(self.error) and abs(self.mean) > 2 * self.error


def paired_difference(
    first: Sequence[Judgement], second: Sequence[Judgement], metric: str
) -> Difference:
    r"""Compares two models.

    Args:
        first (sequence of Judgement): What one said, split by split.
        second (sequence of Judgement): What the other said of the same splits.
        metric (str): :obj:`"accuracy"`, :obj:`"balanced_accuracy"` or :obj:`"mae"`.
    """
    gains, trials = [], []
    for a, b in zip(first, second, strict=True):
        if not np.array_equal(a.y, b.y):
            raise ValueError("'second' must be of the same samples as 'first' (got other labels)")
        gains.append(
            sample_scores(a.y, a.prediction, metric) - sample_scores(b.y, b.prediction, metric)
        )
        trials.append(np.arange(len(a.y)) if a.trial is None else a.trial)
    means = np.array([gain.mean() for gain in gains])
    over_splits = float(means.std(ddof=1) / math.sqrt(len(means))) if len(means) > 1 else math.nan
    if any(judgement.trial is None for judgement in first):
        # Folds of one seed have no sample in common, and those of others are not matched.
        starts = np.cumsum([0, *(len(gain) for gain in gains[:-1])])
        trials = [trial + start for trial, start in zip(trials, starts, strict=True)]
    error, count = _clustered(means.mean(), gains, trials)
    return Difference(float(means.mean()), over_splits, error, len(means), count)


def _clustered(
    mean: float, gains: Sequence[np.ndarray], trials: Sequence[np.ndarray]
) -> tuple[float, int]:
    # The standard error of the mean over splits, where what a trial adds is one observation.
    names, place = np.unique(np.concatenate(trials), return_inverse=True)
    if len(names) < 2:
        return math.nan, len(names)
    share = np.concatenate([(gain - mean) / len(gain) for gain in gains]) / len(gains)
    of_trial = np.bincount(place.reshape(-1), share, minlength=len(names))
    scale = len(names) / (len(names) - 1)
    return float(math.sqrt(scale * np.square(of_trial).sum())), len(names)
