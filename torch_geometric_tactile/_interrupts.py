r"""Context managers for Ctrl-C and other signals that end a process."""

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any


@contextmanager
def ignore_interrupts() -> Iterator[None]:
    r"""Ignores Ctrl-C within the block, in the main thread. Processes started within the block
    inherit this: the process that started them stops them.
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
    r"""Turns the first SIGTERM, or SIGHUP of a closed terminal, within the block into a
    :class:`KeyboardInterrupt`, so that files are closed as after Ctrl-C. A signal that is ignored,
    as by ``nohup``, stays ignored.
    """
    names = ("SIGTERM", "SIGHUP")
    in_main_thread = threading.current_thread() is threading.main_thread()
    numbers = [getattr(signal, name) for name in names if in_main_thread and hasattr(signal, name)]
    handled = [number for number in numbers if signal.getsignal(number) is signal.SIG_DFL]

    def interrupt(number: int, frame: Any) -> None:
        for signal_number in handled:
            signal.signal(signal_number, signal.SIG_IGN)  # a second one must not stop the closing
        raise KeyboardInterrupt

    for number in handled:
        signal.signal(number, interrupt)
    try:
        yield
    finally:
        for number in handled:
            signal.signal(number, signal.SIG_DFL)
