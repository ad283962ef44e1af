r"""Recordings in CSV files with one frame per line: roles of the columns, and the frames."""

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

# A column 't_h' or 't_d' may hold another quantity than time.
_TIME_NAME = re.compile(r"(?:time|timestamp|t(?!_(?:min|h|d)))(?:_(s|ms|us|ns|min|h|d))?", re.ASCII)
# Times of unknown unit, and frame numbers.
_CLOCK_NAME = re.compile(
    r"(?:time|timestamp)[\W_]+\w.*|#|(?:.*[\W_])?(?:time|timestamp|datetime|stamp|epoch|elapsed|ts|"
    r"secs?|seconds|zeit)|(?:frame|sample|seq|sequence|counter|message)(?:[\W_]+(?:id|index|no|num|"
    r"number))?"
)
_DECIMAL_PLACES = {"s": 0, "ms": 3, "us": 6, "ns": 9}
_SECONDS = {"min": 60, "h": 3600, "d": 86400}
TIME_UNITS = (*_DECIMAL_PLACES, *_SECONDS)
# Frames per second that no array of taxels reaches: XELA's gives 500, the vibration of a BioTac
# 2,200. A unit of time is plausible if it gives a rate in the usual range.
_MAX_RATE = 3000.0
_USUAL_RATES = (10.0, 2000.0)
_AXES = ("x", "y", "z")
_MAX_SECONDS = 1e11  # since 1970: the year 5138
_logger = logging.getLogger(__name__)


def signal_names(
    num_taxels: int, num_channels: int, num_joints: int = 0, num_actions: int = 0
) -> Iterator[str]:
    r"""Yields the column names of readings, joints and actions. Up to three channels are named x, y
    and z.

    Examples:
        >>> [*signal_names(1, 2, 1)]
        ['taxel_0_x', 'taxel_0_y', 'joint_0']
    """
    axes = channel_names(num_channels)
    yield from (f"taxel_{taxel}_{axis}" for taxel in range(num_taxels) for axis in axes)
    yield from (f"joint_{joint}" for joint in range(num_joints))
    yield from (f"action_{i}" for i in range(num_actions))


def channel_names(num_channels: int) -> list[str]:
    r"""Returns the names of the channels of a taxel: x, y and z, or numbers for more channels."""
    if num_channels <= len(_AXES):
        return list(_AXES[:num_channels])
    return [str(channel) for channel in range(num_channels)]


