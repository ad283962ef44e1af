r"""One quiet line that says how a running verb is doing."""

import shutil
import sys
import time
from typing import Self, TextIO

from torch_geometric_tactile.texts import printable

_SECONDS_BETWEEN_LINES = 10.0  # where lines are kept, as in a log


class StatusLine:
    r"""Writes to standard error: in place on a terminal, and elsewhere a line every ten seconds.

    Args:
        out (io.TextIOBase, optional): Where to write; standard error if left out.
    """

    def __init__(self, out: TextIO | None = None) -> None:
        self._out = sys.stderr if out is None else out
        self._in_place = self._out is not None and self._out.isatty()
        self._next = 0.0
        self._is_open = False

    def show(self, text: str) -> None:
        r"""Shows it, in the place of what was shown before.

        Args:
            text (str): What to show.
        """
        if self._out is None:
            return
        text = printable(text)
        if self._in_place:
            width = max(shutil.get_terminal_size().columns - 1, 20)
            self._out.write(f"\r{text[:width]}\x1b[K")
            self._is_open = True
        elif time.monotonic() >= self._next:
            self._next = time.monotonic() + _SECONDS_BETWEEN_LINES
            self._out.write(f"{text}\n")
        self._out.flush()

    def tell(self, text: str) -> None:
        r"""Writes a line that stays.

        Args:
            text (str): The line.
        """
        if self._out is None:
            return
        self.close()
        self._out.write(f"{printable(text)}\n")
        self._out.flush()

    def close(self) -> None:
        r"""Ends the line, such that what is written next has its own."""
        if self._is_open:
            self._out.write("\n")
            self._out.flush()
            self._is_open = False

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()
