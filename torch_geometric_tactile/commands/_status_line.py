r"""One quiet line that says how a running verb is doing."""

import logging
import shutil
import sys
import threading
import time
from typing import Self, TextIO

from torch_geometric_tactile._texts import printable

_SECONDS_BETWEEN_LINES = 10.0  # where lines are kept, as in a log


class StatusLine:
    r"""Writes to standard error: in place on a terminal, and elsewhere a line every ten seconds.
    While it is open, warnings get lines of their own.
    """

    def __init__(self, out: TextIO | None = None) -> None:
        self._out = sys.stderr if out is None else out
        self._in_place = self._out is not None and self._out.isatty()
        self._next = 0.0
        self._is_open = False
        self._lock = threading.RLock()  # warnings come from other threads
        self._usual = logging.lastResort

    def show(self, text: str) -> None:
        r"""Shows it, in the place of what was shown before. What a narrow terminal has no room for
        is left out, part by part: parts are separated by two spaces.
        """
        if self._out is None:
            return
        with self._lock:
            if self._in_place:
                width = max(shutil.get_terminal_size().columns - 1, 20)
                self._out.write(f"\r{_fitting(printable(text), width)}\x1b[K")
                self._is_open = True
            elif time.monotonic() >= self._next:
                self._next = time.monotonic() + _SECONDS_BETWEEN_LINES
                self._out.write(f"{printable(text)}\n")
            self._out.flush()

    def tell(self, text: str) -> None:
        r"""Writes a line that stays, above what is shown."""
        if self._out is None:
            return
        with self._lock:
            clear = "\r\x1b[K" if self._is_open else ""
            self._is_open = False
            self._out.write(f"{clear}{printable(text)}\n")
            self._out.flush()

    def close(self) -> None:
        r"""Ends the line, such that what is written next has its own."""
        with self._lock:
            if self._is_open:
                self._out.write("\n")
                self._out.flush()
                self._is_open = False

    def __enter__(self) -> Self:
        if logging.lastResort is not None:  # what prints warnings that nobody else handles
            self._usual, logging.lastResort = logging.lastResort, _Told(self, logging.lastResort)
        return self

    def __exit__(self, *error: object) -> None:
        logging.lastResort = self._usual
        self.close()


class _Told(logging.Handler):
    def __init__(self, line: StatusLine, usual: logging.Handler) -> None:
        super().__init__(usual.level)
        self._line = line
        self.setFormatter(usual.formatter)

    def emit(self, record: logging.LogRecord) -> None:
        try:
            self._line.tell(self.format(record))
        except Exception:
            self.handleError(record)


def _fitting(text: str, width: int) -> str:
    parts = text.split("  ")
    while len("  ".join(parts)) > width and len(parts) > 1:
        parts.pop()
    return "  ".join(parts)[:width]
