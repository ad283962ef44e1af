r"""Types of arguments that several verbs share."""

import argparse
from collections.abc import Callable

from torch_geometric_tactile.parallel import BACKENDS

_MOST = 1_000_000


def _whole(least: int, most: int, too_small: str) -> Callable[[str], int]:
    def whole(text: str) -> int:
        try:
            number = int(text) if text.isascii() and "_" not in text else None
        except ValueError:
            number = None
        if number is None:
            raise argparse.ArgumentTypeError(f"must be a whole number (got {text[:40]!r})")
        if number < least:
            raise argparse.ArgumentTypeError(f"{too_small} (got {number})")
        if number > most:
            raise argparse.ArgumentTypeError(f"must be at most {most} (got {text[:40]})")
        return number

    return whole


#: Reads an integer from one to a million.
positive = _whole(1, _MOST, "must be at least 1")

#: Reads the number of things of which each takes memory or a process: from one to ten thousand.
few = _whole(1, 10_000, "must be at least 1")

#: Reads a seed: an integer from zero to the largest that all of our libraries take.
not_negative = _whole(0, (1 << 32) - 1, "must not be negative")


def seconds(text: str) -> float:
    r"""Reads a length of a trial in seconds, from one second to an hour.

    Args:
        text (str): The argument.
    """
    try:
        number = float(text) if text.isascii() and "_" not in text else None
    except ValueError:
        number = None
    if number is None or not 1 <= number <= 3600:
        raise argparse.ArgumentTypeError(
            f"must be a number of seconds from 1 to 3600 (got {text[:40]!r})"
        )
    return number


def rest(text: str) -> str | float | None:
    r"""Reads which frames of a trial are at rest: the name of a phase, seconds at its beginning, or
    :obj:`"none"`.

    Args:
        text (str): The argument.
    """
    if text == "none":
        return None
    try:
        number = float(text)
    except ValueError:
        return text
    if not 0 < number <= 3600:
        raise argparse.ArgumentTypeError(
            f"must be a phase, 'none', or seconds above 0 and up to 3600 (got {text[:40]!r})"
        )
    return number


def add_allow(parser: argparse.ArgumentParser) -> None:
    r"""Adds the option for classes of one's own in the configuration beside a checkpoint.

    Args:
        parser (argparse.ArgumentParser): The parser of the verb.
    """
    parser.add_argument(
        "--allow",
        metavar="PACKAGE",
        action="append",
        default=[],
        help="a package, module or class of your own that the config.yaml beside the checkpoint "
        "may name; may be given again",
    )


def add_workers(parser: argparse.ArgumentParser) -> None:
    r"""Adds the options that say where runs are made.

    Args:
        parser (argparse.ArgumentParser): The parser of the verb.
    """
    parser.add_argument(
        "--jobs", metavar="N", type=few, default=1, help="runs at a time (default: 1)"
    )
    parser.add_argument(
        "--threads", metavar="N", type=few, default=1, help="threads of a run (default: 1)"
    )
    parser.add_argument(
        "--accelerator", choices=("cpu", "gpu"), default="cpu", help="where to train (default: cpu)"
    )
    parser.add_argument(
        "--backend",
        choices=BACKENDS,
        default="loky",
        help="what starts the runs: processes of this machine (loky, the default), or Dask or Ray, "
        "which know many machines; they are extras of the same names",
    )
    parser.add_argument(
        "--scheduler",
        metavar="ADDRESS",
        help="a running cluster of Dask or Ray; by default one of --jobs processes is started here",
    )
