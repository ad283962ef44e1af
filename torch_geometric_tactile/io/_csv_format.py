r"""The text format of a CSV file: separator, decimal sign, encoding, lines before the header, and
values that stand for missing readings.
"""

import csv
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields
from datetime import UTC, datetime
from functools import cached_property
from typing import TYPE_CHECKING

from torch_geometric_tactile._checks import need_argument

if TYPE_CHECKING:
    from _csv import Reader

_SEPARATORS = {"comma": ",", "semicolon": ";", "tab": "\t", "blank": " ", "\\t": "\t"}
_DETECTED_SEPARATORS = (";", "\t", "|")
_CLOCK = re.compile(r"([0-9]{1,2}):([0-9]{2})(?::([0-9]{2}(?:\.[0-9]*)?))?", re.ASCII)
_LONG_FRACTION = re.compile(r"(\.[0-9]{6})[0-9]+")


@dataclass(frozen=True)
class CsvFormat:
    r"""The text format of a CSV file.

    Args:
        separator (str, optional): The character between two cells, or one of :obj:`"comma"`,
            :obj:`"semicolon"`, :obj:`"tab"` and :obj:`"blank"` (any number of blanks and tabs). By
            default, a semicolon, a tab or a vertical bar if the first line has one and no comma,
            otherwise a comma.
        decimal (str): The decimal sign of numbers, :obj:`"."` or :obj:`","`.
        encoding (str): The encoding of the text, such as :obj:`"cp1252"` or :obj:`"utf-16"`.
            Defaults to UTF-8, with or without a byte order mark.
        preamble (int): Number of lines before the header.
        unit_row (bool): Whether the line after the header holds units. Known units of the time,
            joint angles and readings are used: :obj:`s`, :obj:`ms`, :obj:`deg`, :obj:`N`,
            :obj:`mN`, ...
        time_format (str, optional): The format of times such as :obj:`"03.01.2024 10:00:00,25"`, as
            in :meth:`datetime.datetime.strptime`: :obj:`"%d.%m.%Y %H:%M:%S,%f"`. Numbers, ISO 8601
            times and times of day (:obj:`10:00:00.25`) need no format.
        missing (sequence): Strings and numbers that stand for a missing reading, such as
            :obj:`["NA", -1, 4095]`. Empty cells and :obj:`nan` always do.
        has_options (bool): Whether error messages name these arguments. They do not for files with
            a fixed format.

    Raises:
        ValueError: If an argument is unknown.

    Examples:
        >>> CsvFormat(separator="semicolon", decimal=",").separator
        ';'
    """

    separator: str | None = None
    decimal: str = "."
    encoding: str = "utf-8-sig"
    preamble: int = 0
    unit_row: bool = False
    time_format: str | None = None
    missing: Sequence[str | float] = ()
    has_options: bool = True

    def __post_init__(self) -> None:
        separator = _SEPARATORS.get(str(self.separator), self.separator)
        object.__setattr__(self, "separator", separator)
        values = [self.missing] if isinstance(self.missing, str | int | float) else self.missing
        object.__setattr__(self, "missing", tuple(values))
        is_character = isinstance(separator, str) and len(separator) == 1
        need_argument(
            separator is None or (is_character and separator not in "\"'\r\n.0"),
            "separator",
            f"must be one character, or one of {[*_SEPARATORS][:4]}",
            repr(separator),
        )
        need_argument(self.decimal in (".", ","), "decimal", "must be '.' or ','", self.decimal)
        need_argument(
            separator is None or separator != self.decimal,
            "separator",
            f"must differ from the decimal sign '{self.decimal}'",
            repr(separator),
        )
        need_argument(
            type(self.preamble) is int and self.preamble >= 0,
            "preamble",
            "must be the number of lines before the header, at least 0",
            repr(self.preamble),
        )
        need_argument(
            type(self.unit_row) is bool, "unit_row", "must be true or false", self.unit_row
        )
        need_argument(
            _is_encoding(self.encoding),
            "encoding",
            "must be the name of an encoding of text, such as 'cp1252'",
            repr(self.encoding),
        )

    def detected_separator(self, line: str) -> str:
        r"""Returns :obj:`separator`, or the separator that the first line of the table shows."""
        if self.separator is not None:
            return self.separator
        candidates = [sign for sign in _DETECTED_SEPARATORS if sign in line]
        return candidates[0] if candidates and "," not in line else ","

    def reader(self, lines: Iterable[str], separator: str) -> "Reader":
        r"""Returns the reader of the cells in lines of text."""
        if separator == " ":
            lines = (f"{' '.join(line.split())}\n" for line in lines)
        return csv.reader(lines, delimiter=separator, strict=True)

    def number_texts(self, cells: Sequence[str]) -> Sequence[str]:
        r"""Returns numbers as strings with decimal points."""
        return cells if self.decimal == "." else [cell.replace(",", ".") for cell in cells]

    @cached_property
    def missing_texts(self) -> frozenset[str]:
        r"""The strings in :attr:`missing`."""
        return frozenset(value.strip() for value in self.missing if isinstance(value, str))

    @cached_property
    def missing_numbers(self) -> list[float]:
        r"""The numbers in :attr:`missing`, including numbers that are written as strings."""
        numbers = []
        for value in self.missing:
            try:
                numbers.append(float(value))
            except ValueError:
                continue
        return numbers

    def date_seconds(self, cell: str) -> float:
        r"""Returns the seconds of a date since 1970, or of a time of day since midnight. Dates
        without a time zone are in UTC.

        Raises:
            ValueError: If the cell holds neither.
        """
        if self.time_format is not None:
            return _seconds_since_1970(datetime.strptime(cell, self.time_format))
        clock = _CLOCK.fullmatch(cell.replace(",", "."))
        if clock is not None:
            hours, minutes, seconds = int(clock[1]), int(clock[2]), float(clock[3] or 0)
            if hours < 24 and minutes < 60 and seconds < 60:
                return hours * 3600 + minutes * 60 + seconds
            raise ValueError(f"no time of day: '{cell}'")
        # Python's parser takes up to six decimal places of a second in all versions.
        return _seconds_since_1970(
            datetime.fromisoformat(_LONG_FRACTION.sub(r"\1", cell.replace(",", ".")))
        )

    def is_clock_time(self, cell: str) -> bool:
        r"""Returns whether a time is a time of day, which restarts at midnight."""
        return self.time_format is None and _CLOCK.fullmatch(cell.replace(",", ".")) is not None


def _is_encoding(name: object) -> bool:
    try:
        "".encode(str(name))
    except (LookupError, ValueError):  # a null character
        return False
    return True


def _seconds_since_1970(time: datetime) -> float:
    return (time if time.tzinfo is not None else time.replace(tzinfo=UTC)).timestamp()


FIXED_FORMAT = CsvFormat(separator=",", has_options=False)  # of published data sets
# The options of `read_recording` that make up a CsvFormat.
CSV_OPTIONS = tuple(field.name for field in fields(CsvFormat) if field.name != "has_options")