class FrameColumns(NamedTuple):
    r"""The roles of the columns of a file.

    :obj:`tactile`, :obj:`joint` and :obj:`action` are columns in the order of the recording, and
    :obj:`extra` are columns of further signals. :obj:`degrees` are the joints whose angles are in
    degrees. Readings divided by :obj:`per_unit` are in :obj:`unit`.
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
    action: Sequence[int] = ()


class Frames(NamedTuple):
    r"""The frames of a file: readings :math:`(T, N C)`, joint angles :math:`(T, J)`, further
    signals :math:`(T, E)`, actions :math:`(T, A)`, the time in seconds :math:`(T,)` or :obj:`None`,
    and the cells of time and label as text.
    """

    tactile: np.ndarray
    joint: np.ndarray
    extra: np.ndarray
    action: np.ndarray
    time: np.ndarray | None
    time_cells: list[str]
    labels: list[str]


def read_frames(
    path: Path, lines: Iterator[tuple[int, list[str]]], columns: FrameColumns, first_line: int = 2
) -> Frames:
    r"""Reads the frames in the lines after the header of a file.

    Raises:
        ValueError: If a cell is not a number, or the time does not increase.
    """
    time_columns, label_columns = (
        [] if column is None else [column] for column in (columns.time, columns.label)
    )
    groups = [columns.tactile, columns.joint, columns.extra, columns.action]
    numeric = [*itertools.chain(*groups), *time_columns]
    texts = [*time_columns, *label_columns]
    table, cells = csv_table(
        path, lines, columns.names, numeric, texts=texts, required=time_columns
    )
    bounds = np.cumsum([len(group) for group in groups])
    tactile, joint, extra, action, _ = np.split(table, bounds, axis=1)
    joint[:, columns.degrees] = np.deg2rad(joint[:, columns.degrees])
    time, time_cells = None, [row[0].strip() for row in cells if time_columns]
    if time_columns:
        unit, name = columns.time_unit, columns.names[time_columns[0]]
        seconds = [
            _parse_seconds(path, line, cell, unit)
            for line, cell in enumerate(time_cells, first_line)
        ]
        time = np.array(seconds)
        check_increasing_time(path, time, [*range(first_line, first_line + len(time))], name)
    return Frames(
        tactile=tactile if columns.per_unit == 1 else tactile / columns.per_unit,
        joint=joint,
        extra=extra,
        action=action,
        time=time,
        time_cells=time_cells,
        labels=[row[-1] for row in cells if label_columns],
    )


def frames_to_recording(
    path: Path, frames: Frames, columns: FrameColumns, rate: float, **content: Any
) -> Recording:
    r"""Returns a recording with the frames of a file and the annotations from the file beside it.
    Without a time, the frames are :obj:`1 / rate` seconds apart.
    """
    num_frames = len(frames.tactile)
    return new_recording(
        path,
        time=np.arange(num_frames) / rate if frames.time is None else frames.time,
        tactile=frames.tactile.reshape(num_frames, -1, columns.num_channels),
        joint=frames.joint if columns.joint else None,
        action=frames.action if columns.action else None,
        extra={columns.names[i]: frames.extra[:, k] for k, i in enumerate(columns.extra)},
        annotations=annotations_beside(path),
        **content,
    )


def check_increasing_time(path: Path, seconds: np.ndarray, lines: Sequence[int], name: str) -> None:
    r"""Raises an error unless the time increases from line to line.

    Shapes:
        - **seconds:** The times of the lines :math:`(T,)`.
    """
    backward = np.flatnonzero(np.diff(seconds) <= 0)
    if len(backward):
        before, after = seconds[backward[0] : backward[0] + 2].tolist()
        raise ValueError(
            f"'{path}', line {lines[backward[0] + 1]}: {quoted(name)} must increase (got {after} s "
            f"after {before} s)"
        )


def name_to_time_unit(name: str) -> str | None:
    r"""Returns the unit of a time column, from its name, and :obj:`None` for other columns.

    Examples:
        >>> name_to_time_unit("Time"), name_to_time_unit("timestamp_ns"), name_to_time_unit("thumb")
        ('s', 'ns', None)
    """
    match = _TIME_NAME.fullmatch(name.lower())
    return None if match is None else match[1] or "s"


def is_clock_name(name: str) -> bool:
    r"""Returns whether a column name is that of a time without unit, or of a frame number."""
    name = name.lower()
    return name_to_time_unit(name) is None and _CLOCK_NAME.fullmatch(name) is not None


def warn_of_unit(
    path: Path, seconds: np.ndarray | None, advice: str, rate: float | None = None
) -> None:
    r"""Logs a warning if the gap between frames suggests that the time is in milliseconds, minutes,
    hours or days, not in seconds.

    Args:
        path (Path): The file, for the message.
        seconds (numpy.ndarray, optional): The times, taken as seconds :math:`(T,)`.
        advice (str): Advice for the user, with braces in place of the unit.
        rate (float, optional): The declared frames per second; no warning if the time agrees with
            it.
    """
    if seconds is None or len(seconds) < 2:
        return
    step = float(np.median(np.diff(seconds)))
    if step >= 1:
        _logger.warning(
            "'%s' has one frame every %g s: if its time is in milliseconds, %s",
            path,
            step,
            advice.format("ms"),
        )
    # The mean, since several frames of a live recording may arrive at once.
    frame_rate = (len(seconds) - 1) / float(seconds[-1] - seconds[0])
    if frame_rate > _MAX_RATE and (rate is None or not 2 / 3 < frame_rate / rate < 3 / 2):
        min_rate, max_rate = _USUAL_RATES
        plausible_units = [
            unit for unit, size in _SECONDS.items() if min_rate <= frame_rate / size <= max_rate
        ]
        hints = [
            f"{advice.format(unit)} for {frame_rate / _SECONDS[unit]:.4g} a second"
            for unit in plausible_units
        ]
        _logger.warning(
            "'%s' has %.4g frames per second if its time is in seconds, more than a tactile "
            "sensor gives: %s",
            path,
            frame_rate,
            "; or ".join(hints) or "check the unit of its time",
        )


def _parse_seconds(path: Path, line: int, cell: str, unit: str) -> float:
    # Moves the decimal point in the text, so that the number is rounded only once.
    if unit in _SECONDS:
        has_exponent = "e" in cell.lower()  # Decimal is slow for a large exponent
        size = _SECONDS[unit]
        seconds = float(cell) * size if has_exponent else float(Decimal(cell) * size)
    elif "e" in cell.lower():
        seconds = float(cell) / 10 ** _DECIMAL_PLACES[unit]
    else:
        seconds = float(f"{cell}e-{_DECIMAL_PLACES[unit]}")
    if abs(seconds) > _MAX_SECONDS:
        raise ValueError(
            f"'{path}', line {line}: 'time' must be in {unit} (got {quoted(cell)}, after the year "
            "5000): name the column time_ms, time_us or time_ns if that is its unit"
        )
    return seconds
