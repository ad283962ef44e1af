r"""Reader of recordings in CSV files with any column names, such as the files of a glove."""

import re
from collections.abc import Sequence
from itertools import islice
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from torch_geometric_tactile._checks import Argument, ArgumentError, need, need_argument
from torch_geometric_tactile._texts import quoted, short_list
from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile.data import Recording
from torch_geometric_tactile.io._csv_format import CsvFormat
from torch_geometric_tactile.io._csv_frames import (
    READING_UNITS,
    TIME_UNITS,
    FrameColumns,
    frames_to_recording,
    is_clock_name,
    name_to_time_unit,
    normalized_name,
    read_frames,
    read_units,
    warn_of_unit,
)
from torch_geometric_tactile.io._csv_table import (
    check_no_counted_header,
    check_no_index,
    csv_rows,
    is_counted_header,
    is_number_cell,
    map_columns,
    read_header,
)
from torch_geometric_tactile.io._name_order import check_name_order
from torch_geometric_tactile.io._recording_schema import recording_path

_NO_FORMAT = CsvFormat()
_INTEGER = re.compile(r"[+-]?[0-9]{1,18}")
_MISSING_NAMES = ("na", "n/a", "<na>", "null", "none")
_MAX_LABEL_LENGTH = 1000
_MIN_COUNTED_FRAMES = 10  # a reading hardly increases by one in each of 10 frames


def read_named_csv(
    path: PathLike,
    *,
    tactile: Sequence[str] | str | None = None,
    num_channels: int = 1,
    joint: Sequence[str] | str = (),
    time: str | None = None,
    time_unit: str | None = None,
    label: str | None = None,
    extra: Sequence[str] = (),
    ignore: Sequence[str] = (),
    unit: str | None = None,
    rate: float | None = None,
    csv_format: CsvFormat = _NO_FORMAT,
    num_frames: int | None = None,
) -> Recording:
    r"""Reads a recording from a CSV file with one frame per row and a header with the names of the
    columns.

    Empty cells and :obj:`nan` are missing readings.

    Args:
        path (str or PathLike): The file.
        tactile (sequence of str or str, optional): The columns of the readings. A list names the
            channels of the first taxel of the layout, then of the second taxel, and so on. A string
            is a regular expression for full names, in the order of the file. Defaults to all
            columns without another role. With an expression or by default, it is an error if the
            order of the file contradicts the names: columns sorted as text (s0, s1, s10, s2), or by
            axis (x0, x1, y0, y1) with several channels.
        num_channels (int): Number of channels of a taxel :math:`C`.
        joint (sequence of str or str): The columns of the joint angles, as in :obj:`tactile`.
            Angles are in degrees if the name ends in :obj:`_deg`, :obj:`(deg)`, :obj:`[deg]`,
            :obj:`/deg` or a degree sign, otherwise in radians.
        time (str, optional): The time column. Defaults to a column named :obj:`time`,
            :obj:`timestamp` or :obj:`t` (in any case), which may end in a unit, as in
            :obj:`time_ms` or :obj:`Time [ms]`. It holds numbers, ISO 8601 dates (returned as
            seconds since 1970 in UTC) or times of day (:obj:`10:00:00.25`).
        time_unit (str, optional): Unit of the time, :obj:`"s"`, :obj:`"ms"`, :obj:`"us"`,
            :obj:`"ns"`, :obj:`"min"`, :obj:`"h"` or :obj:`"d"` (days). Defaults to the unit in the
            name, else to seconds.
        label (str, optional): The column of the label, with integers or strings. If it is the same
            in all frames, it becomes the :obj:`label` of the recording. Otherwise it is stored in
            :obj:`privileged` under its name.
        extra (sequence of str): Columns of other numbers, such as a measured force, for
            :obj:`extra`.
        ignore (sequence of str): Columns that are not read.
        unit (str, optional): Unit of the readings, :obj:`"count"` or :obj:`"newton"`, for
            :obj:`meta`.
        rate (float, optional): Frames per second. Required for files without time. In files with a
            time, a matching rate suppresses the warning about the unit of the time.
        csv_format (CsvFormat): Separator, decimal sign, encoding, and missing readings.
        num_frames (int, optional): The number of frames to read from the start of the file.
            Defaults to all frames.

    The names of columns that were selected by an expression or by default are stored in
    :obj:`meta["column_names"]`. A data set or a predictor uses them to reorder the columns of other
    files.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If a column is missing or named twice, an expression matches no column, there is
            neither a time nor :obj:`rate`, a column selected by default is a frame number, the
            names are numbers or an index of pandas, or contradict the order of the columns, the
            number of readings is not a multiple of the channels, a line is empty or truncated or
            has a different number of cells, a cell is not a finite number, the time does not
            increase, or there is no frame. The message names the line.

    Examples:
        >>> import tempfile
        >>> from pathlib import Path
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     path = Path(folder) / "grasp.csv"
        ...     _ = path.write_text("time_ms,thumb,index,grip\n0,5,1,cup\n10,7,2,cup\n")
        ...     read_named_csv(path, tactile=["thumb", "index"], label="grip")
        Recording(num_frames=2, num_taxels=2, num_channels=1, rate=100, label='cup')
    """
    path = recording_path(path)
    need_argument(rate is None or rate > 0, "rate", "must be positive", rate)
    if time_unit not in (None, *TIME_UNITS):
        raise ArgumentError(
            Argument("time_unit"), f" must be one of {list(TIME_UNITS)} (got {time_unit})"
        )
    need_argument(num_channels >= 1, "num_channels", "must be at least 1", num_channels)
    roles = _Roles(tactile, num_channels, joint, time, time_unit, label, extra, ignore)
    lines = csv_rows(path, csv_format)
    header = read_header(lines)
    units = read_units(path, lines, header) if csv_format.unit_row else [""] * len(header)
    lines = islice(lines, num_frames)
    columns = _find_columns(path, header, units, roles)._replace(csv_format=csv_format)
    names = columns.names
    if columns.time is None and rate is None:
        raise ArgumentError(
            f"'{path}' must have a time column (got {_join_names(names)}): give its name ",
            *("as ", Argument("time"), ", or the frames per second as ", Argument("rate")),
            " if there is none; if lines come before the header, give their number as ",
            Argument("preamble"),
        )
    if not columns.tactile or len(columns.tactile) % num_channels:
        raise ValueError(
            f"'{path}' must have columns of readings for taxels of {num_channels} channels (got "
            f"{len(columns.tactile)}: {_join_names([names[i] for i in columns.tactile])})"
        )
    # Columns in a list keep the order of the list.
    selections = {"tactile": (tactile, columns.tactile), "joint": (joint, columns.joint)}
    in_file_order = {
        key: [names[i] for i in indices]
        for key, (selection, indices) in selections.items()
        if selection is None or isinstance(selection, str)
    }
    for key, file_names in in_file_order.items():
        check_name_order(path, key, file_names, num_channels if key == "tactile" else 1)
    first_line = csv_format.preamble + 2 + csv_format.unit_row
    try:
        frames = read_frames(path, lines, columns, first_line)
    except ValueError as error:
        raise _add_label_advice(error, tactile is None) from None
    if tactile is None:
        _check_no_frame_number(path, frames.tactile, [names[i] for i in columns.tactile])
    if time_unit is None and columns.time_unit == "s" and not frames.has_dates:
        warn_of_unit(path, frames.time, "give time_unit='{}'", rate)
    content: dict[str, Any] = (
        {} if label is None else _label_content(path, label, frames.labels, first_line)
    )
    meta: dict[str, Any] = {"column_names": in_file_order} if in_file_order else {}
    unit = unit or columns.unit
    content["meta"] = meta if unit is None else {**meta, "unit": unit}
    return frames_to_recording(path, frames, columns, rate or 1, **content)


