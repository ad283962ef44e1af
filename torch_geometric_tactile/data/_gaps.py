r"""Gaps between frames, and the rate that several recordings have in common."""

from collections.abc import Mapping, Sequence
from itertools import pairwise

import numpy as np

#: The relative deviation of a rate that is always accepted.
RATE_TOLERANCE = 0.05
#: The part of a gap or of a tick by which clocks in float64 and in nanoseconds differ.
ROUNDING = 1e-3
_MAX_RATE_RATIO = 1.25  # of a trial and the next slower one: a larger step is another rate


def part_numbers(time: np.ndarray, max_gap: float) -> np.ndarray:
    r"""Returns the number of the continuous part of each frame, from zero on.

    Args:
        time (numpy.ndarray): Increasing times in seconds :math:`(T,)`.
        max_gap (float): The largest distance of two frames, in seconds, that is no gap; infinite
            if there are none.

    Returns:
        numpy.ndarray: Integers :math:`(T,)`.

    Examples:
        >>> part_numbers(np.array([0.0, 0.1, 5.0, 5.1]), max_gap=0.5)
        array([0, 0, 1, 1])
    """
    first = np.zeros(min(len(time), 1), np.int64)
    return np.concatenate([first, np.cumsum(gaps_in(time, max_gap))])


def gaps_in(time: np.ndarray, max_gap: float) -> np.ndarray:
    r"""Returns whether there is a gap between each frame and the next :math:`(T - 1,)`."""
    return np.asarray(np.diff(time) > max_gap * (1 + ROUNDING))


def gaps_of(time: np.ndarray, max_gap: float) -> np.ndarray:
    r"""Returns the last frame before each gap.

    Args:
        time (numpy.ndarray): Increasing times in seconds :math:`(T,)`.
        max_gap (float): As of :func:`part_numbers`.

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
        seconds (float): From the one to the other.
        max_gap (float): The largest distance in seconds that is no gap.

    Examples:
        >>> is_gap(0.05, max_gap=0.05), is_gap(0.06, max_gap=0.05)
        (False, True)
    """
    return seconds > max_gap * (1 + ROUNDING)


def joined_rate(rates: Mapping[int, float], names: Sequence[str]) -> tuple[float | None, float]:
    r"""Returns the median of some rates and the relative tolerance, 0.05 or their spread if that is
    larger.

    Args:
        rates (Mapping of int to float): Frames per second, by the place of the name.
        names (sequence of str): What to call the recordings in a message.

    Raises:
        ValueError: If the rates are further apart than the spread of one device; the message names
            two recordings.
    """
    if not rates:
        return None, RATE_TOLERANCE
    places = sorted(rates, key=rates.__getitem__)
    for slow, fast in pairwise(places):
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
