r"""The CSV files of ``xela_log``, the logger of XELA's server: one message of one sensor a row."""

import logging
import re
from collections.abc import Mapping, Sequence
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from torch_geometric_tactile._texts import quoted, short_list
from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile.data import Recording
from torch_geometric_tactile.io._csv_frames import check_increasing_time
from torch_geometric_tactile.io._csv_table import csv_rows, csv_table, map_columns, read_header
from torch_geometric_tactile.io._recording_schema import checked_file, new_recording

_SEND_TIME, _NUMBER = "send time", "message number"
_NEEDED = (_SEND_TIME, _NUMBER)
_CLOCKS = {"receive time", *_NEEDED}
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
    header = read_header(lines)
    names = _names(header)
    matches = {i: match for i, name in enumerate(names) if (match := _COLUMN.fullmatch(name))}
    readings = {i: (match[1], int(match[2]), match[3]) for i, match in matches.items()}
    place = map_columns(path, header, {i: readings.get(i, name) for i, name in enumerate(names)})
    for name in _NEEDED:
        if name not in place:
            raise ValueError(
                f"'{path}' must have the column '{name.capitalize()}', as a log of xela_log (got "
                f"{short_list(header, 3, quoted, ending='')})"
            )
    counts, newtons = (_reading_columns(path, place, start) for start in (None, "force "))
    if forces and not newtons:
        raise ValueError(
            f"'{path}' must have the column 'Force 1X' for forces in newtons (got counts only): "
            "read counts with forces=False"
        )
    if not forces and not counts:
        some = short_list(header, 6, quoted, ending="")
        got = "forces only): use forces=True" if newtons else f"{some})"
        raise ValueError(f"'{path}' must have the column '1X' (got {got}")
    clocks = [place[name] for name in _NEEDED]
    compared = [*clocks, *counts, *newtons]
    read = [*compared, *(place[name] for name in names if name in _CLOCKS and name not in _NEEDED)]
    unread = sorted({*range(len(header))} - {*read})
    if unread:
        some = short_list([header[i] for i in unread], 6, quoted, ending="")
        _logger.warning("'%s' has columns that are not read: %s", path, some)
    table, _ = csv_table(path, lines, header, read, required=clocks)
    kept: list[int] = []
    for i, row in enumerate(table[:, : len(compared)]):
        if not kept or not _is_stale(row, table[kept[-1], : len(compared)]):
            kept.append(i)
    time = table[kept, 0]
    check_increasing_time(path, time, [i + 2 for i in kept], "Send time")
    columns = [read.index(column) for column in (newtons if forces else counts)]
    return new_recording(
        path,
        time=time,
        tactile=table[kept][:, columns].reshape(len(kept), -1, 3),
        meta={
            "sensor": "XELA uSkin",
            "unit": "newton" if forces else "count",
            "stale_rows": len(table) - len(kept),
        },
    )


def _is_stale(row: np.ndarray, before: np.ndarray) -> bool:
    # Rows of the send time, the number and the readings.
    return bool((row[:2] == before[:2]).any()) or np.array_equal(row[2:], before[2:], True)


def is_xela_log(header: Sequence[str]) -> bool:
    r"""Tells whether a first line names what only a XELA log has, or lacks a part of.

    Examples:
        >>> is_xela_log(["1X", "1Y", "1Z", "Send_time"]), is_xela_log(["time", "thumb"])
        (True, False)
    """
    return not _CLOCKS.isdisjoint(_names(header))


def _names(header: Sequence[str]) -> list[str]:
    return [" ".join(name.lower().replace("_", " ").split()) for name in header]


def _reading_columns(path: Path, place: Mapping[Any, int], start: str | None) -> list[int]:
    found = {key[1:] for key in place if isinstance(key, tuple) and key[0] == start}
    taxels = {taxel for taxel, _ in found}
    first = 0 if 0 in taxels else 1
    wanted = [*product(range(first, first + len(taxels)), "xyz")]
    missing = next((key for key in wanted if key not in found), None)
    if missing is not None:
        raise ValueError(
            f"'{path}' must have the column '{'Force ' if start else ''}{missing[0]}"
            f"{missing[1].upper()}', as it has taxel {max(taxels)} (got {len(found)} of "
            f"{3 * (max(taxels) + 1 - first)} columns)"
        )
    return [place[start, *key] for key in wanted]
