r"""Actions of keys that are pressed while a command runs."""

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

_UNNAMED_KEYS = (
    "without --labels, the keys 1 to 9 write the labels 1 to 9: --labels open,slip names them"
)


@contextmanager
def key_bindings(actions: Mapping[str, Callable[[], None]]) -> Iterator[Callable[[], None]]:
    r"""Yields a function that calls the action of each key pressed since its last call.

    Without a terminal the function does nothing. Ctrl-C still raises :obj:`KeyboardInterrupt`.
    """
    if sys.stdin is None or not sys.stdin.isatty():
        yield lambda: None
        return
    try:
        import termios
        import tty
    except ImportError:  # Windows
        yield lambda: _handle_console_keys(actions)
        return

    descriptor = sys.stdin.fileno()
    terminal_settings = termios.tcgetattr(descriptor)

    def handle_keys() -> None:
        while select.select([descriptor], [], [], 0)[0]:
            key = os.read(descriptor, 1).decode("ascii", "replace").lower()
            if not key:  # end of the input
                return
            actions.get(key, _do_nothing)()

    tty.setcbreak(descriptor, termios.TCSANOW)  # single keys without Enter; Ctrl-C still stops
    try:
        yield handle_keys
    finally:
        termios.tcsetattr(descriptor, termios.TCSADRAIN, terminal_settings)


def mark(recorder: "Recorder | None", status_line: "StatusLine") -> None:
    r"""Writes an event :obj:`"mark"` with the current time to a recording."""
    if recorder is None:
        status_line.write("nothing marked: no recording is running")
        return
    status_line.write(f"marked {_time_text(recorder.event('mark'))}")


def label_keys(
    labels: Sequence[str] | None,
    get_recorder: "Callable[[], Recorder | None]",
    status_line: "StatusLine",
) -> dict[str, Callable[[], None]]:
    r"""Returns the actions of the keys 1 to 9. Each key starts and ends annotations with its label.
    Without labels, the first press prints a note that the keys themselves are the labels. With
    fewer than nine labels, a key without a label prints an error.
    """
    key_labels = "123456789" if labels is None else labels
    notes = [_UNNAMED_KEYS] if labels is None else []

    def annotate(label: str) -> None:
        recorder = get_recorder()
        if recorder is None:
            status_line.write("nothing annotated: no recording is running")
            return
        seconds = recorder.annotate(label)
        change = "begins" if recorder.annotation == label else "ends"
        status_line.write(f"{label} {change} {_time_text(seconds)}")
        if notes:
            status_line.write(notes.pop())

    def refuse(key: str) -> None:
        status_line.write(
            f"key {key} has no label: --labels names {len(key_labels)} ({', '.join(key_labels)})"
        )

    actions = {str(i): partial(annotate, label) for i, label in enumerate(key_labels, start=1)}
    return {key: actions.get(key, partial(refuse, key)) for key in "123456789"}


def _time_text(seconds: float | None) -> str:
    return "before the first frame" if seconds is None else f"at {seconds:.2f} s"


def _handle_console_keys(actions: Mapping[str, Callable[[], None]]) -> None:
    import msvcrt

    while msvcrt.kbhit():  # type: ignore[attr-defined, unused-ignore]
        key = msvcrt.getwch()  # type: ignore[attr-defined, unused-ignore]
        actions.get(key.lower(), _do_nothing)()


def _do_nothing() -> None:
    return
