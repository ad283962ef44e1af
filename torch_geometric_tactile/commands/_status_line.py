r"""A line on the terminal with the state of a running command."""

import logging
import shutil
import sys
import threading
import time
from typing import Self, TextIO

from torch_geometric_tactile._texts import printable

_SECONDS_BETWEEN_LINES = 10.0  # without a terminal, such as in a log file


class StatusLine:
    r"""A status line on standard error. On a terminal the line is updated in place; elsewhere a new
    line is written every ten seconds. While the status line is open, warnings appear on separate
    lines.
    """

    def __init__(self, out: TextIO | None = None) -> None:
        self._out = sys.stderr if out is None else out
        self._in_place = self._out is not None and self._out.isatty()
        self._next = 0.0
        self._is_open = False
        self._lock = threading.RLock()  # other threads log warnings
        self._default_handler = logging.lastResort

    def show(self, text: str) -> None:
        r"""Replaces the text of the line. Parts of the text are separated by two spaces; a narrow
        terminal omits the last parts.
        """
        if self._out is None:
            return
        with self._lock:
            if self._in_place:
                width = max(shutil.get_terminal_size().columns - 1, 20)
                self._out.write(f"\r{_shorten(printable(text), width)}\x1b[K")
                self._is_open = True
            elif time.monotonic() >= self._next:
                self._next = time.monotonic() + _SECONDS_BETWEEN_LINES
                self._out.write(f"{printable(text)}\n")
            self._out.flush()

    def write(self, text: str) -> None:
        r"""Writes a permanent line above the status line."""
        if self._out is None:
            return
        with self._lock:
            clear = "\r\x1b[K" if self._is_open else ""
            self._is_open = False
            self._out.write(f"{clear}{printable(text)}\n")
            self._out.flush()

    def close(self) -> None:
        r"""Ends the line, so that later output starts on a new line."""
        with self._lock:
            if self._is_open:
                self._out.write("\n")
                self._out.flush()
                self._is_open = False

    def __enter__(self) -> Self:
        if logging.lastResort is not None:  # the handler of warnings that no other handler takes
            self._default_handler = logging.lastResort
            logging.lastResort = _StatusLineHandler(self, logging.lastResort)
        return self

    def __exit__(self, *error: object) -> None:
        logging.lastResort = self._default_handler
        self.close()


class _StatusLineHandler(logging.Handler):
    def __init__(self, line: StatusLine, default_handler: logging.Handler) -> None:
        super().__init__(default_handler.level)
        self._line = line
        self.setFormatter(default_handler.formatter)

    def emit(self, record: logging.LogRecord) -> None:
        try:
            self._line.write(self.format(record))
        except Exception:
            self.handleError(record)


def _shorten(text: str, width: int) -> str:
    parts = text.split("  ")
    while len("  ".join(parts)) > width and len(parts) > 1:
        parts.pop()
    return "  ".join(parts)[:width]
