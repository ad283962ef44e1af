r"""The CSV files of ``xela_log``, the logger of XELA's server: one message of one sensor a row."""

import logging
import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from torch_geometric_tactile._texts import quoted
from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile.data import Recording
from torch_geometric_tactile.io._csv_table import csv_numbers, csv_rows
from torch_geometric_tactile.io._recording_schema import checked_file

_SEND_TIME, _NUMBER = "send time", "message number"
_CLOCKS = {"receive time", _SEND_TIME, _NUMBER}
_logger = logging.getLogger(__name__)
_COLUMN = re.compile(r"(force )?([0-9]{1,9})([xyz])")


def read_xela_log_csv(path: PathLike, forces: bool = False) -> Recording:
    r"""Reads a recording from a XELA log with the header ``Receive time,Send time,Message
    number,1X,1Y,1Z,...`` and, for a calibrated sensor, ``Force 1X,Force 1Y,Force 1Z,...``.

    The log has about 500 rows per second, and most repeat the readings of the row before, under a
    number and a time of their own. Such a row, or one with the number or the send time of the row
    before, is left out, and counted as :obj:`"stale_rows"` in the metadata.

    Args:
        path (str or PathLike): The file; the number of taxels is that of its header, whose columns
            may be in any order and count from 1 or from 0.
        forces (bool): Whether to read the forces in newtons instead of the counts.

    Returns:
        Recording: The send time in seconds since 1970, and the readings of the three axes.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If a column is missing (also those of the forces, if they are wanted) or named
            twice, a line is empty or cut, a cell is no finite number, or the time does not
            increase. The message names the line.

    Examples:
        >>> import tempfile
        >>> from pathlib import Path
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     path = Path(folder) / "log.csv"
        ...     _ = path.write_text(
        ...         "Receive time,Send time,Message number,1X,1Y,1Z\n"
        ...         "1500000000.1,1500000000.0,7,30000,30001,30002\n"
        ...         "1500000000.2,1500000000.1,8,30010,30011,30012\n"
        ...     )
        ...     recording = read_xela_log_csv(path)
        >>> recording.tactile[0].tolist()
        [[30000.0, 30001.0, 30002.0]]
    """
    path = checked_file(path)
    lines = csv_rows(path)
    _, header = next(lines)
    names = _names(header)
    _refuse_twice(path, names, header)
    for name in (_SEND_TIME, _NUMBER):
        if name not in names:
            raise ValueError(
                f"'{path}' must have the column '{name.capitalize()}', as a log of xela_log (got "
                f"{', '.join(map(quoted, header[:3]))})"
            )
    time_column, number_column = names.index(_SEND_TIME), names.index(_NUMBER)
    reading_columns = _reading_columns(path, names, force=False)
    force_columns = _reading_columns(path, names, force=True)
    if forces and not force_columns:
        raise ValueError(
            f"'{path}' must have the column 'Force 1X' for forces in newtons (got counts only): "
            "read counts with forces=False"
        )
    if not reading_columns and not force_columns:
        raise ValueError(
            f"'{path}' must have the column '1X' (got {', '.join(map(quoted, header[:6]))})"
        )
    clocks = [i for i, name in enumerate(names) if name in _CLOCKS]
    read = [*clocks, *reading_columns, *force_columns]
    unread = sorted({*range(len(header))} - {*read})
    if unread:
        some = ", ".join(quoted(header[i]) for i in unread[:6])
        _logger.warning("'%s' has columns that are not read: %s", path, some)
    measured = [*reading_columns, *force_columns]
    columns = force_columns if forces else reading_columns
    if not columns:
        raise ValueError(f"'{path}' must have the column '1X' (got forces only): use forces=True")
    rows: list[np.ndarray] = []
    stale, before = 0, None
    for line, row in lines:
        numbers = np.full(len(header), np.nan)
        numbers[read] = csv_numbers(path, line, row, header, read)
        time, number = numbers[time_column], numbers[number_column]
        for name, value in ((_SEND_TIME, time), (_NUMBER, number)):
            if np.isnan(value):
                raise ValueError(
                    f"'{path}', line {line}: '{name.capitalize()}' must be a number (got '')"
                )
        if before is not None:
            if (
                number == before[number_column]
                or time == before[time_column]
                or np.array_equal(numbers[measured], before[measured], equal_nan=True)
            ):
                stale += 1
                continue
            if time < before[time_column]:
                raise ValueError(
                    f"'{path}', line {line}: 'Send time' must increase (got {float(time)} s after "
                    f"{float(before[time_column])} s)"
                )
        before = numbers
        rows.append(numbers)
    if not rows:
        raise ValueError(f"'{path}' must hold at least one frame (got a header only)")
    table = np.stack(rows)
    try:
        return Recording(
            time=table[:, time_column],
            tactile=table[:, columns].reshape(len(table), -1, 3),
            meta={
                "sensor": "XELA uSkin",
                "unit": "newton" if forces else "count",
                "stale_rows": stale,
            },
        )
    except ValueError as error:
        raise ValueError(f"'{path}': {error}") from error


def is_xela_log(header: Sequence[str]) -> bool:
    r"""Tells whether a first line names what only a XELA log has, or lacks a part of.

    Examples:
        >>> is_xela_log(["1X", "1Y", "1Z", "Send_time"]), is_xela_log(["time", "thumb"])
        (True, False)
    """
    return not _CLOCKS.isdisjoint(_names(header))


def _names(header: Sequence[str]) -> list[str]:
    return [" ".join(name.lower().replace("_", " ").split()) for name in header]


def _refuse_twice(path: Path, names: list[str], header: list[str]) -> None:
    keys: set[object] = set()
    for name, cell in zip(names, header, strict=True):
        match = _COLUMN.fullmatch(name)
        key = name if match is None else (match[1], int(match[2]), match[3])
        if key in keys:
            raise ValueError(
                f"'{path}', line 1 must name each column once (got {quoted(cell)} twice)"
            )
        keys.add(key)


def _reading_columns(path: Path, names: list[str], force: bool) -> list[int]:
    place = {}
    for column, name in enumerate(names):
        match = _COLUMN.fullmatch(name)
        if match and bool(match[1]) == force:
            place[int(match[2]), match[3]] = column
    taxels = {taxel for taxel, _ in place}
    first = 0 if 0 in taxels else 1
    for taxel in range(first, first + len(taxels)):
        for axis in "xyz":
            if (taxel, axis) not in place:
                raise ValueError(
                    f"'{path}' must have the column '{'Force ' if force else ''}{taxel}"
                    f"{axis.upper()}', as it has taxel {max(taxels)} (got {len(place)} of "
                    f"{3 * (max(taxels) + 1 - first)} columns)"
                )
    return [place[taxel, axis] for taxel in sorted(taxels) for axis in "xyz"]