class _Roles(NamedTuple):
    # The arguments of `read_named_csv` that give roles to columns.
    tactile: Sequence[str] | str | None
    num_channels: int
    joint: Sequence[str] | str
    time: str | None
    time_unit: str | None
    label: str | None
    extra: Sequence[str]
    ignore: Sequence[str]


def _add_label_advice(error: ValueError, is_default_selection: bool) -> ValueError:
    # A column of text that was read as a reading by default is often the label.
    is_text = isinstance(error, ArgumentError) and error.argument == Argument("missing")
    if not is_default_selection or not is_text or not isinstance(error, ArgumentError):
        return error
    return ArgumentError(
        *(*error.parts, "; if the column is not a reading, give it as "),
        *(Argument("label"), " or ", Argument("ignore")),
    )


def _find_columns(
    path: Path, names: list[str], units: Sequence[str], roles: _Roles
) -> FrameColumns:
    tactile, label = roles.tactile, roles.label
    check_no_index(path, names, roles.ignore)
    if tactile is None:
        check_no_counted_header(path, names, "or select the readings with tactile=['0', ...]")
    if all(map(is_number_cell, names)) and not is_counted_header(names):
        raise _missing_name_error(path, 0, names[0])
    column_of_name = map_columns(path, names, dict(enumerate(names)))

    def find_column(name: str) -> int:
        if name not in column_of_name:
            raise ValueError(f"'{path}' must have the column '{name}' (got {_join_names(names)})")
        return column_of_name[name]

    def find_selected(argument: str, selection: Sequence[str] | str) -> list[int]:
        if isinstance(selection, str):
            pattern = _compile_pattern(argument, selection)
            matches = [i for i, name in enumerate(names) if pattern.fullmatch(name)]
            if not matches:
                raise ValueError(
                    f"'{argument}' must match full names of columns of '{path}', "
                    f"{_join_names(names)} (got {selection!r}, which matches no name)"
                )
            return matches
        return [find_column(name) for name in selection]

    normalized = [normalized_name(name, unit) for name, unit in zip(names, units, strict=True)]
    label_column = None if label is None else find_column(label)
    joints = find_selected("joint", roles.joint)
    extra_columns = [find_column(name) for name in roles.extra]
    # An empty name at the end of a header is not a column any more.
    ignored = [find_column(name) for name in roles.ignore if name or name in column_of_name]
    used = {label_column, *joints, *extra_columns, *ignored}
    if roles.time is None:
        time_column = _find_time_column(path, names, normalized, used)
    else:
        time_column = find_column(roles.time)
    used.add(time_column)
    if tactile is None:
        readings = [i for i in range(len(names)) if i not in used]
        _check_readings(path, [(i, names[i]) for i in readings])
    else:
        readings = find_selected("tactile", tactile)
    ambiguous = [names[i] for i in readings if i in used]
    if ambiguous:
        raise ValueError(f"column '{ambiguous[0]}' of '{path}' must have a single role (got two)")
    reading_units = sorted({units[i].lower() for i in readings})
    need(len(reading_units) <= 1, f"'{path}' must have all readings in one unit", reading_units)
    unit, per_unit = READING_UNITS.get("".join(reading_units), (None, 1.0))
    time_name = "" if time_column is None else normalized[time_column]
    return FrameColumns(
        names=names,
        tactile=readings,
        num_channels=roles.num_channels,
        joint=joints,
        degrees=[i for i, column in enumerate(joints) if normalized[column].endswith("_deg")],
        time=time_column,
        time_unit=_time_unit(time_name, roles.time_unit),
        label=label_column,
        unit=unit,
        per_unit=per_unit,
        extra=extra_columns,
    )


