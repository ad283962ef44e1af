r"""The last rows of a stream of them."""

from typing import Any


class Ring:
    r"""The last rows that were pushed, in an array or tensor that holds each of them twice: so they
    always lie in one piece.

    Shapes:
        - **rows:** Room for them :math:`(2 T, \ldots)`.
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
        r"""Returns the last rows :math:`(T, \ldots)`, which the next push changes."""
        start = self.count % self._length
        return self._rows[start : start + self._length]
