r"""Taxels whose readings cannot be right: constant, saturated, or equal to another taxel."""

from dataclasses import dataclass

import numpy as np

# A number of frames. In real recordings of magnetic and capacitive skin and of a mat of 2,048
# taxels, no taxel stays at the extreme of its channel for so long unless it is clipped, and two
# taxels that change in so many frames are never equal.
_MIN_FRAMES = 10
# Smallest distance between a limit and the rest, and smallest movement of a saturated taxel, both
# as a fraction of the channel's range. Quiet sensors whose integer readings rest at different
# values stay below it.
_MIN_MOVE = 0.25
_MIN_VALUES = 10  # a channel with fewer different readings is a switch, which rests at its limits


@dataclass(frozen=True)
class TaxelFaults:
    r"""The indices of taxels in one recording that do not measure, or only part of the time.

    Args:
        dead (tuple of int): Taxels without a reading in any frame.
        constant (tuple of int): Taxels with the same reading in all frames.
        saturated (tuple of int): Taxels at the end of the range for ten frames or longer.
        equal (tuple of tuple of int): Groups of taxels with equal readings in all frames. Taxels
            that change in fewer than ten frames belong to no group.
    """

    dead: tuple[int, ...] = ()
    constant: tuple[int, ...] = ()
    saturated: tuple[int, ...] = ()
    equal: tuple[tuple[int, ...], ...] = ()


def find_taxel_faults(tactile: np.ndarray) -> TaxelFaults:
    r"""Returns the taxels that do not measure, or only part of the time.

    A taxel is saturated if one of its channels stays for ten frames or longer at exactly the
    largest or the smallest reading of this channel over all taxels. This value must be at least a
    quarter of the channel's range away from zero and from the channel's median, one of which is the
    rest. The taxel must also move by at least a quarter of this range. In recordings of fewer than
    ten frames, only dead taxels are detected.

    Shapes:
        - **tactile:** Readings, NaN where one is missing :math:`(T, N, C)`.

    Examples:
        >>> tactile = np.linspace(0, 9, 40).reshape(40, 1, 1) + np.arange(4).reshape(1, 4, 1)
        >>> tactile[:, 1] = 5.0
        >>> find_taxel_faults(np.minimum(tactile, 9.0))
        TaxelFaults(dead=(), constant=(1,), saturated=(3,), equal=())
    """
    if len(tactile) == 0:
        return TaxelFaults()
    is_dead = np.isnan(tactile).any(axis=2).all(axis=0)
    dead, present = tuple(np.flatnonzero(is_dead).tolist()), np.flatnonzero(~is_dead)
    if len(tactile) < _MIN_FRAMES or not len(present):
        return TaxelFaults(dead)
    readings = tactile[:, present] if dead else tactile
    low, high = np.nanmin(readings, axis=0), np.nanmax(readings, axis=0)
    is_constant = (low == high).all(axis=1)
    is_saturated = np.zeros(len(present), dtype=bool)
    for channel in range(tactile.shape[2]):
        is_saturated |= _is_saturated(readings[:, :, channel], low[:, channel], high[:, channel])
    return TaxelFaults(
        dead,
        tuple(present[is_constant].tolist()),
        tuple(present[is_saturated].tolist()),
        _equal_groups(tactile, present),
    )


def _is_saturated(values: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    # Returns whether each taxel is saturated (N,), from one channel (T, N) and the range of each
    # taxel (N,).
    is_saturated = np.zeros(len(low), dtype=bool)
    first, last = float(low.min()), float(high.max())
    min_move = _MIN_MOVE * (last - first)
    if min_move == 0 or len(np.unique(values[~np.isnan(values)])) < _MIN_VALUES:
        return is_saturated
    median = float(np.nanmedian(values))
    for limit, extremes in ((first, low), (last, high)):
        if min(abs(limit), abs(limit - median)) < min_move:  # at rest
            continue
        taxels = np.flatnonzero((extremes == limit) & (high - low >= min_move))
        longest = _longest_run(values[:, taxels] == limit)
        is_saturated[taxels[longest >= _MIN_FRAMES]] = True
    return is_saturated


def _longest_run(is_true: np.ndarray) -> np.ndarray:
    # Returns the largest number of consecutive true rows in each column.
    run = np.zeros(is_true.shape[1], dtype=np.int64)
    longest = run.copy()
    for row in is_true:
        run = np.where(row, run + 1, 0)
        np.maximum(longest, run, out=longest)
    return longest


def _equal_groups(tactile: np.ndarray, taxels: np.ndarray) -> tuple[tuple[int, ...], ...]:
    groups: dict[bytes, list[int]] = {}
    for taxel in taxels.tolist():
        # Zero is added because -0.0 and 0.0 have different bytes.
        groups.setdefault((tactile[:, taxel] + 0.0).tobytes(), []).append(taxel)
    equal = []
    for group in groups.values():
        changes = np.diff(tactile[:, group[0]], axis=0)
        if len(group) > 1 and np.count_nonzero(np.nan_to_num(changes).any(axis=1)) >= _MIN_FRAMES:
            equal.append(tuple(group))
    return tuple(equal)
