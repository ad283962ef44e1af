r"""A fast reader of numbers in CSV files, with errors that name line and column."""

import csv
import math
import re
from collections.abc import Container, Hashable, Iterator, Mapping, Sequence
from itertools import chain
from pathlib import Path
from typing import TypeVar

import numpy as np

from torch_geometric_tactile._checks import Argument, ArgumentError, need
from torch_geometric_tactile._texts import quoted
from torch_geometric_tactile.io._csv_format import FIXED_FORMAT, CsvFormat

# Spreadsheet programs run a cell that begins with these as a formula. Includes full-width forms.
_FORMULA_STARTS = ("=", "+", "-", "@", "\uff1d", "\uff0b", "\uff0d", "\uff20")
_Key = TypeVar("_Key", bound=Hashable)
_SEPARATOR = re.compile(r"[,;\t|]")


def text_to_cell(text: str) -> str:
    r"""Escapes a string for a cell of a CSV file, so that spreadsheet programs do not run it as a
    formula. A string that begins like a formula, even after apostrophes, gets another apostrophe in
    front. Do not use it for numbers.

    Examples:
        >>> text_to_cell("mug"), text_to_cell("=1+1")
        ('mug', "'=1+1")
    """
    return f"'{text}" if _is_formula(text) else text


def cell_to_text(cell: str) -> str:
    r"""Returns the original string of a cell that :func:`text_to_cell` escaped.

    Examples:
        >>> cell_to_text("mug"), cell_to_text("'=1+1")
        ('mug', '=1+1')
    """
    return cell[1:] if cell.startswith("'") and _is_formula(cell) else cell


def _is_formula(text: str) -> bool:
    text = text.lstrip("'")
    return text.startswith(("\t", "\r", "\n")) or text.lstrip().startswith(_FORMULA_STARTS)


def csv_rows(path: Path, csv_format: CsvFormat = FIXED_FORMAT) -> Iterator[tuple[int, list[str]]]:
    r"""Yields the line number and the cells of each line after the preamble. Empty cells at the end
    of a line are left out if the header has no names for them.

    Args:
        path (Path): The file.
        csv_format (CsvFormat): The text format of the file.

    Raises:
        ValueError: If the file is empty, truncated or not valid CSV.
    """
    is_complete = _ends_with_line_break(path)
    last_line = csv_format.preamble
    width = 0
    try:
        with path.open(newline="", encoding=csv_format.encoding) as file:
            # A file may begin with two byte order marks, if two programs wrote them.
            text = file.readline().lstrip("\ufeff")
            for _ in range(csv_format.preamble):
                text = file.readline()
            separator = csv_format.detected_separator(text)
            reader = csv_format.reader(chain(filter(None, [text]), file), separator)
            for row in reader:
                previous_line, last_line = last_line, csv_format.preamble + reader.line_num
                if last_line > previous_line + 1:
                    raise ValueError(
                        f"'{path}', line {previous_line + 1} must have no cell with a line break "
                        f"(got one up to line {last_line}): is a quote missing?"
                    )
                _check_cells(path, last_line, row, separator, csv_format)
                width = width or _num_names(row)
                yield last_line, row if any(map(str.strip, row[width:])) else row[:width]
    except (csv.Error, UnicodeError) as error:
        raise _text_error(path, error, csv_format) from error
    need(last_line != csv_format.preamble, f"'{path}' must hold at least one frame (got no line)")
    if not is_complete:
        raise ValueError(
            f"'{path}', line {last_line} must end with a line break: is the file truncated? Delete "
            "the line, or add the line break if you know that the line is complete"
        )


def _ends_with_line_break(path: Path) -> bool:
    # Without a line break at its end, the last number of a file may have lost digits.
    with path.open("rb") as file:
        num_bytes = file.seek(0, 2)
        need(num_bytes, f"'{path}' must hold at least one frame (got an empty file)")
        file.seek(-min(2, num_bytes), 2)
        return file.read().strip(b"\0").endswith((b"\r", b"\n"))  # UTF-16 has a null byte


def _num_names(row: Sequence[str]) -> int:
    # The number of cells of a first line, without empty cells at the end of a header.
    num_cells = max((i for i, cell in enumerate(row, 1) if cell.strip()), default=0)
    return num_cells if is_header(row[:num_cells]) else len(row)


def _check_cells(
    path: Path, line: int, row: Sequence[str], separator: str, csv_format: CsvFormat
) -> None:
    if len(row) > 1:
        return
    if not row or not row[0] or row[0].isspace():
        raise ValueError(
            f"'{path}', line {line} must not be empty: delete it, or write a line of empty cells "
            "if a frame is missing"
        )
    if not is_number_cell(row[0]) and _SEPARATOR.search(row[0]):
        sign = "commas" if separator == "," else quoted(separator)
        message = (
            f"'{path}', line {line} must have cells separated by {sign} (got {quoted(row[0])})"
        )
        raise _with_advice(message, csv_format, ": give another ", Argument("separator"))


