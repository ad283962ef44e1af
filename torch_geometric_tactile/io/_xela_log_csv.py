r"""Reader of the CSV files of ``xela_log``, the logger of XELA's server."""

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
from torch_geometric_tactile.io._csv_format import CsvFormat
from torch_geometric_tactile.io._csv_frames import check_increasing_time
from torch_geometric_tactile.io._csv_table import csv_rows, csv_table, map_columns, read_header
from torch_geometric_tactile.io._recording_schema import new_recording, recording_path

_SEND_TIME, _MESSAGE_NUMBER = "send time", "message number"
_REQUIRED_COLUMNS = (_SEND_TIME, _MESSAGE_NUMBER)
_CLOCK_COLUMNS = {"receive time", *_REQUIRED_COLUMNS}
_NO_FORMAT = CsvFormat()
_logger = logging.getLogger(__name__)
_READING_COLUMN = re.compile(r"(force )?([0-9]{1,9})([xyz])")


def read_xela_log_csv(
    path: PathLike,
    forces: bool = False,
    csv_format: CsvFormat = _NO_FORMAT,
    num_frames: int | None = None,
) -> Recording:
    r"""Reads a recording from a XELA log with the header ``Receive time,Send time,Message
    number,1X,1Y,1Z,...`` and, for a calibrated sensor, ``Force 1X,Force 1Y,Force 1Z,...``.

    The log has about 500 rows per second. Most rows repeat the readings of the previous row with a
    new number and time. Rows with the readings, the number or the send time of the previous row are
    left out, and :obj:`"stale_rows"` in the metadata is their number.

    Args:
        path (str or PathLike): The file. The columns of its header may be in any order, and taxels
            may be numbered from 1 or from 0.
        forces (bool): Whether to read the forces in newtons instead of the counts.
        csv_format (CsvFormat): Separator, decimal sign, encoding, and missing readings, for files
            that another program has saved.
        num_frames (int, optional): The number of rows to read from the start of the file. Defaults
            to all rows.

    Returns:
        Recording: The readings of the three axes, with the send time in seconds since 1970.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If a column is missing (including the forces, with :obj:`forces`) or named
            twice, a line is empty or truncated, a cell is not a finite number, or the time does not
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
    path = recording_path(path)
    lines = csv_rows(path, csv_format)
    header = read_header(lines)
    names = _normalize_names(header)
    matches = {
        i: match for i, name in enumerate(names) if (match := _READING_COLUMN.fullmatch(name))
    }
    readings = {i: (match[1], int(match[2]), match[3]) for i, match in matches.items()}
    column_of_key = map_columns(
        path, header, {i: readings.get(i, name) for i, name in enumerate(names)}
    )
    for name in _REQUIRED_COLUMNS:
        if name not in column_of_key:
            raise ValueError(
                f"'{path}' must have the column '{name.capitalize()}', as xela_log writes it (got "
                f"{short_list(header, 3, quoted, ending='')})"
            )
    counts, newtons = (_reading_columns(path, column_of_key, start) for start in (None, "force "))
    if forces and not newtons:
        raise ValueError(
            f"'{path}' must have the column 'Force 1X' for forces in newtons (got counts only): "
            "read counts with forces=False"
        )
    if not forces and not counts:
        listed = short_list(header, 6, quoted, ending="")
        actual = "forces only): use forces=True" if newtons else f"{listed})"
        raise ValueError(f"'{path}' must have the column '1X' (got {actual}")
    clocks = [column_of_key[name] for name in _REQUIRED_COLUMNS]
    compared_columns = [*clocks, *counts, *newtons]
    columns_read = [
        *compared_columns,
        *(
            column_of_key[name]
            for name in names
            if name in _CLOCK_COLUMNS and name not in _REQUIRED_COLUMNS
        ),
    ]
    unread_columns = sorted({*range(len(header))} - {*columns_read})
    if unread_columns:
        listed = short_list([header[i] for i in unread_columns], 6, quoted, ending="")
        _logger.warning("'%s' has columns that are not read: %s", path, listed)
    table, _ = csv_table(path, lines, header, columns_read, required=clocks, csv_format=csv_format)
    kept_rows: list[int] = []
    for i, row in enumerate(table[:, : len(compared_columns)]):
        if not kept_rows or not _is_stale(row, table[kept_rows[-1], : len(compared_columns)]):
            kept_rows.append(i)
    time = table[kept_rows, 0]
    first_line = csv_format.preamble + 2
    check_increasing_time(path, time, [first_line + i for i in kept_rows], "Send time")
    columns = [columns_read.index(column) for column in (newtons if forces else counts)]
    return new_recording(
        path,
        time=time,
        tactile=table[kept_rows][:, columns].reshape(len(kept_rows), -1, 3),
        meta={
            "sensor": "XELA uSkin",
            "unit": "newton" if forces else "count",
            "stale_rows": len(table) - len(kept_rows),
        },
    )


def _is_stale(row: np.ndarray, previous: np.ndarray) -> bool:
    # Rows of send time, message number and readings. Missing readings (NaN) count as equal.
    return bool((row[:2] == previous[:2]).any()) or np.array_equal(row[2:], previous[2:], True)


def is_xela_log(header: Sequence[str]) -> bool:
    r"""Returns whether a header has a column that only XELA logs have. The header may be
    incomplete.

    Examples:
        >>> is_xela_log(["1X", "1Y", "1Z", "Send_time"]), is_xela_log(["time", "thumb"])
        (True, False)
    """
    return not _CLOCK_COLUMNS.isdisjoint(_normalize_names(header))


def _normalize_names(header: Sequence[str]) -> list[str]:
    return [" ".join(name.lower().replace("_", " ").split()) for name in header]


def _reading_columns(path: Path, column_of_key: Mapping[Any, int], prefix: str | None) -> list[int]:
    keys = {key[1:] for key in column_of_key if isinstance(key, tuple) and key[0] == prefix}
    taxels = {taxel for taxel, _ in keys}
    first_taxel = 0 if 0 in taxels else 1
    expected_keys = [*product(range(first_taxel, first_taxel + len(taxels)), "xyz")]
    missing = next((key for key in expected_keys if key not in keys), None)
    if missing is not None:
        raise ValueError(
            f"'{path}' must have the column '{'Force ' if prefix else ''}{missing[0]}"
            f"{missing[1].upper()}', since it has taxel {max(taxels)} (got {len(keys)} of "
            f"{3 * (max(taxels) + 1 - first_taxel)} columns)"
        )
    return [column_of_key[prefix, *key] for key in expected_keys]
