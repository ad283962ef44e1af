r"""Recordings as CSV files with column names of their own, as the logger of a glove writes them."""

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from torch_geometric_tactile.data import Recording
from torch_geometric_tactile.io.csv_table import csv_numbers, csv_rows
from torch_geometric_tactile.io.recording_schema import checked_file
from torch_geometric_tactile.typing import PathLike

_TIMES = ("time", "timestamp", "t")
_SECONDS_PER_UNIT = {"s": 1.0, "ms": 1e-3, "us": 1e-6}


class _Columns(NamedTuple):
    time: int | None
    tactile: list[int]
    joint: list[int]
    label: int | None
    names: list[str]


def read_named_csv(
    path: PathLike,
    *,
    tactile: Sequence[str] | str | None = None,
    num_channels: int = 1,
    joint: Sequence[str] | str = (),
    time: str | None = None,
    time_unit: str = "s",
    label: str | None = None,
    ignore: Sequence[str] = (),
    unit: str | None = None,
    rate: float = 100.0,
) -> Recording:
    r"""Reads a recording from a CSV file with one frame a row and a header with names.

    Empty cells and :obj:`nan` are missing readings.

    Args:
        path (str or PathLike): The file.
        tactile (sequence of str or str, optional): The columns of the readings, taxel by taxel in
            the order of the layout, each with its channels; or a regular expression for their
            names, in the order of the file. If left out, all columns that are nothing else.
        num_channels (int): Number of channels of a taxel :math:`C`.
        joint (sequence of str or str): The columns of the joint angles in radians, or a regular
            expression for their names.
        time (str, optional): The column of the time; if left out, one named :obj:`time`,
            :obj:`timestamp` or :obj:`t`, in capitals or not, if there is one.
        time_unit (str): Unit of the time, :obj:`"s"`, :obj:`"ms"` or :obj:`"us"`.
        label (str, optional): The column of the label, of integers or texts. If it is the same in
            all frames, it is the :obj:`label` of the recording, otherwise it is in
            :obj:`privileged` under its name.
        ignore (sequence of str): Columns that are not read.
        unit (str, optional): Unit of the readings, :obj:`"count"` or :obj:`"newton"`, for
            :obj:`meta`.
        rate (float): Frames per second, for files without time.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If a column is missing or named twice, the readings are no multiple of the
            channels, a line has another number of cells or no end (a file that was cut), a cell is
            no finite number, the time does not increase, or there is no frame. The message names
            the line.
    """
    path = checked_file(path)
    if not rate > 0:
        raise ValueError(f"'rate' must be positive (got {rate})")
    if time_unit not in _SECONDS_PER_UNIT:
        raise ValueError(f"'time_unit' must be one of {list(_SECONDS_PER_UNIT)} (got {time_unit})")
    if num_channels < 1:
        raise ValueError(f"'num_channels' must be at least 1 (got {num_channels})")
    lines = csv_rows(path)
    header = next((row for _, row in lines), [])
    columns = _columns(path, header, tactile, joint, time, label, ignore)
    if not columns.tactile or len(columns.tactile) % num_channels:
        raise ValueError(
            f"'{path}' must have columns of readings for taxels of {num_channels} channels (got "
            f"{len(columns.tactile)}: {_few([columns.names[i] for i in columns.tactile])})"
        )
    numeric = [*columns.tactile, *columns.joint]
    numeric += [] if columns.time is None else [columns.time]
    names = [columns.names[i] for i in numeric]
    rows, labels = [], []
    for line, row in lines:
        if len(row) != len(header):
            raise ValueError(
                f"'{path}', line {line} must have {len(header)} cells (got {len(row)}): is the "
                "file cut, or are the cells not separated by commas?"
            )
        rows.append(csv_numbers(path, line, [row[i] for i in numeric], names))
        if columns.label is not None:
            labels.append(row[columns.label].strip())
    if not rows:
        raise ValueError(f"'{path}' must hold at least one frame (got a header only)")
    table = np.stack(rows)
    stop = len(columns.tactile)
    seconds = np.arange(len(table)) / rate
    if columns.time is not None:
        seconds = table[:, -1] * _SECONDS_PER_UNIT[time_unit]
    content: dict[str, Any] = {} if label is None else _labels(path, label, labels)
    try:
        return Recording(
            time=seconds,
            tactile=table[:, :stop].reshape(len(table), -1, num_channels),
            joint=table[:, stop : stop + len(columns.joint)] if columns.joint else None,
            meta={} if unit is None else {"unit": unit},
            **content,
        )
    except ValueError as error:
        raise ValueError(f"'{path}': {error}") from error


def _columns(
    path: Path,
    header: Sequence[str],
    tactile: Sequence[str] | str | None,
    joint: Sequence[str] | str,
    time: str | None,
    label: str | None,
    ignore: Sequence[str],
) -> _Columns:
    names = [cell.strip() for cell in header]
    twice = [name for i, name in enumerate(names) if name in names[:i]]
    if twice:
        raise ValueError(f"'{path}' must name each column once (got '{twice[0]}' twice)")

    def find(name: str) -> int:
        if name not in names:
            raise ValueError(f"'{path}' must have the column '{name}' (got {_few(names)})")
        return names.index(name)

    def find_all(wanted: Sequence[str] | str) -> list[int]:
        if isinstance(wanted, str):
            return [i for i, name in enumerate(names) if re.fullmatch(wanted, name)]
        return [find(name) for name in wanted]

    if time is None:
        time = next((name for name in names if name.lower() in _TIMES), None)
    time_column = None if time is None else find(time)
    label_column = None if label is None else find(label)
    joints = find_all(joint)
    used = {time_column, label_column, *joints, *(find(name) for name in ignore)}
    if tactile is None:
        readings = [i for i in range(len(names)) if i not in used]
    else:
        readings = find_all(tactile)
    both = [names[i] for i in readings if i in used]
    if both:
        raise ValueError(f"column '{both[0]}' of '{path}' must be one thing only (got it for two)")
    return _Columns(time_column, readings, joints, label_column, names)


def _labels(path: Path, name: str, labels: Sequence[str]) -> dict[str, Any]:
    if "" in labels:
        raise ValueError(
            f"'{path}' must have a label in every frame in '{name}' (got none in frame "
            f"{labels.index('')})"
        )
    is_integer = all(re.fullmatch(r"[+-]?\d+", text) for text in labels)
    values = np.array([int(text) for text in labels]) if is_integer else np.array(labels)
    if len(set(values.tolist())) == 1:
        return {"label": values[0].item()}
    return {"privileged": {name: values}}


def _few(names: Sequence[str]) -> str:
    return ", ".join(names[:6]) + (", ..." if len(names) > 6 else "")