def _text_error(path: Path, error: Exception, csv_format: CsvFormat) -> ValueError:
    message = f"'{path}' cannot be read as CSV: {error}"
    if not isinstance(error, UnicodeError):
        return ValueError(message)
    return _with_advice(
        message, csv_format, ": give its ", Argument("encoding"), ", such as cp1252 for Windows"
    )


def _with_advice(message: str, csv_format: CsvFormat, *advice: str) -> ValueError:
    return ArgumentError(message, *advice) if csv_format.has_options else ValueError(message)


def read_header(lines: Iterator[tuple[int, list[str]]]) -> list[str]:
    r"""Reads the first line, and returns the names of the columns."""
    return [cell.strip() for cell in next(lines)[1]]


def csv_table(
    path: Path,
    lines: Iterator[tuple[int, list[str]]],
    names: Sequence[str],
    columns: Sequence[int] | None = None,
    *,
    texts: Sequence[int] = (),
    required: Sequence[int] = (),
    row_noun: str = "frame",
    csv_format: CsvFormat = FIXED_FORMAT,
) -> tuple[np.ndarray, list[list[str]]]:
    r"""Reads a table of numbers and strings.

    Args:
        path (Path): The file, for messages.
        lines (iterator): Line numbers and cells, after the header.
        names (sequence of str): The names of all columns.
        columns (sequence of int, optional): The columns with numbers. By default, all columns.
        texts (sequence of int): The columns to return as strings.
        required (sequence of int): The columns in which no number may be missing.
        row_noun (str): The noun for a line, for messages.
        csv_format (CsvFormat): The text format of the file.

    Returns:
        The numbers (one row for each line), and the strings of each line.
    """
    numeric = [*range(len(names))] if columns is None else [*columns]
    required_indices = [i for i, column in enumerate(numeric) if column in required]
    rows, cells = [], []
    for line, row in lines:
        numbers = csv_numbers(path, line, row, names, columns, required, csv_format)
        if required_indices and np.isnan(numbers[required_indices]).any():
            column = next(numeric[i] for i in required_indices if np.isnan(numbers[i]))
            raise _number_error(path, line, column, row, names, csv_format)
        rows.append(numbers)
        cells.append([row[i] for i in texts])
    need(rows, f"'{path}' must hold at least one {row_noun} (got a header only)")
    return np.stack(rows), cells


def csv_columns(
    path: Path,
    lines: Iterator[tuple[int, list[str]]],
    numeric_names: Sequence[str],
    texts: Sequence[str] = (),
    *,
    row_noun: str = "frame",
) -> tuple[np.ndarray, list[list[str]]]:
    r"""Reads the named columns, like :func:`csv_table`. No column and no number may be missing.
    Further columns are ignored.
    """
    header = read_header(lines)
    column_of_name = map_columns(path, header, dict(enumerate(header)))
    check_columns_exist(path, column_of_name, list(dict.fromkeys([*texts, *numeric_names])))
    numeric = [column_of_name[name] for name in numeric_names]
    cells = [column_of_name[name] for name in texts]
    return csv_table(path, lines, header, numeric, texts=cells, required=numeric, row_noun=row_noun)


def csv_numbers(
    path: Path,
    line: int,
    row: Sequence[str],
    names: Sequence[str],
    columns: Sequence[int] | None = None,
    required: Sequence[int] = (),
    csv_format: CsvFormat = FIXED_FORMAT,
) -> np.ndarray:
    r"""Returns the numbers of a line, with NaN for empty cells and missing readings.

    Raises:
        ValueError: If a cell is not a finite number, or the number of cells differs from the number
            of names.
    """
    if len(row) != len(names):
        raise _count_error(path, line, row, names, csv_format)
    cell_columns = range(len(row)) if columns is None else columns
    cells = row if columns is None else [row[i] for i in columns]
    cells = csv_format.number_texts(cells)
    text = "".join(cells)
    # Converts the line at once, which is faster than cell by cell; errors take the slow path.
    try:
        # Python also accepts '1_0' and digits of other scripts.
        if "_" in text or not text.isascii():
            raise ValueError
        numbers = np.array(cells, dtype=object).astype(np.float64)
    except ValueError:
        invalid = [
            i
            for i, cell in zip(cell_columns, cells, strict=True)
            if not _is_number(cell, csv_format)
        ]
        if invalid:
            raise _number_error(path, line, invalid[0], row, names, csv_format) from None
        numbers = np.array([_to_number(cell) for cell in cells])
    if csv_format.missing_numbers:
        numbers[np.isin(numbers, csv_format.missing_numbers)] = math.nan
    # Readings are stored as float32, so numbers beyond its range are infinite as well.
    with np.errstate(over="ignore"):
        infinite = np.flatnonzero(np.isinf(numbers.astype(np.float32)))
    if len(infinite):
        column = cell_columns[int(infinite[0])]
        hint = "" if column in required else ", or empty if it is missing"
        raise ValueError(
            f"'{path}', line {line}, column {column + 1}: {quoted(names[column])} must be finite"
            f"{hint} (got {quoted(row[column])})"
        )
    return numbers


