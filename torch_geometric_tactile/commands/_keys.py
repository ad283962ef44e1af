r"""Keys that are pressed while a verb runs."""

import os
import select
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from torch_geometric_tactile.commands._status_line import StatusLine
    from torch_geometric_tactile.live import Recorder


@contextmanager
def keys_heeded(actions: Mapping[str, Callable[[], None]]) -> Iterator[Callable[[], None]]:
    r"""Yields a function that calls the action of each key that was pressed since the last time;
    without a terminal, there are none. Ctrl-C stays what it is.
    """
    if sys.stdin is None or not sys.stdin.isatty():
        yield lambda: None
        return
    try:
        import termios
        import tty
    except ImportError:  # Windows
        yield lambda: _heed_console(actions)
        return

    line = sys.stdin.fileno()
    before = termios.tcgetattr(line)

    def heed() -> None:
        while select.select([line], [], [], 0)[0]:
            pressed = os.read(line, 1).decode("ascii", "replace").lower()
            if not pressed:
                return
            actions.get(pressed, _nothing)()

    tty.setcbreak(line, termios.TCSANOW)  # key by key, and Ctrl-C still stops
    try:
        yield heed
    finally:
        termios.tcsetattr(line, termios.TCSADRAIN, before)


def mark(recorder: "Recorder | None", line: "StatusLine") -> None:
    r"""Writes an event :obj:`"mark"` of this moment into a recording."""
    if recorder is None:
        line.tell("nothing was marked: it needs a recording")
        return
    recorder.event("mark")
    line.tell(f"marked at {recorder.seconds:.2f} s")


def label_keys(
    labels: Sequence[str] | None, recorder: "Callable[[], Recorder | None]", line: "StatusLine"
) -> dict[str, Callable[[], None]]:
    r"""Returns what the keys 1 to 9 do: each begins and ends annotations of its label."""
    named = "123456789" if labels is None else labels
    return {
        str(i): partial(_annotate, recorder, line, label) for i, label in enumerate(named, start=1)
    }


def _annotate(recorder: "Callable[[], Recorder | None]", line: "StatusLine", label: str) -> None:
    running = recorder()
    if running is None:
        line.tell("nothing was annotated: it needs a recording")
        return
    running.annotate(label)
    what = "begins" if running.annotation == label else "ends"
    line.tell(f"{label} {what} at {running.seconds:.2f} s")


def _heed_console(actions: Mapping[str, Callable[[], None]]) -> None:
    import msvcrt

    while msvcrt.kbhit():  # type: ignore[attr-defined, unused-ignore]
        pressed = msvcrt.getwch()  # type: ignore[attr-defined, unused-ignore]
        actions.get(pressed.lower(), _nothing)()


def _nothing() -> None:
    return
