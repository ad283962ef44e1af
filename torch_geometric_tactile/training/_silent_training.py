r"""Training without any output."""

import warnings
from collections.abc import Iterator
from contextlib import contextmanager

from torch_geometric_tactile.training.quiet import quiet_lightning


@contextmanager
def silent_training() -> Iterator[None]:
    r"""Suppresses all warnings and Lightning's messages within a :obj:`with` block. Ctrl-C ends the
    program instead of only the training.
    """
    with quiet_lightning(), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            yield
        except SystemExit as stop:  # Lightning exits on Ctrl-C
            raise KeyboardInterrupt from stop
