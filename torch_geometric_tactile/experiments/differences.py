r"""Paired differences between two models on the same samples, with the rule for significance."""

import math
import statistics
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy.stats import t

from torch_geometric_tactile.experiments._scores import MIN_PAIRS, sample_scores
from torch_geometric_tactile.experiments.plan import PlanRun
from torch_geometric_tactile.experiments.predictions import Predictions


class Signs(NamedTuple):
    r"""The numbers of differences above and below zero."""

    above: int
    below: int


class Difference(NamedTuple):
    r"""The score of one model minus the score of another on the same splits, with standard errors
    and the rule for significance.

    Args:
        mean (float): The mean over the splits.
        over_splits (float): The standard error over the splits, corrected for overlapping training
            sets. NaN for fewer than two splits.
        over_units (float): The standard error over the units that are new in a test part: trials,
            persons, sessions or samples. All samples of a unit count as one observation.
        num_splits (int): Number of splits. Seeds with the same test part (given parts, or one
            held-out object) add no samples. They count as a single split with their mean.
        num_units (int): Number of units.
        unit (str): Name of a unit.
        has_one_test_part (bool): Whether all splits have the same test part, as given parts do.
            Units and seeds then decide.
        splits (Signs): Splits with a difference above and below zero.
        units (Signs): Units with a difference above and below zero.
        over_seeds (float): With a single test part, the standard error of the mean over the seeds.
            NaN for fewer than two seeds.
        num_seeds (int): Number of seeds with a single test part, otherwise 1.

    Examples:
        >>> two, five = (Difference(2.8, 0.1, 0.9, n, 600) for n in (2, 5))
        >>> two.verdict, five.verdict, round(five.margin, 2)
        ('too few splits', 'beyond the noise', 1.77)
    """

    mean: float
    over_splits: float
    over_units: float
    num_splits: int
    num_units: int
    unit: str = "trial"
    has_one_test_part: bool = False
    splits: Signs = Signs(0, 0)
    units: Signs = Signs(0, 0)
    over_seeds: float = math.nan
    num_seeds: int = 1

    @property
    def error(self) -> float:
        r"""The larger of the two standard errors; NaN if neither is finite. The error over units
        includes the error over the seeds of a single test part.
        """
        errors = [e for e in (self.over_splits, self._over_test_part) if math.isfinite(e)]
        return max(errors) if errors else math.nan

    @property
    def _over_test_part(self) -> float:
        # Variances over units and over seeds are independent, and add up.
        return math.hypot(self.over_units, 0.0 if math.isnan(self.over_seeds) else self.over_seeds)

    @property
    def margin(self) -> float:
        r"""The largest distance of the mean from zero that chance explains. This is the standard
        error times Student's :math:`t` (two-sided, 5 %) for the number of splits or units,
        whichever product is larger. NaN for fewer than three splits or units.
        """
        pairs = [(self._over_test_part, self.num_units)]
        if not self.has_one_test_part:
            pairs.append((self.over_splits, self.num_splits))
        if min(count for _, count in pairs) < MIN_PAIRS:
            return math.nan
        return max(float(t.ppf(0.975, count - 1)) * error for error, count in pairs)

    @property
    def is_beyond_noise(self) -> bool:
        r"""Whether the mean is further from zero than :obj:`margin`. False if the margin is NaN."""
        return abs(self.mean) > self.margin

    @property
    def verdict(self) -> str:
        r"""The significance in words."""
        if math.isnan(self.margin):
            needs_splits = not self.has_one_test_part and self.num_splits < MIN_PAIRS
            return "too few splits" if needs_splits else f"too few {self.unit}s"
        return "beyond the noise" if self.is_beyond_noise else "within the noise"

    def is_proved_by(self, num_folds: int) -> bool:
        r"""Returns an estimate of whether more folds would make the difference significant. The
        estimate assumes that the folds vary like these splits, and requires that the difference is
        already significant over the units.

        Args:
            num_folds (int): Number of folds.
        """
        if self.num_splits < 2 or self.num_units < MIN_PAIRS or self.has_one_test_part:
            return False
        is_proved_by_units = (
            abs(self.mean) > float(t.ppf(0.975, self.num_units - 1)) * self.over_units
        )
        old, new = (math.sqrt(1 + n / (n - 1)) for n in (self.num_splits, num_folds))
        over_folds = self.over_splits * new / old  # smaller test parts vary more
        return (
            is_proved_by_units and abs(self.mean) > float(t.ppf(0.975, num_folds - 1)) * over_folds
        )


