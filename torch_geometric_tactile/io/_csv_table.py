r"""Tables of numbers in CSV files: a quick reader whose errors name line and column."""

import csv
import math
import re
from collections.abc import Iterator, Sequence
from itertools import chain
from pathlib import Path

import numpy as np

from torch_geometric_tactile._texts import quoted

# With these a spreadsheet program takes a cell for a formula, and runs it; also as wide characters.
_FORMULA = ("=", "+", "-", "@", "\uff1d", "\uff0b", "\uff0d", "\uff20")
_SEPARATOR = re.compile(r"[;\t|]")


def safe_cell(text: str) -> str:
    r"""Returns a text for a cell of a CSV file, such that no spreadsheet program takes it for a
    formula: with an apostrophe in front if it begins like one. Numbers are to be written as they
    are, not through this function.

    Examples:
        >>> safe_cell("mug"), safe_cell("=1+1")
        ('mug', "'=1+1")
    """
    if text.startswith(("\t", "\r", "\n")) or text.lstrip().startswith(_FORMULA):
        return f"'{text}"
    return text


def csv_rows(path: Path) -> Iterator[tuple[int, list[str]]]:
    r"""Yields line number and cells of each line."""
    with path.open("rb") as file:
        if file.seek(0, 2):
            file.seek(-1, 2)
            whole = file.read(1) in b"\r\n"
        else:
            raise ValueError(f"'{path}' must hold at least one frame (got an empty file)")
    last = 0
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            # Two programs may have put a mark of the byte order in front.
            first = filter(None, [file.readline().lstrip("\ufeff")])
            reader = csv.reader(chain(first, file), strict=True)
            for row in reader:
                before, last = last, reader.line_num
                if last > before + 1:
                    raise ValueError(
                        f"'{path}', line {before + 1} must have no cell with a line break (got one "
                        f"up to line {last}): is a quote missing?"
                    )
                if not row or (len(row) == 1 and row[0].isspace()):
                    raise ValueError(
                        f"'{path}', line {last} must not be empty: delete it, or write the "
                        "commas of a frame without readings if one is missing there"
                    )
                if len(row) == 1 and not is_number(row[0]) and _SEPARATOR.search(row[0]):
                    raise ValueError(
                        f"'{path}', line {last} must have cells that are separated by commas (got "
                        f"{quoted(row[0])})"
                    )
                yield last, row
    except (csv.Error, UnicodeDecodeError) as error:
        raise ValueError(f"'{path}' cannot be read as CSV: {error}") from error
    if last == 0:
        raise ValueError(f"'{path}' must hold at least one frame (got no line)")
    if not whole:
        raise ValueError(
            f"'{path}', line {last} must end with a line break: is the file truncated? Delete the "
            "line, or add the line break if you know that the line is complete"
        )


def check_width(path: Path, line: int, row: Sequence[str], width: int) -> None:
    r"""Checks that a line has a number of cells."""
    if len(row) != width:
        raise ValueError(
            f"'{path}', line {line} must have {width} cells (got {len(row)}): is the file "
            "truncated, or are the cells not separated by commas?"
        )


def csv_numbers(
    path: Path,
    line: int,
    row: Sequence[str],
    names: Sequence[str],
    columns: Sequence[int] | None = None,
) -> np.ndarray:
    r"""Returns the numbers of a line, NaN for empty cells."""
    check_width(path, line, row, len(names))
    places = range(len(row)) if columns is None else columns
    cells = row if columns is None else [row[i] for i in columns]
    text = "".join(cells)
    try:
        # Python also reads '1_0' and digits of other scripts.
        if "_" in text or not text.isascii():
            raise ValueError
        numbers = np.array(cells, dtype=object).astype(np.float64)
    except ValueError:
        numbers = np.array([_number(path, line, i, row[i], names[i]) for i in places])
    with np.errstate(over="ignore"):
        infinite = np.flatnonzero(np.isinf(numbers.astype(np.float32)))
    if len(infinite):
        column = places[int(infinite[0])]
        raise ValueError(
            f"'{path}', line {line}, column {column + 1}: {quoted(names[column])} must be finite, "
            f"or empty where it is missing (got {quoted(row[column])})"
        )
    return numbers


def is_number(cell: str) -> bool:
    r"""Tells whether a cell holds a number, or nothing."""
    if not cell.isascii() or "_" in cell:
        return False
    try:
        float(cell if cell.strip() else "nan")
    except ValueError:
        return False
    return True


def _number(path: Path, line: int, column: int, cell: str, name: str) -> float:
    if not cell.strip():
        return math.nan
    if is_number(cell):
        return float(cell)
    raise ValueError(
        f"'{path}', line {line}, column {column + 1}: {quoted(name)} must be a number "
        f"(got {quoted(cell)})"
    )
