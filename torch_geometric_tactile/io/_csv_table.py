r"""Tables of numbers in CSV files: a quick reader whose errors name line and column."""

import csv
import math
import re
from collections.abc import Container, Hashable, Iterator, Mapping, Sequence
from itertools import chain
from pathlib import Path
from typing import TypeVar

import numpy as np

from torch_geometric_tactile._checks import need
from torch_geometric_tactile._texts import quoted

# With these a spreadsheet program takes a cell for a formula, and runs it; also as wide characters.
_FORMULA = ("=", "+", "-", "@", "\uff1d", "\uff0b", "\uff0d", "\uff20")
_Key = TypeVar("_Key", bound=Hashable)
_SEPARATOR = re.compile(r"[;\t|]")


def safe_cell(text: str) -> str:
    r"""Returns a text for a cell of a CSV file, such that no spreadsheet program takes it for a
    formula: with an apostrophe in front if it begins like one, also behind apostrophes. Numbers are
    to be written as they are, not through this function.

    Examples:
        >>> safe_cell("mug"), safe_cell("=1+1")
        ('mug', "'=1+1")
    """
    return f"'{text}" if _is_formula(text) else text


def text_of_cell(cell: str) -> str:
    r"""Returns the text that :func:`safe_cell` made a cell of.

    Examples:
        >>> text_of_cell("mug"), text_of_cell("'=1+1")
        ('mug', '=1+1')
    """
    return cell[1:] if cell.startswith("'") and _is_formula(cell) else cell


def _is_formula(text: str) -> bool:
    text = text.lstrip("'")
    return text.startswith(("\t", "\r", "\n")) or text.lstrip().startswith(_FORMULA)


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
                if len(row) == 1 and not is_number_cell(row[0]) and _SEPARATOR.search(row[0]):
                    raise ValueError(
                        f"'{path}', line {last} must have cells that are separated by commas (got "
                        f"{quoted(row[0])})"
                    )
                yield last, row
    except (csv.Error, UnicodeDecodeError) as error:
        raise ValueError(f"'{path}' cannot be read as CSV: {error}") from error
    need(last != 0, f"'{path}' must hold at least one frame (got no line)")
    if not whole:
        raise ValueError(
            f"'{path}', line {last} must end with a line break: is the file truncated? Delete the "
            "line, or add the line break if you know that the line is complete"
        )


def csv_names(lines: Iterator[tuple[int, list[str]]]) -> list[str]:
    r"""Returns the names of the columns, which are the first of the lines."""
    return [cell.strip() for cell in next(lines)[1]]


def csv_table(
    path: Path,
    lines: Iterator[tuple[int, list[str]]],
    names: Sequence[str],
    columns: Sequence[int] | None = None,
    *,
    texts: Sequence[int] = (),
    required: Sequence[int] = (),
    what: str = "frame",
) -> tuple[np.ndarray, list[list[str]]]:
    r"""Returns the numbers of some columns, or of all, and the cells of others as texts. In those
    that are required, no number may be missing.
    """
    places = [*range(len(names))] if columns is None else [*columns]
    needed = [i for i, place in enumerate(places) if place in required]
    rows, cells = [], []
    for line, row in lines:
        numbers = csv_numbers(path, line, row, names, columns, required)
        if needed and np.isnan(numbers[needed]).any():
            place = next(places[i] for i in needed if np.isnan(numbers[i]))
            raise _no_number(path, line, place, row[place], names[place])
        rows.append(numbers)
        cells.append([row[i] for i in texts])
    need(rows, f"'{path}' must hold at least one {what} (got a header only)")
    return np.stack(rows), cells


def csv_columns(
    path: Path,
    lines: Iterator[tuple[int, list[str]]],
    wanted: Sequence[str],
    texts: Sequence[str] = (),
    *,
    what: str = "frame",
) -> tuple[np.ndarray, list[list[str]]]:
    r"""Returns the numbers of columns with these names, of which none may be missing, and the cells
    of others as texts. Further columns are not read.
    """
    header = csv_names(lines)
    place = placed(path, header, dict(enumerate(header)))
    refuse_missing(path, place, list(dict.fromkeys([*texts, *wanted])))
    numeric = [place[name] for name in wanted]
    cells = [place[name] for name in texts]
    return csv_table(path, lines, header, numeric, texts=cells, required=numeric, what=what)


def csv_numbers(
    path: Path,
    line: int,
    row: Sequence[str],
    names: Sequence[str],
    columns: Sequence[int] | None = None,
    required: Sequence[int] = (),
) -> np.ndarray:
    r"""Returns the numbers of a line, NaN for empty cells."""
    if len(row) != len(names):
        raise ValueError(
            f"'{path}', line {line} must have {len(names)} cells (got {len(row)}): is the file "
            "truncated, or are the cells not separated by commas?"
        )
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
        hint = "" if column in required else ", or empty where it is missing"
        raise ValueError(
            f"'{path}', line {line}, column {column + 1}: {quoted(names[column])} must be finite"
            f"{hint} (got {quoted(row[column])})"
        )
    return numbers


def is_number_cell(cell: str) -> bool:
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
    if is_number_cell(cell):
        return float(cell)
    raise _no_number(path, line, column, cell, name)


def _no_number(path: Path, line: int, column: int, cell: str, name: str) -> ValueError:
    return ValueError(
        f"'{path}', line {line}, column {column + 1}: {quoted(name)} must be a number "
        f"(got {quoted(cell)})"
    )


def has_names(row: Sequence[str]) -> bool:
    r"""Tells whether a line is a header: if most of its cells are no numbers. One wrong cell does
    not make a line of numbers a header.
    """
    return sum(not is_number_cell(cell) for cell in row) > len(row) / 2


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


def placed(path: Path, names: Sequence[str], keys: Mapping[int, _Key]) -> dict[_Key, int]:
    r"""Returns the columns by what they are, and checks that each is something of its own."""
    place: dict[_Key, int] = {}
    for column, key in keys.items():
        if key in place:
            before, name = quoted(names[place[key]]), quoted(names[column])
            got = f"{name} twice" if name == before else f"{before} and {name}"
            raise ValueError(f"'{path}', line 1 must name each column once (got {got})")
        place[key] = column
    return place


def refuse_missing(path: Path, names: Container[str], wanted: Sequence[str]) -> None:
    r"""Checks that there are all columns that a file must have."""
    missing = [name for name in wanted if name not in names]
    if missing:
        raise ValueError(
            f"'{path}' must have the column '{missing[0]}' ({len(missing)} of {len(wanted)} "
            "columns are missing)"
        )