def paired_difference(
    first: Sequence[Predictions],
    second: Sequence[Predictions],
    metric: str,
    overlap: float = 0.0,
    unit: str | None = None,
) -> Difference:
    r"""Returns the difference between two models on the same samples.

    The variance of the mean over :math:`J` splits is :math:`(1 / J + o) \, s^2` with the
    variance :math:`s^2` of single splits and the :obj:`overlap` :math:`o`, as in `"Inference for
    the Generalization Error" <https://doi.org/10.1023/A:1024068626366>`_ (Nadeau and Bengio, 2003).

    Args:
        first (sequence of Predictions): Predictions of one model for each split. All samples of a
            :obj:`trial` count as one observation. Without trials, each sample is one observation.
        second (sequence of Predictions): Predictions of the other model on the same splits.
        metric (str): :obj:`"accuracy"`, :obj:`"balanced_accuracy"` or :obj:`"mae"`.
        overlap (float): Ratio of test samples to training samples if the splits are drawn from the
            same samples, so that their training parts overlap.
        unit (str, optional): Name of the units in the attribute :obj:`trial` of the predictions, if
            they are not trials.

    Raises:
        ValueError: If the samples are not the same.
    """
    gains, units = [], []
    by_part: dict[bytes | int, list[float]] = {}
    for i, (a, b) in enumerate(zip(first, second, strict=True)):
        if not np.array_equal(a.y, b.y):
            raise ValueError("'second' must have the same samples as 'first' (got other labels)")
        gains.append(
            sample_scores(a.y, a.prediction, metric) - sample_scores(b.y, b.prediction, metric)
        )
        samples = np.arange(len(a.y)) if a.index is None else a.index
        units.append(samples if a.trial is None else a.trial)
        part = i if a.index is None else np.sort(a.index).tobytes()
        by_part.setdefault(part, []).append(float(gains[-1].mean()))
    means = np.array([np.mean(values) for values in by_part.values()])
    count, mean = len(means), float(means.mean())
    spread = float(means.std(ddof=1)) if count > 1 else math.nan
    over_units, num_units, unit_signs = _unit_statistics(mean, gains, units)
    seeds = next(iter(by_part.values())) if count == 1 else [mean]
    return Difference(
        mean,
        spread * math.sqrt(1 / count + overlap),
        over_units,
        count,
        num_units,
        unit or ("sample" if first[0].trial is None else "trial"),
        has_one_test_part=count == 1,
        splits=_count_signs(means),
        units=unit_signs,
        over_seeds=float(np.std(seeds, ddof=1)) / math.sqrt(len(seeds))
        if len(seeds) > 1
        else math.nan,
        num_seeds=len(seeds),
    )


def run_difference(
    run: PlanRun,
    first: str,
    second: str,
    protocol: str,
    metric: str = "accuracy",
    *,
    unit: str | None = None,
    with_units: Callable[[Predictions], Predictions] = lambda predictions: predictions,
) -> Difference | None:
    r"""Returns the difference between two models on the splits that are finished for both, or
    :obj:`None` if there are no such splits.

    Args:
        run (PlanRun): The run of a plan.
        first (str): Name of the first experiment.
        second (str): Name of the experiment whose score is subtracted.
        protocol (str): Name of the protocol in the table.
        metric (str): As in :func:`paired_difference`.
        unit (str, optional): As in :func:`paired_difference`.
        with_units (callable): Returns predictions whose :obj:`trial` is the unit of each sample.
    """
    by_split: dict[tuple[int, int], dict[str, dict[str, Any]]] = {}
    for e, result in run.results:
        if e.protocol_name == protocol and e.name in (first, second):
            by_split.setdefault((e.seed, e.fold), {})[e.name] = result
    pairs = [by_split[split] for split in sorted(by_split) if len(by_split[split]) == 2]
    if not pairs:
        return None
    sizes = [pair[first]["num_test"] / pair[first]["num_train"] for pair in pairs]
    is_given = all(p.protocol.by == "given" for p in run.plan.protocols if p.name == protocol)
    first_predictions, second_predictions = (
        [with_units(Predictions.from_dict(pair[name]["predictions"])) for pair in pairs]
        for name in (first, second)
    )
    overlap = 0.0 if is_given else statistics.fmean(sizes)
    return paired_difference(first_predictions, second_predictions, metric, overlap, unit)


def _unit_statistics(
    mean: float, gains: Sequence[np.ndarray], units: Sequence[np.ndarray]
) -> tuple[float, int, Signs]:
    # Returns the standard error of the mean over splits (the contribution of a unit is one
    # observation), the number of units, and the signs of their gains.
    names, unit_index = np.unique(np.concatenate(units), return_inverse=True)
    unit_index = unit_index.reshape(-1)
    signs = _count_signs(np.bincount(unit_index, np.concatenate(gains), minlength=len(names)))
    if len(names) < 2:
        return math.nan, len(names), signs
    share = np.concatenate([(gain - mean) / len(gain) for gain in gains]) / len(gains)
    by_unit = np.bincount(unit_index, share, minlength=len(names))
    scale = len(names) / (len(names) - 1)
    return float(math.sqrt(scale * np.square(by_unit).sum())), len(names), signs


def _count_signs(values: np.ndarray) -> Signs:
    rounding = 1e-12  # sums of equal scores may differ by rounding
    return Signs(int((values > rounding).sum()), int((values < -rounding).sum()))
