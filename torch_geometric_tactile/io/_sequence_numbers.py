r"""Numbers of 32 bits, as devices count their frames."""

_WRAP = 2**32
_NEAR_ZERO = 2**16
_LONGEST_GAP = 2**20  # 19 minutes at 900 frames a second


class SequenceNumbers:
    r"""Unwraps the 32-bit numbers of a device, and tells how many are missing.

    A step back, or a long one to a number near zero, is a device that has started over: the
    numbers go on, and no loss is told, since nobody knows it.

    Examples:
        >>> numbers = SequenceNumbers()
        >>> [numbers.unwrapped(number) for number in (2**32 - 1, 0, 3, 0)]
        [(4294967295, 0), (4294967296, 0), (4294967299, 2), (4294967300, 0)]
    """

    def __init__(self) -> None:
        self._device: int | None = None
        self._last = 0

    def unwrapped(self, number: int) -> tuple[int, int]:
        r"""Returns the number without wraps, and how many before it are missing."""
        missing = 0
        if self._device is None:
            self._last = number
        else:
            missing = (number - self._device - 1) % _WRAP
            too_long = missing > _LONGEST_GAP and number < _NEAR_ZERO
            started_over = too_long or missing >= _WRAP // 2
            missing = 0 if started_over else missing
            self._last += 1 + missing
        self._device = number
        return self._last, missing
