r"""Differences of two models on the same samples, and which of them are beyond the noise."""

import math
import statistics
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from scipy.stats import t

from torch_geometric_tactile.experiments._scores import LEAST_PAIRS, sample_scores
from torch_geometric_tactile.experiments.predictions import Predictions

if TYPE_CHECKING:  # which runs experiments, that ask here what is beyond the noise
    from torch_geometric_tactile.experiments.run_plan import PlanRun


class Difference(NamedTuple):
    r"""The score of a model less that of another on the same splits, and the one rule for what is
    beyond the noise.

    Args:
        mean (float): The mean over the splits.
        over_splits (float): Its standard error over the splits, corrected for training sets that
            overlap; NaN for less than two.
        over_trials (float): Its standard error over the trials (the samples, where there are no
            trials): samples of one trial count as one observation, however many there are.
        num_splits (int): Number of splits: pairs of models with one training part and seed. Of
            splits that overlap, those with one test part (an object left out, with several seeds)
            are one split, their mean: seeds are no further objects.
        num_trials (int): Number of trials.

    Examples:
        >>> two, five = (Difference(2.8, 0.1, 0.9, n, 600) for n in (2, 5))
        >>> two.verdict, five.verdict, round(five.margin, 2)
        ('too few splits', 'beyond the noise', 1.77)
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
    def margin(self) -> float:
        r"""How far from zero the mean may be by chance: the larger of both standard errors times
        Student's :math:`t` (two-sided, 5 %) of as many pairs; NaN for fewer than three.
        """
        pairs = ((self.over_splits, self.num_splits), (self.over_trials, self.num_trials))
        if min(count for _, count in pairs) < LEAST_PAIRS:
            return math.nan
        return max(float(t.ppf(0.975, count - 1)) * error for error, count in pairs)

    @property
    def is_beyond_noise(self) -> bool:
        r"""Whether the mean is further from zero than :obj:`margin`; false without a verdict."""
        return abs(self.mean) > self.margin

    @property
    def verdict(self) -> str:
        r"""What :data:`RULE` says, in words."""
        if math.isnan(self.margin):
            return "too few splits" if self.num_splits < LEAST_PAIRS else "too few trials"
        return "beyond the noise" if self.is_beyond_noise else "within the noise"


def paired_difference(
    first: Sequence[Predictions], second: Sequence[Predictions], metric: str, overlap: float = 0.0
) -> Difference:
    r"""Compares two models.

    The variance of the mean over :math:`J` splits is :math:`(1 / J + o) \, s^2` with the
    variance :math:`s^2` of single splits and the :obj:`overlap` :math:`o`, as in `"Inference for
    the Generalization Error" <https://doi.org/10.1023/A:1024068626366>`_ (Nadeau and Bengio, 2003).

    Args:
        first (sequence of Predictions): What one said, split by split.
        second (sequence of Predictions): What the other said of the same splits.
        metric (str): :obj:`"accuracy"`, :obj:`"balanced_accuracy"` or :obj:`"mae"`.
        overlap (float): Number of test samples by that of training samples, where the splits are
            drawn from the same samples, so that their training parts overlap.

    Raises:
        ValueError: If the samples are not the same.
    """
    gains, trials = [], []
    of_part: dict[bytes | int, list[float]] = {}
    for i, (a, b) in enumerate(zip(first, second, strict=True)):
        if not np.array_equal(a.y, b.y):
            raise ValueError("'second' must be of the same samples as 'first' (got other labels)")
        gains.append(
            sample_scores(a.y, a.prediction, metric) - sample_scores(b.y, b.prediction, metric)
        )
        samples = np.arange(len(a.y)) if a.index is None else a.index
        trials.append(samples if a.trial is None else a.trial)
        part = np.sort(a.index).tobytes() if overlap and a.index is not None else i
        of_part.setdefault(part, []).append(float(gains[-1].mean()))
    means = np.array([np.mean(values) for values in of_part.values()])
    count = len(means)
    spread = float(means.std(ddof=1)) if count > 1 else math.nan
    error, num_trials = _clustered(float(means.mean()), gains, trials)
    over_splits = spread * math.sqrt(1 / count + overlap)
    return Difference(float(means.mean()), over_splits, error, count, num_trials)


def run_difference(
    run: "PlanRun", first: str, second: str, protocol: str, metric: str = "accuracy"
) -> Difference | None:
    r"""Compares two models on the splits that are finished for both; :obj:`None` if none is.

    Args:
        run (PlanRun): What :func:`run_plan` returned.
        first (str): Name of one experiment.
        second (str): Name of the other.
        protocol (str): What the table calls the protocol.
        metric (str): As of :func:`paired_difference`.
    """
    found: dict[tuple[int, int], dict[str, dict[str, Any]]] = {}
    for e, result in run.results:
        if e.protocol_name == protocol and e.name in (first, second):
            found.setdefault((e.seed, e.fold), {})[e.name] = result
    pairs = [found[split] for split in sorted(found) if len(found[split]) == 2]
    if not pairs:
        return None
    sizes = [pair[first]["num_test"] / pair[first]["num_train"] for pair in pairs]
    is_given = all(p.protocol.by == "given" for p in run.plan.protocols if p.name == protocol)
    one, other = (
        [Predictions.from_dict(pair[name]["predictions"]) for pair in pairs]
        for name in (first, second)
    )
    return paired_difference(one, other, metric, 0.0 if is_given else statistics.fmean(sizes))


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
