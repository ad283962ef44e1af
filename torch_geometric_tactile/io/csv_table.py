r"""Tables of numbers in CSV files: a quick reader whose errors name line and column."""

import csv
import math
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

# With these a spreadsheet program takes a cell for a formula, and runs it; also as wide characters.
_FORMULA = ("=", "+", "-", "@", "\uff1d", "\uff0b", "\uff0d", "\uff20")


def safe_cell(text: str) -> str:
    r"""Returns a text for a cell of a CSV file, such that no spreadsheet program takes it for a
    formula: with an apostrophe in front if it begins like one. Numbers are to be written as they
    are, not through this function.

    Args:
        text (str): The text.

    Examples:
        >>> safe_cell("mug"), safe_cell("=1+1")
        ('mug', "'=1+1")
    """
    if text.startswith(("\t", "\r", "\n")) or text.lstrip().startswith(_FORMULA):
        return f"'{text}"
    return text


def csv_rows(path: Path) -> Iterator[tuple[int, list[str]]]:
    r"""Yields line number and cells of each line that is not empty.

    Args:
        path (Path): The file.

    Raises:
        ValueError: If the file is no text, or its last line has no end, as in a file that was cut.
    """
    with path.open("rb") as file:
        if file.seek(0, 2):
            file.seek(-1, 2)
            whole = file.read(1) in b"\r\n"
        else:
            raise ValueError(f"'{path}' must hold at least one frame (got an empty file)")
    last = 0
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            reader = csv.reader(file)
            for row in reader:
                last = reader.line_num
                if any(cell.strip() for cell in row):
                    yield last, row
    except (csv.Error, UnicodeDecodeError) as error:
        raise ValueError(f"'{path}' cannot be read as CSV: {error}") from error
    if not whole:
        raise ValueError(
            f"'{path}', line {last} must end with a line break: is the file cut? Delete the line, "
            "or add the line break if you know that the line is whole"
        )


def csv_numbers(path: Path, line: int, row: Sequence[str], names: Sequence[str]) -> np.ndarray:
    r"""Returns the numbers of a line, NaN for empty cells.

    Args:
        path (Path): The file, for messages.
        line (int): Number of the line.
        row (sequence of str): Its cells.
        names (sequence of str): Names of the columns, for messages.

    Raises:
        ValueError: If there is another number of cells, or a cell is no finite number.
    """
    if len(row) != len(names):
        raise ValueError(
            f"'{path}', line {line} must have {len(names)} cells (got {len(row)}): is the file "
            "cut, or are the cells not separated by commas?"
        )
    try:
        numbers = np.array(row, dtype=object).astype(np.float64)
    except ValueError:
        numbers = np.array([_number(path, line, i, row[i], names[i]) for i in range(len(row))])
    with np.errstate(over="ignore"):
        infinite = np.flatnonzero(np.isinf(numbers.astype(np.float32)))
    if len(infinite):
        column = int(infinite[0])
        raise ValueError(
            f"'{path}', line {line}, column {column + 1}: '{names[column]}' must be finite, or "
            f"empty where it is missing (got '{row[column]}')"
        )
    return numbers


def _number(path: Path, line: int, column: int, cell: str, name: str) -> float:
    if not cell.strip():
        return math.nan
    try:
        return float(cell)
    except ValueError:
        raise ValueError(
            f"'{path}', line {line}, column {column + 1}: '{name}' must be a number (got '{cell}')"
        ) from None
