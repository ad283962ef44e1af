r"""Recordings as CSV files with column names of their own, as the logger of a glove writes them."""

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from torch_geometric_tactile._checks import Argument, ArgumentError, need_argument
from torch_geometric_tactile._texts import quoted, short_list
from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile.data import Recording
from torch_geometric_tactile.io._csv_frames import (
    TIME_UNITS,
    FrameColumns,
    frames_to_recording,
    is_clock,
    read_frames,
    time_unit_of,
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
from torch_geometric_tactile.io._recording_schema import checked_file

_INTEGER = re.compile(r"[+-]?[0-9]{1,18}")
_MISSING = ("na", "n/a", "<na>", "null", "none")
_LONGEST_LABEL = 1000
_SURELY_COUNTS = 10  # frames in which a reading does not rise by one each


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
) -> Recording:
    r"""Reads a recording from a CSV file with one frame per row and a header with the names of the
    columns.

    Empty cells and :obj:`nan` are missing readings.

    Args:
        path (str or PathLike): The file.
        tactile (sequence of str or str, optional): The columns of the readings, taxel by taxel in
            the order of the layout, each with its channels; or a regular expression for their
            names, in the order of the file. If left out, all columns that are nothing else. An
            order of the file that the names contradict is refused: that of texts, s0, s1, s10, s2,
            or one axis after the other, x0, x1, y0, y1, with several channels.
        num_channels (int): Number of channels of a taxel :math:`C`.
        joint (sequence of str or str): The columns of the joint angles, or a regular expression for
            their names; in degrees if a name ends in :obj:`_deg`, otherwise in radians.
        time (str, optional): The column of the time; if left out, one named :obj:`time`,
            :obj:`timestamp` or :obj:`t`, in capitals or not, if there is one; its name may end in
            a unit, as in :obj:`time_ms`.
        time_unit (str, optional): Unit of the time, :obj:`"s"`, :obj:`"ms"`, :obj:`"us"`,
            :obj:`"ns"`, :obj:`"min"`, :obj:`"h"` or :obj:`"d"` (days); if left out, that of the
            name, or seconds.
        label (str, optional): The column of the label, of integers or texts. If it is the same in
            all frames, it is the :obj:`label` of the recording, otherwise it is in
            :obj:`privileged` under its name.
        extra (sequence of str): Columns of numbers that are no readings, such as a measured force,
            for :obj:`extra`.
        ignore (sequence of str): Columns that are not read.
        unit (str, optional): Unit of the readings, :obj:`"count"` or :obj:`"newton"`, for
            :obj:`meta`.
        rate (float, optional): Frames per second, for files without time, which need it. With a
            time, nothing is warned of if this is its rate.

    The names of the columns that an expression, or nothing, chose are in
    :obj:`meta["column_names"]`, by which a data set or a predictor brings the columns of other
    files into its own order.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If a column is missing or named twice, an expression matches none, neither the
            time nor :obj:`rate` is known, a column that nobody named counts the frames, the names
            are numbers or an index that pandas made up, or contradict the order of the columns, the
            readings are no multiple of the channels, a line is empty, has another number of cells
            or no end (a file that was cut), a cell is no finite number, the time does not increase,
            or there is no frame. The message names the line.

    Examples:
        >>> import tempfile
        >>> from pathlib import Path
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     path = Path(folder) / "grasp.csv"
        ...     _ = path.write_text("time_ms,thumb,index,grip\n0,5,1,cup\n10,7,2,cup\n")
        ...     read_named_csv(path, tactile=["thumb", "index"], label="grip")
        Recording(num_frames=2, num_taxels=2, num_channels=1, rate=100, label='cup')
    """
    path = checked_file(path)
    need_argument(rate is None or rate > 0, "rate", "must be positive", rate)
    if time_unit not in (None, *TIME_UNITS):
        raise ArgumentError(
            Argument("time_unit"), f" must be one of {list(TIME_UNITS)} (got {time_unit})"
        )
    need_argument(num_channels >= 1, "num_channels", "must be at least 1", num_channels)
    lines = csv_rows(path)
    columns = _columns(
        path,
        read_header(lines),
        tactile,
        joint,
        (time, time_unit),
        label,
        (extra, ignore),
        num_channels,
    )
    names = columns.names
    if columns.time is None and rate is None:
        raise ValueError(
            f"'{path}' must have a column of the time (got {_listed(names)}): give its "
            "name as 'time', or if there is none 'rate', the frames per second"
        )
    if not columns.tactile or len(columns.tactile) % num_channels:
        raise ValueError(
            f"'{path}' must have columns of readings for taxels of {num_channels} channels (got "
            f"{len(columns.tactile)}: {_listed([names[i] for i in columns.tactile])})"
        )
    # What was given as a list is in the order of the list.
    chosen = {"tactile": (tactile, columns.tactile), "joint": (joint, columns.joint)}
    in_file_order = {
        key: [names[i] for i in places]
        for key, (given, places) in chosen.items()
        if given is None or isinstance(given, str)
    }
    for key, found in in_file_order.items():
        check_name_order(path, key, found, num_channels if key == "tactile" else 1)
    try:
        frames = read_frames(path, lines, columns)
    except ValueError as error:
        raise _with_advice(error, tactile is None) from None
    if tactile is None:
        _refuse_count(path, frames.tactile, [names[i] for i in columns.tactile])
    if time_unit is None and columns.time_unit == "s":
        warn_of_unit(path, frames.time, "give time_unit='{}'", rate)
    content: dict[str, Any] = {} if label is None else _labels(path, label, frames.labels)
    meta: dict[str, Any] = {"column_names": in_file_order} if in_file_order else {}
    content["meta"] = meta if unit is None else {**meta, "unit": unit}
    return frames_to_recording(path, frames, columns, rate or 1, **content)


