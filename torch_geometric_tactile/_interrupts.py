r"""Ctrl-C and other signals that end a process, and who heeds them."""

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any


@contextmanager
def interrupts_ignored() -> Iterator[None]:
    r"""Ignores Ctrl-C inside, in the main thread. Processes that are started inside inherit it:
    they are stopped by who started them.
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
def ends_heeded() -> Iterator[None]:
    r"""Inside, what ends a process politely (SIGTERM, and SIGHUP of a closed terminal) is a
    :class:`KeyboardInterrupt`, once, so that files are closed as after Ctrl-C. A signal that is
    ignored, as by ``nohup``, stays ignored.
    """
    names = ("SIGTERM", "SIGHUP")
    here = threading.current_thread() is threading.main_thread()
    numbers = [getattr(signal, name) for name in names if here and hasattr(signal, name)]
    heeded = [number for number in numbers if signal.getsignal(number) is signal.SIG_DFL]

    def end(number: int, frame: Any) -> None:
        for one in heeded:
            signal.signal(one, signal.SIG_IGN)  # a second one must not stop the closing
        raise KeyboardInterrupt

    for number in heeded:
        signal.signal(number, end)
    try:
        yield
    finally:
        for number in heeded:
            signal.signal(number, signal.SIG_DFL)
