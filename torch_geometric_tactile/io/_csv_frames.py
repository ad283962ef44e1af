r"""Recordings in CSV files with one frame a line: what the columns are, and the frames in them."""

import itertools
import logging
import re
from collections.abc import Iterator, Sequence
from decimal import Decimal
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from torch_geometric_tactile._texts import quoted
from torch_geometric_tactile.data import Recording
from torch_geometric_tactile.io._csv_table import csv_table
from torch_geometric_tactile.io._folder_tables import annotations_beside
from torch_geometric_tactile.io._recording_schema import new_recording

# A column 't_h' or 't_d' may be something else than a time.
_TIME = re.compile(r"(?:time|timestamp|t(?!_(?:min|h|d)))(?:_(s|ms|us|ns|min|h|d))?", re.ASCII)
# Times whose unit is not known, and numbers of frames.
_CLOCK = re.compile(
    r"(?:time|timestamp)[\W_]+\w.*|#|(?:.*[\W_])?(?:time|timestamp|datetime|stamp|epoch|elapsed|ts|"
    r"secs?|seconds|zeit)|(?:frame|sample|seq|sequence|counter|message)(?:[\W_]+(?:id|index|no|num|"
    r"number))?"
)
_PLACES = {"s": 0, "ms": 3, "us": 6, "ns": 9}
_SECONDS = {"min": 60, "h": 3600, "d": 86400}
TIME_UNITS = (*_PLACES, *_SECONDS)
# Frames a second that no array of taxels gives: XELA's gives 500, vibration of a BioTac 2,200. With
# a unit of the time that fits, there are as many as in the range.
_FASTEST = 3000.0
_USUAL_RATES = (10.0, 2000.0)
_AXES = ("x", "y", "z")
_LATEST = 1e11  # seconds: the year 5138
_logger = logging.getLogger(__name__)


def signal_names(num_taxels: int, num_channels: int, num_joints: int = 0) -> Iterator[str]:
    r"""Yields the names of the columns of readings, and of joints; up to three channels are axes.

    Examples:
        >>> [*signal_names(1, 2, 1)]
        ['taxel_0_x', 'taxel_0_y', 'joint_0']
    """
    axes = axes_of(num_channels)
    yield from (f"taxel_{taxel}_{axis}" for taxel in range(num_taxels) for axis in axes)
    yield from (f"joint_{joint}" for joint in range(num_joints))


def axes_of(num_channels: int) -> list[str]:
    r"""Returns the names of the channels of a taxel."""
    if num_channels <= len(_AXES):
        return list(_AXES[:num_channels])
    return [str(channel) for channel in range(num_channels)]


class FrameColumns(NamedTuple):
    r"""What the columns of a file are.

    :obj:`tactile` and :obj:`joint` are columns in the order of the recording, and :obj:`degrees`
    the joints whose angles are in degrees; :obj:`extra` are further signals. The readings are
    divided by :obj:`per_unit` to be in :obj:`unit`.
    """

    names: list[str]
    tactile: list[int]
    num_channels: int
    joint: list[int]
    degrees: list[int]
    time: int | None
    time_unit: str
    label: int | None = None
    unit: str | None = None
    per_unit: float = 1.0
    extra: Sequence[int] = ()


class Frames(NamedTuple):
    r"""The frames of a file: readings :math:`(T, N C)`, joint angles :math:`(T, J)`, further
    signals :math:`(T, E)`, the time in seconds :math:`(T,)` if there is one, and the cells of the
    time and of the label.
    """

    tactile: np.ndarray
    joint: np.ndarray
    extra: np.ndarray
    time: np.ndarray | None
    time_cells: list[str]
    labels: list[str]


def read_frames(
    path: Path, lines: Iterator[tuple[int, list[str]]], columns: FrameColumns, first_line: int = 2
) -> Frames:
    r"""Reads the lines of a file after its header."""
    timed, labelled = (
        [] if column is None else [column] for column in (columns.time, columns.label)
    )
    groups = [columns.tactile, columns.joint, columns.extra]
    numeric = [*itertools.chain(*groups), *timed]
    texts = [*timed, *labelled]
    table, cells = csv_table(path, lines, columns.names, numeric, texts=texts, required=timed)
    ends = np.cumsum([len(group) for group in groups])
    tactile, joint, extra, _ = np.split(table, ends, axis=1)
    joint[:, columns.degrees] = np.deg2rad(joint[:, columns.degrees])
    time, time_cells = None, [row[0].strip() for row in cells if timed]
    if timed:
        unit, name = columns.time_unit, columns.names[timed[0]]
        found = [
            _seconds(path, line, cell, unit) for line, cell in enumerate(time_cells, first_line)
        ]
        time = np.array(found)
        refuse_backwards(path, time, [*range(first_line, first_line + len(time))], name)
    return Frames(
        tactile=tactile if columns.per_unit == 1 else tactile / columns.per_unit,
        joint=joint,
        extra=extra,
        time=time,
        time_cells=time_cells,
        labels=[row[-1] for row in cells if labelled],
    )


