r"""Training of which nothing is shown."""

import warnings
from collections.abc import Iterator
from contextlib import contextmanager

from torch_geometric_tactile.training.quiet import quiet_lightning


@contextmanager
def silent_training() -> Iterator[None]:
    r"""Shows nothing at all, and lets Ctrl-C end the program, not the training alone."""
    with quiet_lightning(), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            yield
        except SystemExit as stop:  # Lightning's answer to Ctrl-C
            raise KeyboardInterrupt from stop