def _with_advice(error: ValueError, is_guess: bool) -> ValueError:
    # Columns of readings that nobody named are often the label.
    text = str(error)
    if not is_guess or "must be a number" not in text or text.endswith("(got '')"):
        return error
    return ArgumentError(
        f"{error}; if the column is no reading, give it as ",
        *(Argument("label"), " or ", Argument("ignore")),
    )


def _columns(
    path: Path,
    names: list[str],
    tactile: Sequence[str] | str | None,
    joint: Sequence[str] | str,
    time_and_unit: tuple[str | None, str | None],
    label: str | None,
    extra_and_ignore: tuple[Sequence[str], Sequence[str]],
    num_channels: int,
) -> FrameColumns:
    extra, ignore = extra_and_ignore
    check_no_index(path, names, ignore)
    if tactile is None:
        check_no_counted_header(
            path, names, "or say which of them are readings with tactile=['0', ...]"
        )
    if all(map(is_number_cell, names)) and not is_counted_header(names):
        raise _no_name(path, 0, names[0])
    place = map_columns(path, names, dict(enumerate(names)))

    def find(name: str) -> int:
        if name not in place:
            raise ValueError(f"'{path}' must have the column '{name}' (got {_listed(names)})")
        return place[name]

    def find_all(argument: str, wanted: Sequence[str] | str) -> list[int]:
        if isinstance(wanted, str):
            pattern = _pattern(argument, wanted)
            found = [i for i, name in enumerate(names) if pattern.fullmatch(name)]
            if not found:
                raise ValueError(
                    f"'{argument}' must match whole names of columns of '{path}', {_listed(names)} "
                    f"(got {wanted!r}, which matches none)"
                )
            return found
        return [find(name) for name in wanted]

    label_column = None if label is None else find(label)
    joints = find_all("joint", joint)
    others = [find(name) for name in extra]
    used = {label_column, *joints, *others, *(find(name) for name in ignore)}
    time, unit = time_and_unit
    time_column = _time(path, names, used) if time is None else find(time)
    used.add(time_column)
    if tactile is None:
        readings = [i for i in range(len(names)) if i not in used]
        _check_readings(path, [(i, names[i]) for i in readings])
    else:
        readings = find_all("tactile", tactile)
    both = [names[i] for i in readings if i in used]
    if both:
        raise ValueError(f"column '{both[0]}' of '{path}' must be one thing only (got it for two)")
    return FrameColumns(
        names=names,
        tactile=readings,
        num_channels=num_channels,
        joint=joints,
        degrees=[i for i, column in enumerate(joints) if names[column].lower().endswith("_deg")],
        time=time_column,
        time_unit=_unit("" if time_column is None else names[time_column], unit),
        label=label_column,
        extra=others,
    )


