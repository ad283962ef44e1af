r"""Recordings in CSV files with one frame per line: roles of the columns, and the frames."""

import itertools
import logging
import math
import re
from collections.abc import Iterator, Sequence
from decimal import Decimal
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from torch_geometric_tactile._checks import Argument, ArgumentError
from torch_geometric_tactile._texts import quoted, short_list
from torch_geometric_tactile.data import Recording
from torch_geometric_tactile.io._csv_format import CsvFormat
from torch_geometric_tactile.io._csv_table import csv_table, is_number_cell
from torch_geometric_tactile.io._folder_tables import annotations_beside
from torch_geometric_tactile.io._recording_schema import new_recording

# A column 't_h' or 't_d' may hold a quantity other than time.
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
# More frames per second than any array of taxels sends: XELA's sends 500, the vibration sensor of a
# BioTac 2,200. A unit of time is plausible if it gives a rate in the usual range.
_MAX_RATE = 3000.0
_USUAL_RATES = (10.0, 2000.0)
# A unit in brackets or after a slash at the end of a name, and other spellings of units.
_UNIT_IN_BRACKETS = re.compile(r"(.*?)[\s_]*(?:\[([^\[\]]+)\]|\(([^()]+)\)|/([^\s/]+))\s*")
_UNIT_SPELLINGS = {
    **dict.fromkeys(("sec", "secs", "second", "seconds"), "s"),
    **dict.fromkeys(("msec", "millis", "millisecond", "milliseconds"), "ms"),
    **dict.fromkeys(("µs", "μs", "usec", "microseconds"), "us"),
    **dict.fromkeys(("°", "degree", "degrees"), "deg"),
    **dict.fromkeys(("radian", "radians"), "rad"),
}
# For each unit of a column of readings: the unit in the metadata, and how many column units make
# one such unit.
READING_UNITS = {
    "n": ("newton", 1.0),
    "newton": ("newton", 1.0),
    "mn": ("newton", 1000.0),
    "count": ("count", 1.0),
    "counts": ("count", 1.0),
}
_DAY = 86400.0
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
    r"""The roles of the columns in a file.

    :obj:`tactile`, :obj:`joint` and :obj:`action` are columns in the order of the recording, and
    :obj:`extra` are columns of further signals. :obj:`degrees` are the joints whose angles are in
    degrees. Readings divided by :obj:`per_unit` are in :obj:`unit`. :obj:`csv_format` describes the
    text.
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
    csv_format: CsvFormat = CsvFormat()


class Frames(NamedTuple):
    r"""The frames of a file: readings :math:`(T, N C)`, joint angles :math:`(T, J)`, further
    signals :math:`(T, E)`, actions :math:`(T, A)`, and the time in seconds :math:`(T,)` or
    :obj:`None`. :obj:`has_dates` is whether the time was written as dates. :obj:`time_cells` and
    :obj:`labels` are the cells of time and label as text.
    """

    tactile: np.ndarray
    joint: np.ndarray
    extra: np.ndarray
    action: np.ndarray
    time: np.ndarray | None
    has_dates: bool
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
    table, cells = csv_table(
        path,
        lines,
        columns.names,
        [*itertools.chain(*groups)],
        texts=[*time_columns, *label_columns],
        csv_format=columns.csv_format,
    )
    tactile, joint, extra, action = np.split(
        table, np.cumsum([len(group) for group in groups])[:-1], axis=1
    )
    joint[:, columns.degrees] = np.deg2rad(joint[:, columns.degrees])
    time, has_dates = None, False
    time_cells = [row[0].strip() for row in cells if time_columns]
    if time_columns:
        time, has_dates = _parse_times(path, time_cells, columns, first_line)
        line_numbers = range(first_line, first_line + len(time))
        check_increasing_time(path, time, line_numbers, columns.names[time_columns[0]], True)
    return Frames(
        tactile=tactile if columns.per_unit == 1 else tactile / columns.per_unit,
        joint=joint,
        extra=extra,
        action=action,
        time=time,
        has_dates=has_dates,
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


def check_increasing_time(
    path: Path, seconds: np.ndarray, lines: Sequence[int], name: str, has_options: bool = False
) -> None:
    r"""Raises an error unless the time increases from line to line.

    Args:
        path (Path): The file, for the message.
        seconds (numpy.ndarray): The times.
        lines (sequence of int): The lines of the times.
        name (str): The name of the column.
        has_options (bool): Whether the reader has options for the time, which the message names.

    Shapes:
        - **seconds:** The times of the lines :math:`(T,)`.
    """
    backward = np.flatnonzero(np.diff(seconds) <= 0)
    if len(backward):
        before, after = seconds[backward[0] : backward[0] + 2].tolist()
        message = (
            f"'{path}', line {lines[backward[0] + 1]}: {quoted(name)} must increase (got {after} s "
            f"after {before} s)"
        )
        if after < before or not has_options:
            raise ValueError(message)
        advice = ": if the clock is too coarse, skip the column with ", " and give the "
        raise ArgumentError(
            message, advice[0], Argument("ignore"), advice[1], Argument("rate"), " of the frames"
        )


def normalized_name(name: str, unit: str | None = None) -> str:
    r"""Returns the name of a column in lower case, with its unit as a suffix, as in :obj:`time_ms`.
    The unit may be in brackets, after a slash or in a row of units.

    Examples:
        >>> normalized_name("Bend (deg)"), normalized_name("time [msec]"), normalized_name("t", "s")
        ('bend_deg', 'time_ms', 'time_s')
    """
    name = name.lower()
    match = None if unit else _UNIT_IN_BRACKETS.fullmatch(name)
    if match is not None:
        name, unit = match[1], match[2] or match[3] or match[4]
    if not unit:
        return name
    unit = unit.strip().lower()
    return f"{'time' if name == 't' else name}_{_UNIT_SPELLINGS.get(unit, unit)}"


def read_units(
    path: Path, lines: Iterator[tuple[int, list[str]]], header: Sequence[str]
) -> list[str]:
    r"""Reads the row of units after a header, and returns the unit of each column without the
    brackets that some programs write around it.
    """
    line, row = next(lines, (0, []))
    if len(row) != len(header) or any(cell.strip() and is_number_cell(cell) for cell in row):
        raise ArgumentError(
            f"'{path}', line {line} must hold the units of {len(header)} columns (got "
            f"{short_list(row, 6, quoted)}): leave out ",
            *(Argument("unit_row"), " if there is no such line"),
        )
    return [cell.strip(" []()") for cell in row]


def name_to_time_unit(name: str) -> str | None:
    r"""Returns the unit of a time column according to its name, or :obj:`None` for other columns.

    Examples:
        >>> name_to_time_unit("Time"), name_to_time_unit("timestamp_ns"), name_to_time_unit("thumb")
        ('s', 'ns', None)
    """
    match = _TIME_NAME.fullmatch(normalized_name(name))
    return None if match is None else match[1] or "s"


def is_clock_name(name: str) -> bool:
    r"""Returns whether a column name stands for a time without a unit, or for a frame number."""
    name = name.lower()
    return name_to_time_unit(name) is None and _CLOCK_NAME.fullmatch(name) is not None


def warn_of_unit(
    path: Path, seconds: np.ndarray | None, advice: str, rate: float | None = None
) -> None:
    r"""Logs a warning if the time between frames suggests that the unit of the time is not seconds
    but milliseconds, minutes, hours or days.

    Args:
        path (Path): The file, for the message.
        seconds (numpy.ndarray, optional): The times, read as seconds :math:`(T,)`.
        advice (str): Advice for the user, with braces in place of the unit.
        rate (float, optional): The declared frames per second. There is no warning if the times
            agree with it.
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


