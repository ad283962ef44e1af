r"""Argument types and options that several commands share."""

import argparse
import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from torch_geometric_tactile.commands._paths import input_path

if TYPE_CHECKING:
    from torch_geometric_tactile.data import ContactRule

_MAX_COUNT = 1_000_000

READABLE = ".h5, .hdf5, .npz, .mcap, .csv, .json, .jsonl, .ndjson or .txt"
SOURCE = """\
SOURCE is one of:
  "serial:/dev/ttyACM0?protocol=anyskin"   a serial port; 'tactile ports' lists them
  serial:/dev/ttyACM0                      a serial port that sends lines of numbers
  ws://HOST:5000                           XELA's server
  grasp.h5                                 a recording, replayed at its own speed
  sim:                                     the simulated hand (extra 'sim')
"""


def _integer_type(minimum: int, maximum: int, too_small: str) -> Callable[[str], int]:
    def parse_integer(text: str) -> int:
        # int() also accepts underscores and the digits of other scripts.
        try:
            number = int(text) if text.isascii() and "_" not in text else None
        except ValueError:
            number = None
        if number is None:
            raise argparse.ArgumentTypeError(f"must be a whole number (got {text[:40]!r})")
        if number < minimum:
            raise argparse.ArgumentTypeError(f"{too_small} (got {number})")
        if number > maximum:
            raise argparse.ArgumentTypeError(f"must be at most {maximum} (got {text[:40]})")
        return number

    return parse_integer


#: Reads an integer from one to a million.
positive = _integer_type(1, _MAX_COUNT, "must be at least 1")

#: Reads a number of runs, processes or samples, each of which needs memory: one to ten thousand.
small_count = _integer_type(1, 10_000, "must be at least 1")

#: Reads a seed: an integer from zero to the largest seed that all dependencies accept.
not_negative = _integer_type(0, (1 << 32) - 1, "must not be negative")


def seconds(text: str) -> float:
    r"""Reads a duration in seconds: a positive number."""
    return _positive_number(text, "seconds")


def hertz(text: str) -> float:
    r"""Reads a rate in frames per second: a positive number."""
    return _positive_number(text, "frames per second")


def _positive_number(text: str, unit: str) -> float:
    number = _number_or_nan(text)
    if not 0 < number < math.inf:
        raise argparse.ArgumentTypeError(f"must be a positive number of {unit} (got {text[:40]!r})")
    return number


def percentage(text: str) -> float:
    r"""Reads a number from 0 up to, but not including, 100."""
    number = _number_or_nan(text)
    if not 0 <= number < 100:
        raise argparse.ArgumentTypeError(f"must be at least 0 and below 100 (got {text[:40]!r})")
    return number


def trial_seconds(text: str) -> float:
    r"""Reads the length of a simulated trial in seconds, from one second to an hour."""
    number = _number_or_nan(text)
    if not 1 <= number <= 3600:
        raise argparse.ArgumentTypeError(
            f"must be a number of seconds from 1 to 3600 (got {text[:40]!r})"
        )
    return number


def port(text: str) -> int:
    r"""Reads the number of a network port, from 0 (any free one) to 65535."""
    if not text.isascii() or not text.isdigit() or len(text) > 5 or int(text) > 65535:
        raise argparse.ArgumentTypeError(f"must be a port from 0 to 65535 (got {text[:40]!r})")
    return int(text)


def _parse_labels(text: str) -> list[str]:
    from torch_geometric_tactile.data._annotations import GAP, checked_annotation

    labels = [label.strip() for label in text.split(",")]
    if GAP in labels:
        raise argparse.ArgumentTypeError(
            f"must not contain '{GAP}', the label of time without frames (got {text[:80]!r})"
        )
    if len(labels) > 9 or len({*labels}) < len(labels):
        raise argparse.ArgumentTypeError(f"must be up to 9 different labels (got {text[:80]!r})")
    try:
        return [checked_annotation((0.0, 0.0, label)).label for label in labels]
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from error


#: Settings of the option for the labels of the keys 1 to 9.
LABELS: dict[str, Any] = {
    "metavar": "A,B,...",
    "type": _parse_labels,
    "help": "annotation labels for the keys 1 to 9; a key starts and ends its annotation (default: "
    "1 to 9)",
}


#: Settings of the option for the order of the taxels of a source.
MAP: dict[str, Any] = {
    "metavar": "MAP",
    "type": input_path,
    "help": "taxel order of the source: a stock map, a JSON file, or 'none' if the source uses the "
    "order of the layout (default: the stock map for the sensor and the layout, if there is one)",
}


def taxel_map(text: str | None) -> Any:
    r"""Returns the taxel map of the option :obj:`--map`. The values :obj:`"none"` and :obj:`None`
    (option absent) are returned unchanged.
    """
    from torch_geometric_tactile.live import TaxelMap

    return text if text in (None, "none") else TaxelMap.load(text)


def _number_or_nan(text: str) -> float:
    # float() also accepts underscores and the digits of other scripts.
    try:
        return float(text) if text.isascii() and "_" not in text else math.nan
    except ValueError:
        return math.nan


def rest(text: str) -> str | float | None:
    r"""Reads which frames of a trial are recorded at rest: the name of a phase, a number of seconds
    at the start of the trial, or :obj:`"none"`.
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


def _parse_threshold(text: str) -> float:
    number = _number_or_nan(text)
    if not 0 < number < math.inf:
        raise argparse.ArgumentTypeError(
            "must be a positive number in the unit of the readings, or nothing, at the end of the "
            f"command or before another option (got {text[:40]!r})"
        )
    return number


#: Settings of the option for the label "no contact".
CONTACT: dict[str, Any] = {
    "metavar": "THRESHOLD",
    "nargs": "?",
    "type": _parse_threshold,
    "const": math.nan,  # option without a number: the threshold follows from the noise at rest
}


def contact_rule(threshold: float | None) -> "ContactRule | None":
    r"""Returns the contact rule of the option :obj:`--contact`.

    Args:
        threshold (float, optional): Value of the option in the unit of the readings; NaN if the
            option has no value, and :obj:`None` if it is absent.

    Returns:
        The rule, or :obj:`None` if the option is absent.
    """
    from torch_geometric_tactile.data.contact_rule import ContactRule

    if threshold is None:
        return None
    return ContactRule(threshold=None if math.isnan(threshold) else threshold)


def add_run_data(parser: argparse.ArgumentParser) -> None:
    r"""Adds the options for the configuration and the data folder of a run."""
    parser.add_argument(
        "--config",
        metavar="CONFIG",
        type=input_path,
        help="configuration of data and model, which may name your own classes: a file, or the "
        "name of a shipped configuration (default: the data in the run's config.yaml)",
    )
    parser.add_argument(
        "--root",
        metavar="DIR",
        type=input_path,
        help="folder of the data (default: from the configuration)",
    )
