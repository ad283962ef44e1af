r"""Gaps between frames, and the common rate of several recordings."""

from collections.abc import Mapping, Sequence
from itertools import pairwise

import numpy as np

#: The relative deviation of a rate that is always accepted.
RATE_TOLERANCE = 0.05
#: The relative tolerance in comparisons with a gap or a tick: clocks in float64 and clocks in whole
#: nanoseconds round differently.
ROUNDING = 1e-3
# Up to this ratio between the rates of a trial and the next slower trial, the difference counts as
# jitter of one device.
_MAX_RATE_RATIO = 1.25


def part_numbers(time: np.ndarray, max_gap: float) -> np.ndarray:
    r"""Returns the number of the continuous part to which each frame belongs, counted from zero.

    Args:
        time (numpy.ndarray): Increasing times in seconds :math:`(T,)`.
        max_gap (float): The largest time in seconds between two frames that is not a gap; infinite
            if there are no gaps.

    Returns:
        numpy.ndarray: Integers :math:`(T,)`.

    Examples:
        >>> part_numbers(np.array([0.0, 0.1, 5.0, 5.1]), max_gap=0.5)
        array([0, 0, 1, 1])
    """
    first = np.zeros(min(len(time), 1), np.int64)
    return np.concatenate([first, np.cumsum(gaps_in(time, max_gap))])


def gaps_in(time: np.ndarray, max_gap: float) -> np.ndarray:
    r"""Returns whether there is a gap between each frame and the next one.

    Args:
        time (numpy.ndarray): Increasing times in seconds :math:`(T,)`.
        max_gap (float): The largest time in seconds between two frames that is not a gap.

    Shapes:
        - **output:** booleans :math:`(T - 1,)`
    """
    return np.asarray(np.diff(time) > max_gap * (1 + ROUNDING))


def gaps_of(time: np.ndarray, max_gap: float) -> np.ndarray:
    r"""Returns the last frame before each gap.

    Args:
        time (numpy.ndarray): Increasing times in seconds :math:`(T,)`.
        max_gap (float): The largest time in seconds between two frames that is not a gap.

    Returns:
        numpy.ndarray: Integers :math:`(G,)`.

    Examples:
        >>> gaps_of(np.array([0.0, 0.1, 0.2, 5.0, 5.1]), max_gap=0.5)
        array([2])
    """
    return np.flatnonzero(gaps_in(time, max_gap))


def is_gap(seconds: float, max_gap: float) -> bool:
    r"""Returns whether there is a gap between two frames.

    Args:
        seconds (float): Time between the two frames in seconds.
        max_gap (float): The largest time in seconds that is not a gap.

    Examples:
        >>> is_gap(0.05, max_gap=0.05), is_gap(0.06, max_gap=0.05)
        (False, True)
    """
    return seconds > max_gap * (1 + ROUNDING)


def joined_rate(rates: Mapping[int, float], names: Sequence[str]) -> tuple[float | None, float]:
    r"""Returns the median of several rates and a relative tolerance: 0.05, or the spread of the
    rates if it is larger.

    Args:
        rates (Mapping of int to float): Frames per second by the index of the recording.
        names (sequence of str): Names of the recordings for messages.

    Raises:
        ValueError: If the rates differ by more than the jitter of one device. The message names two
            recordings.
    """
    if not rates:
        return None, RATE_TOLERANCE
    by_rate = sorted(rates, key=rates.__getitem__)
    for slow, fast in pairwise(by_rate):
        if rates[fast] > _MAX_RATE_RATIO * rates[slow]:
            raise ValueError(
                f"windows must be cut from recordings of one rate (got {rates[slow]:.4g} frames "
                f"per second in {names[slow]} and {rates[fast]:.4g} in {names[fast]}): resample "
                f"them with RecordingFrames(resample={rates[slow]:.4g}) or --resample "
                f"{rates[slow]:.4g}"
            )
    rate = float(np.median(list(rates.values())))
    spread = max(abs(value - rate) for value in rates.values()) / rate
    return rate, max(RATE_TOLERANCE, 1.01 * spread)