def _pattern(argument: str, text: str) -> re.Pattern[str]:
    try:
        return re.compile(text)
    except (re.error, OverflowError, RecursionError) as error:
        raise ValueError(
            f"'{argument}' must be names of columns or a regular expression (got {text!r}: {error})"
        ) from error


def _time(path: Path, names: Sequence[str], used: set[int | None]) -> int | None:
    times = [i for i, name in enumerate(names) if time_unit_of(name) and i not in used]
    if len(times) > 1:
        raise ValueError(
            f"'{path}' must have one column of the time (got {_listed([names[i] for i in times])})"
            ": give it as 'time', and the others as 'ignore'"
        )
    return times[0] if times else None


def _unit(name: str, given: str | None) -> str:
    said = re.fullmatch(rf".*_({'|'.join(TIME_UNITS)})", name.lower())
    if said is not None and given not in (None, said[1]):
        raise ArgumentError(
            Argument("time_unit"), f" must be '{said[1]}', as column '{name}' says (got {given})"
        )
    return given or (said[1] if said is not None else "s")


def _check_readings(path: Path, columns: Sequence[tuple[int, str]]) -> None:
    for column, name in columns:
        if is_number_cell(name) or name.lower() in _MISSING:
            raise _no_name(path, column, name)
        if time_unit_of(name) or is_clock(name):
            raise ValueError(
                f"'{path}', line 1, column {column + 1} must be a reading or end in a unit of the "
                f"time, one of {list(TIME_UNITS)} (got {quoted(name)}): give it as 'time' or "
                "'ignore'"
            )


def _refuse_count(path: Path, table: np.ndarray, names: Sequence[str]) -> None:
    counts = (np.diff(table, axis=0) == 1).all(axis=0)
    if counts.any() and len(table) >= _SURELY_COUNTS:
        first = int(counts.argmax())
        raise ValueError(
            f"'{path}' must have readings in column {quoted(names[first])} (got "
            f"{table[0, first]:g}, {table[1, first]:g}, {table[2, first]:g}, ..., which counts the "
            "frames): give it as 'ignore', or the readings as 'tactile'"
        )


def _no_name(path: Path, column: int, name: str) -> ValueError:
    return ValueError(
        f"'{path}', line 1, column {column + 1} must be the name of a column (got {quoted(name)}): "
        "write the names in the first line, or give num_taxels, num_channels and num_joints of a "
        "file without names"
    )


def _labels(path: Path, name: str, cells: Sequence[str]) -> dict[str, Any]:
    labels = [cell.strip() for cell in cells]
    for line, label in enumerate(labels, 2):
        if len(label) > _LONGEST_LABEL:
            raise ValueError(
                f"'{path}', line {line} must have a label of up to {_LONGEST_LABEL} characters "
                f"(got {len(label)})"
            )
    if "" in labels:
        raise ValueError(
            f"'{path}' must have a label in every frame in '{name}' (got none in frame "
            f"{labels.index('')})"
        )
    is_integer = all(map(_INTEGER.fullmatch, labels))
    values = np.array([int(text) for text in labels]) if is_integer else np.array(labels)
    if len(set(values.tolist())) == 1:
        return {"label": values[0].item()}
    return {"privileged": {name: values}}


def _listed(names: Sequence[str]) -> str:
    return short_list(names, 6, lambda name: quoted(name)[1:-1], ending=", ...") if names else ""