def _parse_times(
    path: Path, cells: Sequence[str], columns: FrameColumns, first_line: int
) -> tuple[np.ndarray, bool]:
    r"""Returns the seconds of the cells in a time column, and whether they hold dates or times of
    day. Times of day continue after midnight.
    """
    assert columns.time is not None
    csv_format = columns.csv_format
    has_dates = csv_format.time_format is not None or not is_number_cell(
        csv_format.number_texts(cells[:1])[0]
    )
    seconds = np.empty(len(cells))
    for i, cell in enumerate(cells):
        try:
            seconds[i] = (
                csv_format.date_seconds(cell)
                if has_dates
                else _parse_seconds(csv_format.number_texts([cell])[0], columns.time_unit)
            )
        except (ValueError, OverflowError) as error:
            raise _time_error(path, first_line + i, cell, columns, has_dates) from error
    if has_dates and all(map(csv_format.is_clock_time, cells)):
        seconds[1:] += _DAY * np.cumsum(np.diff(seconds) < -_DAY / 2)
    return seconds, has_dates


def _time_error(
    path: Path, line: int, cell: str, columns: FrameColumns, has_dates: bool
) -> ValueError:
    assert columns.time is not None
    name = quoted(columns.names[columns.time])
    where = f"'{path}', line {line}, column {columns.time + 1}: {name}"
    if has_dates:
        return ArgumentError(
            f"{where} must be a number, a date such as 2024-01-31T10:00:00.25 or a time of day "
            f"such as 10:00:00.25 (got {quoted(cell)}): give the format of other dates as ",
            Argument("time_format"),
        )
    text = columns.csv_format.number_texts([cell])[0]
    if not cell or not is_number_cell(text) or math.isnan(float(text)):
        return ValueError(f"{where} must be a number (got {quoted(cell)})")
    if math.isinf(float(text)):
        return ValueError(f"{where} must be finite (got {quoted(cell)})")
    return ValueError(
        f"{where} must be in {columns.time_unit} (got {quoted(cell)}, after the year 5000): "
        "name the column time_ms, time_us or time_ns if that is its unit"
    )


def _parse_seconds(text: str, unit: str) -> float:
    # Moves the decimal point in the text, so that the number is rounded only once.
    if not text or not is_number_cell(text):
        raise ValueError("not a number")
    if unit in _SECONDS:
        has_exponent = "e" in text.lower()  # Decimal is slow for a large exponent
        size = _SECONDS[unit]
        seconds = float(text) * size if has_exponent else float(Decimal(text) * size)
    elif "e" in text.lower():
        seconds = float(text) / 10 ** _DECIMAL_PLACES[unit]
    else:
        seconds = float(f"{text}e-{_DECIMAL_PLACES[unit]}")
    if not abs(seconds) <= _MAX_SECONDS:
        raise OverflowError("after the year 5000")
    return seconds