def _count_error(
    path: Path,
    line: int,
    row: Sequence[str],
    names: Sequence[str],
    csv_format: CsvFormat,
) -> ValueError:
    message = f"'{path}', line {line} must have {len(names)} cells (got {len(row)}): "
    if not csv_format.has_options or len(row) < len(names):
        return ValueError(
            f"{message}is the file truncated, or are the cells not separated by commas?"
        )
    return ArgumentError(
        f"{message}if lines come before the header, give their number as ", Argument("preamble")
    )


def is_number_cell(cell: str) -> bool:
    r"""Returns whether a cell holds a number, or is empty."""
    if not cell.isascii() or "_" in cell:
        return False
    try:
        float(cell if cell.strip() else "nan")
    except ValueError:
        return False
    return True


def _is_number(cell: str, csv_format: CsvFormat) -> bool:
    return is_number_cell(cell) or cell.strip() in csv_format.missing_texts


def _to_number(cell: str) -> float:
    return float(cell) if cell.strip() and is_number_cell(cell) else math.nan


def _number_error(
    path: Path,
    line: int,
    column: int,
    row: Sequence[str],
    names: Sequence[str],
    csv_format: CsvFormat = FIXED_FORMAT,
) -> ValueError:
    cell = row[column]
    message = (
        f"'{path}', line {line}, column {column + 1}: {quoted(names[column])} must be a number "
        f"(got {quoted(cell)})"
    )
    if not csv_format.has_options:
        return ValueError(message)
    if is_number_cell(cell.replace(",", ".")):
        return ArgumentError(f"{message}; if it is a decimal comma, give ", Argument("decimal"))
    if line == csv_format.preamble + 2 and is_header(row):
        return ArgumentError(
            f"{message}; if the line holds the units of the columns, give ", Argument("unit_row")
        )
    return ArgumentError(
        f"{message}; if it stands for a missing reading, give it as ", Argument("missing")
    )


def is_header(row: Sequence[str]) -> bool:
    r"""Returns whether a line is a header, with more than half of its cells not numbers. A line of
    numbers with one invalid cell is not a header.
    """
    return sum(not is_number_cell(cell) for cell in row) > len(row) / 2


def is_counted_header(row: Sequence[str]) -> bool:
    r"""Returns whether a line is ``0,1,2,...``, the header that pandas writes for columns without
    names, with or without the empty cell above its index.
    """
    names = [cell.strip() for cell in row]
    if len(names) > 1 and not names[0]:
        names = names[1:]
    return names == [str(i) for i in range(len(names))]


def check_no_counted_header(path: Path, row: Sequence[str], options: str) -> None:
    r"""Raises an error if the first line is a header of the numbers 0, 1, 2, ..."""
    if is_counted_header(row):
        raise ValueError(
            f"'{path}', line 1 must hold names of columns or a frame (got 0, 1, 2, ..., which "
            "pandas writes for columns without names): name them, or write the file with "
            f"to_csv(header=False, index=False); {options}"
        )


def check_no_index(path: Path, names: Sequence[str], ignore: Sequence[str] = ()) -> None:
    r"""Raises an error if a column is the index that pandas writes in front of the columns."""
    for column, name in enumerate(names, 1):
        unnamed = (column == 1 and not name) or re.fullmatch(r"Unnamed: [0-9]+", name)
        if unnamed and len(names) > 1 and name not in ignore:
            raise ValueError(
                f"'{path}', line 1 must name column {column} (got {quoted(name)}, as pandas writes "
                "above its index): write the file with to_csv(index=False), or name the column"
            )


def map_columns(path: Path, names: Sequence[str], keys: Mapping[int, _Key]) -> dict[_Key, int]:
    r"""Inverts a mapping of columns to keys, such as names.

    Raises:
        ValueError: If two columns have the same key.
    """
    column_of_key: dict[_Key, int] = {}
    for column, key in keys.items():
        if key in column_of_key:
            first_name, name = quoted(names[column_of_key[key]]), quoted(names[column])
            duplicates = f"{name} twice" if name == first_name else f"{first_name} and {name}"
            raise ValueError(f"'{path}', line 1 must name each column once (got {duplicates})")
        column_of_key[key] = column
    return column_of_key


def check_columns_exist(path: Path, names: Container[str], required: Sequence[str]) -> None:
    r"""Raises an error if a required column is missing."""
    missing_columns = [name for name in required if name not in names]
    if missing_columns:
        raise ValueError(
            f"'{path}' must have the column '{missing_columns[0]}' ({len(missing_columns)} of "
            f"{len(required)} columns are missing)"
        )
