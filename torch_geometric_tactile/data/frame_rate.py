r"""The rate of frames."""

import math
from typing import NamedTuple

import numpy as np

from torch_geometric_tactile.data._gaps import ROUNDING

_GAP_ARRIVALS = 5  # the largest distance in a continuous part
_SAME_READ = 1e-4  # seconds: frames that are closer were read together
_MAX_FRAMES_A_READ = 64
_BURST_SHARE = 0.2  # of long distances, from which on these are arrivals and not gaps
_MIN_REGULAR = 0.9  # of distances that are whole numbers of periods, where frames were lost


class Rate(NamedTuple):
    r"""The rate of frames, as :func:`measure_rate` measures it.

    Args:
        rate (float): Frames per second in the parts without gaps; NaN with fewer than two frames.
        arrival (float): Usual seconds from one arrival to the next; frames that were read together
            are one arrival.
    """

    rate: float
    arrival: float

    @property
    def max_gap(self) -> float:
        r"""The largest distance of two frames, in seconds, that is no gap."""
        return _GAP_ARRIVALS * self.arrival


def measure_rate(time: np.ndarray, max_gap: float | None = None) -> Rate:
    r"""Measures the frames per second of a recording. Gaps count for nothing, frames that were
    read together count as one arrival, and lost frames do not lower the rate of a regular clock.

    Args:
        time (numpy.ndarray): Increasing times in seconds :math:`(T,)`.
        max_gap (float, optional): The largest distance of two frames, in seconds, that is no gap;
            five arrivals if left out.

    Examples:
        >>> time = np.arange(100) / 50.0
        >>> time[50:] += 7.0  # the cable was out
        >>> round(measure_rate(time).rate, 6)
        50.0
    """
    step = np.diff(time)
    if not len(step):
        return Rate(math.nan, math.nan)
    arrival = _arrival(step)
    limit = _GAP_ARRIVALS * arrival if max_gap is None else max_gap
    within = step <= limit * (1 + ROUNDING)
    if not within.any():  # a recording of gaps only
        return Rate(1 / arrival, arrival)
    duration = float(step[within].sum())
    periods = step[within] / arrival
    whole = np.rint(periods)
    is_regular = (np.abs(periods - whole) <= 0.25) & (whole >= 1)
    if is_regular.mean() >= _MIN_REGULAR:  # what is missing between was lost
        return Rate(float(whole.sum()) / duration, arrival)
    # Frames that came with the first arrival of a part took no time.
    count = float(within.sum())
    is_burst = arrival > 1.5 * duration / count
    if is_burst:
        starts = np.flatnonzero(np.concatenate([[True], ~within]))
        together = step < 0.1 * arrival
        for start in starts[starts < len(step)]:
            following = np.flatnonzero(~together[start:])
            count -= int(following[0]) if len(following) else len(step) - start
    return Rate(max(count, 1.0) / duration, arrival)


def _arrival(step: np.ndarray) -> float:
    # The usual distance of two arrivals: a median, since gaps are few, of the distances between
    # reads, since frames of one read are almost at one time.
    between = step[step > _SAME_READ]
    if len(between) * _MAX_FRAMES_A_READ < len(step):  # faster than any host reads: no bursts
        between = step
    while True:
        arrival = float(np.sort(between)[(len(between) - 1) // 2])  # of two, the one without a gap
        longer = between[between > _GAP_ARRIVALS * arrival]
        if len(longer) < 3 or len(longer) < _BURST_SHARE * len(between):
            return arrival
        between = longer
