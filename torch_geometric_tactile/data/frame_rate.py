r"""Measures the rate of frames from their times."""

import math
from typing import NamedTuple

import numpy as np

from torch_geometric_tactile.data._gaps import ROUNDING

_MAX_GAP_ARRIVALS = 5  # longest pause within a continuous part, in arrival intervals
_MAX_BURST_SECONDS = 1e-4  # frames closer than this were read in one burst
_MAX_BURST_FRAMES = 64
_MIN_BURST_SHARE = 0.2  # if a larger share of the intervals is long, these are arrivals, not gaps
# If this share of the intervals are whole numbers of periods, longer intervals are lost frames.
_MIN_REGULAR_SHARE = 0.9


class Rate(NamedTuple):
    r"""The frame rate measured by :func:`measure_rate`.

    Args:
        rate (float): Frames per second in the parts without gaps; NaN with fewer than two frames.
        arrival (float): Typical time between two arrivals in seconds. Frames that were read
            together count as one arrival.
    """

    rate: float
    arrival: float

    @property
    def max_gap(self) -> float:
        r"""The largest time in seconds between two frames that is not a gap."""
        return _MAX_GAP_ARRIVALS * self.arrival


def measure_rate(time: np.ndarray, max_gap: float | None = None) -> Rate:
    r"""Returns the frame rate of a recording. Gaps are left out, frames that were read together
    count as one arrival, and lost frames do not lower the rate of a regular clock.

    Args:
        time (numpy.ndarray): Increasing times in seconds :math:`(T,)`.
        max_gap (float, optional): The largest time in seconds between two frames that is not a gap.
            The default is five times the typical time between two arrivals.

    Examples:
        >>> time = np.arange(100) / 50.0
        >>> time[50:] += 7.0  # the cable was out
        >>> round(measure_rate(time).rate, 6)
        50.0
    """
    step = np.diff(time)
    if not len(step):
        return Rate(math.nan, math.nan)
    arrival = _arrival_interval(step)
    limit = _MAX_GAP_ARRIVALS * arrival if max_gap is None else max_gap
    is_within = step <= limit * (1 + ROUNDING)
    if not is_within.any():  # there is a gap after each frame
        return Rate(1 / arrival, arrival)
    duration = float(step[is_within].sum())
    periods = step[is_within] / arrival
    num_periods = np.rint(periods)
    is_regular = (np.abs(periods - num_periods) <= 0.25) & (num_periods >= 1)
    if is_regular.mean() >= _MIN_REGULAR_SHARE:  # lost frames count as well
        return Rate(float(num_periods.sum()) / duration, arrival)
    # The frames of the first burst of a part are not counted, since they were measured before the
    # part begins.
    count = float(is_within.sum())
    is_burst = arrival > 1.5 * duration / count
    if is_burst:
        starts = np.flatnonzero(np.concatenate([[True], ~is_within]))
        is_same_burst = step < 0.1 * arrival
        for start in starts[starts < len(step)]:
            next_arrivals = np.flatnonzero(~is_same_burst[start:])
            count -= int(next_arrivals[0]) if len(next_arrivals) else len(step) - start
    return Rate(max(count, 1.0) / duration, arrival)


def _arrival_interval(step: np.ndarray) -> float:
    # The median time between arrivals, which gaps do not affect. Intervals within a burst are left
    # out first.
    intervals = step[step > _MAX_BURST_SECONDS]
    # Bursts longer than any real burst mean that the sensor sends its frames at this interval.
    if len(intervals) * _MAX_BURST_FRAMES < len(step):
        intervals = step
    while True:
        # The lower of the two middle values, which is not a gap if there are only two intervals.
        arrival = float(np.sort(intervals)[(len(intervals) - 1) // 2])
        long_intervals = intervals[intervals > _MAX_GAP_ARRIVALS * arrival]
        if len(long_intervals) < 3 or len(long_intervals) < _MIN_BURST_SHARE * len(intervals):
            return arrival
        intervals = long_intervals
