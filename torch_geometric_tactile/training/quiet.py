r"""Suppression of Lightning's messages."""

import logging
import warnings
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def quiet_lightning() -> Iterator[None]:
    r"""Suppresses Lightning's messages and warnings within a :obj:`with` block, for example about
    the accelerator and the number of workers. Errors and warnings from other libraries are shown.

    Examples:
        >>> import lightning
        >>> with quiet_lightning():
        ...     trainer = lightning.Trainer(max_epochs=1, barebones=True, accelerator="cpu")
    """
    logger = logging.getLogger("lightning.pytorch")
    level = logger.level
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", module="lightning")
        logger.setLevel(logging.ERROR)
        try:
            yield
        finally:
            logger.setLevel(level)
