r"""Keeps adverts of Lightning out of the output."""

import logging
from collections.abc import Iterator
from contextlib import contextmanager

_ADVERT = "💡 Tip:"
_LOGGERS = ("lightning.pytorch.utilities.rank_zero", "lightning.fabric.utilities.rank_zero")


@contextmanager
def no_adverts() -> Iterator[None]:
    r"""Drops the messages in which Lightning recommends other products of its maker; all other
    messages and warnings are shown.
    """
    loggers = [logging.getLogger(name) for name in _LOGGERS]
    for logger in loggers:
        logger.addFilter(_is_no_advert)
    try:
        yield
    finally:
        for logger in loggers:
            logger.removeFilter(_is_no_advert)


def _is_no_advert(record: logging.LogRecord) -> bool:
    return not str(record.msg).startswith(_ADVERT)