def recording_of(
    path: Path, frames: Frames, columns: FrameColumns, rate: float, **content: Any
) -> Recording:
    r"""Returns the recording of the frames of a file, whose :obj:`rate` counts without a time, with
    the annotations beside it.
    """
    num_frames = len(frames.tactile)
    return new_recording(
        path,
        time=np.arange(num_frames) / rate if frames.time is None else frames.time,
        tactile=frames.tactile.reshape(num_frames, -1, columns.num_channels),
        joint=frames.joint if columns.joint else None,
        extra={columns.names[i]: frames.extra[:, k] for k, i in enumerate(columns.extra)},
        annotations=annotations_beside(path),
        **content,
    )


def refuse_backwards(path: Path, seconds: np.ndarray, lines: Sequence[int], name: str) -> None:
    r"""Checks that the time of some lines increases.

    Shapes:
        - **seconds:** The times of the lines :math:`(T,)`.
    """
    wrong = np.flatnonzero(np.diff(seconds) <= 0)
    if len(wrong):
        before, after = seconds[wrong[0] : wrong[0] + 2].tolist()
        raise ValueError(
            f"'{path}', line {lines[wrong[0] + 1]}: {quoted(name)} must increase (got {after} s "
            f"after {before} s)"
        )


def time_unit_of(name: str) -> str | None:
    r"""Returns the unit of a column of the time, which its name says; nothing for other columns.

    Examples:
        >>> time_unit_of("Time"), time_unit_of("timestamp_ns"), time_unit_of("thumb")
        ('s', 'ns', None)
    """
    match = _TIME.fullmatch(name.lower())
    return None if match is None else match[1] or "s"


def is_clock(name: str) -> bool:
    r"""Tells whether a name is that of a time whose unit it does not say, or of a number of
    frames.
    """
    name = name.lower()
    return time_unit_of(name) is None and _CLOCK.fullmatch(name) is not None


def warn_of_unit(
    path: Path, seconds: np.ndarray | None, mend: str, rate: float | None = None
) -> None:
    r"""Logs a warning if frames are as far apart as those of a time in milliseconds, or as close as
    those of a time in minutes, hours or days.

    Args:
        path (Path): The file, for the message.
        seconds (numpy.ndarray, optional): The times, taken as seconds :math:`(T,)`.
        mend (str): How to give the unit, with braces in its place.
        rate (float, optional): The frames per second that are declared, of which nothing is warned.
    """
    if seconds is None or len(seconds) < 2:
        return
    step = float(np.median(np.diff(seconds)))
    if step >= 1:
        _logger.warning(
            "'%s' has a frame every %g s: if its time is in milliseconds, %s",
            path,
            step,
            mend.format("ms"),
        )
    # The mean, since several frames of a live recording may have come at once.
    found = (len(seconds) - 1) / float(seconds[-1] - seconds[0])
    if found > _FASTEST and (rate is None or not 2 / 3 < found / rate < 3 / 2):
        low, high = _USUAL_RATES
        fitting = [unit for unit, size in _SECONDS.items() if low <= found / size <= high]
        hints = [
            f"{mend.format(unit)} for {found / _SECONDS[unit]:.4g} a second" for unit in fitting
        ]
        _logger.warning(
            "'%s' has %.4g frames a second if its time is in seconds, more than a tactile sensor "
            "gives: %s",
            path,
            found,
            "; or ".join(hints) or "check the unit of its time",
        )


def _seconds(path: Path, line: int, cell: str, unit: str) -> float:
    # Rounded once: a decimal point is moved in the text, and not in a number.
    if unit in _SECONDS:
        large = "e" in cell.lower()  # such an exponent may be any
        size = _SECONDS[unit]
        seconds = float(cell) * size if large else float(Decimal(cell) * size)
    elif "e" in cell.lower():
        seconds = float(cell) / 10 ** _PLACES[unit]
    else:
        seconds = float(f"{cell}e-{_PLACES[unit]}")
    if abs(seconds) > _LATEST:
        raise ValueError(
            f"'{path}', line {line}: 'time' must be in {unit} (got {quoted(cell)}, after the year "
            "5000): name the column time_ms, time_us or time_ns if that is its unit"
        )
    return seconds
