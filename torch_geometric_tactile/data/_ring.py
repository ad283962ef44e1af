r"""A ring buffer of rows."""

from typing import Any


class Ring:
    r"""A ring buffer of the last rows. The memory holds each row twice, so that the rows always
    form one slice and need no copy.

    Args:
        rows (numpy.ndarray or torch.Tensor): The memory of the buffer :math:`(2 T, \ldots)`.
    """

    def __init__(self, rows: Any) -> None:
        self._rows = rows
        self._length = len(rows) // 2
        self.count = 0

    def push(self, row: Any) -> None:
        r"""Adds a row."""
        place = self.count % self._length
        self._rows[place] = row
        self._rows[place + self._length] = row
        self.count += 1

    def last(self) -> Any:
        r"""Returns a view of the last rows :math:`(T, \ldots)`, which the next push changes."""
        start = self.count % self._length
        return self._rows[start : start + self._length]
