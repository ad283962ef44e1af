r"""First lines of CSV files: whether they are names, and what the names say about units."""

import logging
import re
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from torch_geometric_tactile._texts import quoted
from torch_geometric_tactile.io._csv_table import is_number

_TIME = re.compile(r"(?:time|timestamp|t)(?:_(s|ms|us|ns))?", re.ASCII)
# Times whose unit is not known, and numbers of frames.
_CLOCK = re.compile(
    r"(?:time|timestamp)[\W_]+\w.*|#|(?:.*[\W_])?(?:time|timestamp|datetime|stamp|epoch|elapsed|ts|"
    r"secs?|seconds|zeit)|(?:frame|sample|seq|sequence|counter|message)(?:[\W_]+(?:id|index|no|num|"
    r"number))?"
)
_PLACES = {"s": 0, "ms": 3, "us": 6, "ns": 9}
TIME_UNITS = tuple(_PLACES)
_LATEST = 1e11  # seconds: the year 5138
_logger = logging.getLogger(__name__)


def has_names(row: Sequence[str]) -> bool:
    r"""Tells whether a line is a header: if most of its cells are no numbers. One wrong cell does
    not make a line of numbers a header.
    """
    return sum(not is_number(cell) for cell in row) > len(row) / 2


def is_counted(row: Sequence[str]) -> bool:
    r"""Tells whether a line is ``0,1,2,...``, as the header that pandas writes without names; also
    after the empty cell above its index.
    """
    names = [cell.strip() for cell in row]
    if len(names) > 1 and not names[0]:
        names = names[1:]
    return names == [str(i) for i in range(len(names))]


def refuse_counted(path: Path, row: Sequence[str], options: str) -> None:
    r"""Checks that a first line is no header of numbers."""
    if is_counted(row):
        raise ValueError(
            f"'{path}', line 1 must be names of columns or a frame (got 0, 1, 2, ..., which pandas "
            f"writes for columns without names): name them, or write the file with "
            f"to_csv(header=False, index=False); {options}"
        )


def refuse_index(path: Path, names: Sequence[str], ignore: Sequence[str] = ()) -> None:
    r"""Checks that no column is the index that pandas writes in front of the columns."""
    for column, name in enumerate(names, 1):
        unnamed = (column == 1 and not name) or re.fullmatch(r"Unnamed: [0-9]+", name)
        if unnamed and len(names) > 1 and name not in ignore:
            raise ValueError(
                f"'{path}', line 1 must name column {column} (got {quoted(name)}, as above the "
                "index of pandas): write the file with to_csv(index=False), or name the column"
            )


def refuse_twice(path: Path, names: Sequence[str]) -> None:
    r"""Checks that all columns have names of their own."""
    twice = [name for name, number in Counter(names).items() if number > 1]
    if twice:
        raise ValueError(f"'{path}' must name each column once (got {quoted(twice[0])} twice)")


def time_unit(name: str) -> str | None:
    r"""Returns the unit of a column of the time, which its name says; nothing for other columns.

    Examples:
        >>> time_unit("Time"), time_unit("timestamp_ns"), time_unit("thumb")
        ('s', 'ns', None)
    """
    match = _TIME.fullmatch(name.lower())
    return None if match is None else match[1] or "s"


def is_clock(name: str) -> bool:
    r"""Tells whether a name is that of a time whose unit it does not say, or of a number of
    frames.
    """
    name = name.lower()
    return time_unit(name) is None and _CLOCK.fullmatch(name) is not None


def warn_of_unit(path: Path, seconds: np.ndarray, mend: str) -> None:
    r"""Logs a warning if frames are as far apart as those of a time in milliseconds.

    Shapes:
        - **seconds:** The times, taken as seconds :math:`(T,)`.
    """
    step = float(np.median(np.diff(seconds))) if len(seconds) > 1 else 0.0
    if step >= 1:
        _logger.warning(
            "'%s' has a frame every %g s: if its time is in milliseconds, %s", path, step, mend
        )


def cell_to_seconds(path: Path, line: int, cell: str, unit: str) -> float:
    r"""Returns the number of a cell in seconds, rounded once."""
    cell = cell.strip()
    if "e" in cell.lower():
        seconds = float(cell) / 10 ** _PLACES[unit]
    else:
        seconds = float(f"{cell}e-{_PLACES[unit]}")
    if abs(seconds) > _LATEST:
        raise ValueError(
            f"'{path}', line {line}: 'time' must be in {unit} (got {quoted(cell)}, after the year "
            "5000): name the column time_ms, time_us or time_ns if that is its unit"
        )
    return seconds
