r"""How early a slip is announced, and how often one that never comes."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple, Self

import numpy as np

from torch_geometric_tactile._checks import need


@dataclass(frozen=True, eq=False)
class SlipScores:
    r"""What a method says of moments in grasps, before any of them slips.

    Args:
        score (numpy.ndarray): The larger, the sooner a slip is expected :math:`(S,)`.
        to_slip (numpy.ndarray): Seconds from the moment to the onset of slip, above zero; infinite
            in a grasp that holds :math:`(S,)`.
        moment (numpy.ndarray): Seconds since the lift began :math:`(S,)`.
        trial (numpy.ndarray): Number of the grasp :math:`(S,)`.

    Raises:
        ValueError: If the arrays differ in length, a score is not finite, a moment is at or after
            the onset, or the moments of a grasp tell of different onsets.

    Examples:
        >>> scores = SlipScores([0.1, 0.9], [0.5, 0.2], [1.0, 1.3], [0, 0])
        >>> scores.slips
        array([ True,  True])
    """

    score: np.ndarray
    to_slip: np.ndarray
    moment: np.ndarray
    trial: np.ndarray

    def __post_init__(self) -> None:
        for name in ("score", "to_slip", "moment", "trial"):
            object.__setattr__(self, name, np.asarray(getattr(self, name)))
            value = getattr(self, name)
            if value.shape != (len(self.score),):
                raise ValueError(
                    f"'{name}' must have one value a moment, {len(self.score)} (got shape "
                    f"{value.shape})"
                )
        for name in ("score", "moment"):
            if not np.isfinite(getattr(self, name)).all():
                raise ValueError(f"'{name}' must be finite (got NaN or infinity)")
        if np.isnan(self.to_slip).any() or (self.to_slip <= 0).any():
            raise ValueError(
                "'to_slip' must be above zero: leave moments from the onset of slip on out (got "
                f"{np.nanmin(self.to_slip) if len(self.to_slip) else math.nan:g})"
            )
        onset = self.moment + self.to_slip
        for trial in np.unique(self.trial):
            of_trial = onset[self.trial == trial]
            if not np.allclose(of_trial, of_trial[0], atol=1e-3):
                raise ValueError(
                    f"the moments of a grasp must have one onset of slip (got several in {trial})"
                )

    @property
    def slips(self) -> np.ndarray:
        r"""Whether the grasp of each moment slips later :math:`(S,)`."""
        return np.isfinite(self.to_slip)

    def select(self, chosen: np.ndarray) -> Self:
        r"""Returns some of the moments.

        Args:
            chosen (numpy.ndarray): Which ones: indices, or a mask :math:`(S,)`.
        """
        return type(self)(
            self.score[chosen], self.to_slip[chosen], self.moment[chosen], self.trial[chosen]
        )


def alarm_threshold(
    scores: SlipScores,
    false_alarms: float = 0.05,
    before: float | None = None,
    tolerance: float = 0.05,
) -> float:
    r"""Returns the score from which on an alarm is given, such that in grasps that hold at most a
    given part of the moments has one. To be chosen on a validation part.

    Args:
        scores (SlipScores): What a method says.
        false_alarms (float): The part, between zero and one.
        before (float, optional): Count only the moments at which other grasps are this many seconds
            before their slip, as :func:`lead_times` does; all moments if left out.
        tolerance (float): As of :func:`lead_times`.

    Raises:
        ValueError: If no grasp holds, or :obj:`false_alarms` is not between zero and one.

    Examples:
        >>> held = SlipScores([1, 2, 3, 4], [math.inf] * 4, [0, 1, 2, 3], [0] * 4)
        >>> alarm_threshold(held, 0.25)
        4.0
    """
    need(0 < false_alarms < 1, "'false_alarms' must be between 0 and 1", false_alarms)
    rows = ~scores.slips if before is None else _rows_at(scores, before, tolerance)[1]
    held = np.sort(scores.score[rows])
    need(len(held) != 0, "'scores' must have grasps that hold, to count false alarms (got none)")
    allowed = math.floor(false_alarms * len(held) + 1e-9)
    above = held[len(held) - allowed - 1]  # the largest score that must not be an alarm
    larger = held[held > above]
    return float(larger[0] if len(larger) else np.nextafter(above, math.inf))


class LeadTimes(NamedTuple):
    r"""How a method does a given time before the onset of slip.

    Args:
        seconds (numpy.ndarray): The times before the onset :math:`(L,)`.
        recall (numpy.ndarray): Part of the slipping grasps that have an alarm then :math:`(L,)`.
        false_alarms (numpy.ndarray): Part of the holding grasps that have an alarm at the same
            moments since their lift began :math:`(L,)`.
        num_slips (numpy.ndarray): Number of slipping grasps that had a moment then :math:`(L,)`.
    """

    seconds: np.ndarray
    recall: np.ndarray
    false_alarms: np.ndarray
    num_slips: np.ndarray


def lead_times(
    scores: SlipScores, threshold: float, seconds: Sequence[float], tolerance: float = 0.05
) -> LeadTimes:
    r"""Counts alarms by the time that is left before the onset of slip.

    Slips are frequent at certain moments of a plan, such as the first shake, which a clock would
    know as well. False alarms are therefore counted at the moments at which other grasps slip: for
    each slipping grasp and each time before its onset, in all grasps that hold, the same time after
    their lift began.

    Args:
        scores (SlipScores): What a method says of the test part.
        threshold (float): The score from which on there is an alarm, see :func:`alarm_threshold`.
        seconds (sequence of float): Times before the onset, above zero.
        tolerance (float): Seconds by which the nearest moment of a grasp may be off.

    Returns:
        LeadTimes: NaN where no grasp has a moment.
    """
    lead = np.asarray(seconds, dtype=np.float64)
    need(lead.ndim == 1 and (lead > 0).all(), "'seconds' must be times above zero", list(seconds))
    alarm = scores.score >= threshold
    recall, false_alarms = np.full(len(lead), np.nan), np.full(len(lead), np.nan)
    count = np.zeros(len(lead), dtype=np.int64)
    for i, left in enumerate(lead):
        slipping, holding = _rows_at(scores, left, tolerance)
        count[i] = len(slipping)
        if len(slipping):
            recall[i] = alarm[slipping].mean()
        if len(holding):
            false_alarms[i] = alarm[holding].mean()
    return LeadTimes(lead, recall, false_alarms, count)


def _by_trial(scores: SlipScores, chosen: np.ndarray) -> list[np.ndarray]:
    rows = np.flatnonzero(chosen)
    return [rows[scores.trial[rows] == trial] for trial in np.unique(scores.trial[rows])]


def _rows_at(scores: SlipScores, left: float, tolerance: float) -> tuple[np.ndarray, np.ndarray]:
    # The moment of each slipping grasp that is so many seconds before its onset, and those of all
    # holding grasps the same time after their lift began.
    slipping = []
    for rows in _by_trial(scores, scores.slips):
        away = np.abs(scores.to_slip[rows] - left)
        if away.min() <= tolerance:
            slipping.append(rows[away.argmin()])
    moments = scores.moment[slipping]
    holding = []
    for rows in _by_trial(scores, ~scores.slips) if slipping else []:
        away = np.abs(scores.moment[rows][:, None] - moments)
        holding.append(rows[away.argmin(axis=0)[away.min(axis=0) <= tolerance]])
    joined = np.concatenate(holding) if holding else np.zeros(0, dtype=np.int64)
    return np.array(slipping, dtype=np.int64), joined


class SlipSummary(NamedTuple):
    r"""How a method does over whole grasps, from the lift on to the onset of slip or the end.

    Args:
        announced (float): Part of the slipping grasps with an alarm in the last :obj:`within`
            seconds before the onset.
        held_alarmed (float): Part of the holding grasps with an alarm at any moment.
        moments_alarmed (float): Part of the moments of holding grasps with an alarm.
        median_lead (float): Median time from the first alarm within :obj:`within` to the onset, of
            the grasps that were announced, in seconds.
        roc_auc (float): Area under the ROC of single moments: within :obj:`within` of an onset, or
            of a grasp that holds.
    """

    announced: float
    held_alarmed: float
    moments_alarmed: float
    median_lead: float
    roc_auc: float


def slip_summary(scores: SlipScores, threshold: float, within: float) -> SlipSummary:
    r"""Summarises the alarms of a method.

    Args:
        scores (SlipScores): What it says of the test part.
        threshold (float): The score from which on there is an alarm.
        within (float): Seconds before the onset in which an alarm is right.
    """
    from sklearn.metrics import roc_auc_score

    alarm = scores.score >= threshold
    held = ~scores.slips
    soon = scores.to_slip <= within
    leads = []
    slipping = _by_trial(scores, soon)
    for rows in slipping:
        if alarm[rows].any():
            leads.append(float(scores.to_slip[rows][alarm[rows]].max()))
    of_held = [bool(alarm[rows].any()) for rows in _by_trial(scores, held)]
    judged = soon | held
    both = len(np.unique(soon[judged])) > 1
    return SlipSummary(
        announced=len(leads) / len(slipping) if slipping else math.nan,
        held_alarmed=float(np.mean(of_held)) if of_held else math.nan,
        moments_alarmed=float(alarm[held].mean()) if held.any() else math.nan,
        median_lead=float(np.median(leads)) if leads else math.nan,
        roc_auc=float(roc_auc_score(soon[judged], scores.score[judged])) if both else math.nan,
    )