def _compile_pattern(argument: str, text: str) -> re.Pattern[str]:
    try:
        return re.compile(text)
    except (re.error, OverflowError, RecursionError) as error:
        raise ValueError(
            f"'{argument}' must be names of columns or a regular expression (got {text!r}: {error})"
        ) from error


def _find_time_column(
    path: Path, names: Sequence[str], normalized: Sequence[str], used: set[int | None]
) -> int | None:
    times = [i for i, name in enumerate(normalized) if name_to_time_unit(name) and i not in used]
    if len(times) > 1:
        raise ValueError(
            f"'{path}' must have one time column (got "
            f"{_join_names([names[i] for i in times])}): give it as 'time', and the others as "
            "'ignore'"
        )
    return times[0] if times else None


def _time_unit(name: str, given_unit: str | None) -> str:
    match = re.fullmatch(rf".*_({'|'.join(TIME_UNITS)})", name.lower())
    if match is not None and given_unit not in (None, match[1]):
        raise ArgumentError(
            Argument("time_unit"),
            f" must be '{match[1]}', as in the name of column '{name}' (got {given_unit})",
        )
    return given_unit or (match[1] if match is not None else "s")


def _check_readings(path: Path, columns: Sequence[tuple[int, str]]) -> None:
    for column, name in columns:
        if is_number_cell(name) or name.lower() in _MISSING_NAMES:
            raise _missing_name_error(path, column, name)
        if name_to_time_unit(name) or is_clock_name(name):
            raise ValueError(
                f"'{path}', line 1, column {column + 1} must be a reading or end in a unit of the "
                f"time, one of {list(TIME_UNITS)} (got {quoted(name)}): give it as 'time' or "
                "'ignore'"
            )


def _check_no_frame_number(path: Path, table: np.ndarray, names: Sequence[str]) -> None:
    is_counting = (np.diff(table, axis=0) == 1).all(axis=0)
    if is_counting.any() and len(table) >= _MIN_COUNTED_FRAMES:
        first = int(is_counting.argmax())
        raise ValueError(
            f"'{path}' must have readings in column {quoted(names[first])} (got "
            f"{table[0, first]:g}, {table[1, first]:g}, {table[2, first]:g}, ..., which counts the "
            "frames): give it as 'ignore', or the readings as 'tactile'"
        )


def _missing_name_error(path: Path, column: int, name: str) -> ValueError:
    return ValueError(
        f"'{path}', line 1, column {column + 1} must be the name of a column (got {quoted(name)}): "
        "write the names in the first line, or give num_taxels, num_channels and num_joints of a "
        "file without names"
    )


def _label_content(path: Path, name: str, cells: Sequence[str], first_line: int) -> dict[str, Any]:
    labels = [cell.strip() for cell in cells]
    for line, label in enumerate(labels, first_line):
        if len(label) > _MAX_LABEL_LENGTH:
            raise ValueError(
                f"'{path}', line {line} must have a label of up to {_MAX_LABEL_LENGTH} characters "
                f"(got {len(label)})"
            )
    if "" in labels:
        raise ValueError(
            f"'{path}' must have a label in every frame in '{name}' (got none in frame "
            f"{labels.index('')})"
        )
    is_integer = all(map(_INTEGER.fullmatch, labels))
    # Labels are integers only if all of them are, so that '1' and '1a' stay strings.
    label_values = np.array([int(text) for text in labels]) if is_integer else np.array(labels)
    if len(set(label_values.tolist())) == 1:
        return {"label": label_values[0].item()}
    return {"privileged": {name: label_values}}


def _join_names(names: Sequence[str]) -> str:
    return short_list(names, 6, lambda name: quoted(name)[1:-1], ending=", ...") if names else ""
