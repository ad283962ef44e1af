r"""Context managers for Ctrl-C and other signals that end a process."""

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any


@contextmanager
def ignore_interrupts() -> Iterator[None]:
    r"""Ignores Ctrl-C within the block, in the main thread. Processes started within the block
    inherit this behaviour, and must be stopped by the process that started them.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    handler = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, handler)


@contextmanager
def termination_as_interrupt() -> Iterator[None]:
    r"""Turns the first SIGTERM within the block, or SIGHUP from a closed terminal, into a
    :class:`KeyboardInterrupt`, so that files are closed as after Ctrl-C. Signals that are ignored,
    for example because of ``nohup``, stay ignored.
    """
    names = ("SIGTERM", "SIGHUP")
    in_main_thread = threading.current_thread() is threading.main_thread()
    numbers = [getattr(signal, name) for name in names if in_main_thread and hasattr(signal, name)]
    handled = [number for number in numbers if signal.getsignal(number) is signal.SIG_DFL]

    def interrupt(number: int, frame: Any) -> None:
        for signal_number in handled:
            # A second signal must not stop the closing of files.
            signal.signal(signal_number, signal.SIG_IGN)
        raise KeyboardInterrupt

    for number in handled:
        signal.signal(number, interrupt)
    try:
        yield
    finally:
        for number in handled:
            signal.signal(number, signal.SIG_DFL)
