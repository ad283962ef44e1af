r"""Looking at data or models without using up random numbers."""

import random
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import torch


@contextmanager
def kept_rng() -> Iterator[None]:
    r"""Restores the random states of Python, NumPy and PyTorch's CPU at the end, such that checks
    before a training do not change it.
    """
    python, numpy = random.getstate(), np.random.get_state()  # noqa: NPY002 - the global state
    try:
        with torch.random.fork_rng(devices=[]):
            yield
    finally:
        random.setstate(python)
        np.random.set_state(numpy)  # noqa: NPY002
