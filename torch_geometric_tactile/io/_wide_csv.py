r"""Recordings as CSV files with one frame per row: time, the axes of each taxel, and joints. The
papers' hand data have this format (384 taxels with 3 axes and 16 joints: 1168 columns).
"""

import logging
import re
from collections.abc import Mapping, Sequence
from itertools import chain, islice
from pathlib import Path

import numpy as np

from torch_geometric_tactile._checks import need_argument
from torch_geometric_tactile._files import atomic_path
from torch_geometric_tactile._texts import quoted
from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile.data import Recording
from torch_geometric_tactile.io._csv_format import CsvFormat
from torch_geometric_tactile.io._csv_frames import (
    READING_UNITS,
    FrameColumns,
    channel_names,
    frames_to_recording,
    name_to_time_unit,
    normalized_name,
    read_frames,
    read_units,
    signal_names,
    warn_of_unit,
)
from torch_geometric_tactile.io._csv_table import (
    check_no_counted_header,
    check_no_index,
    csv_rows,
    is_header,
    map_columns,
)
from torch_geometric_tactile.io._folder_tables import write_annotations
from torch_geometric_tactile.io._recording_schema import recording_path

_log = logging.getLogger(__name__)
_NO_FORMAT = CsvFormat()
_HAND_SIZES = {"num_taxels": 384, "num_channels": 3, "num_joints": 16}
_HAND_COLUMNS = 384 * 3 + 16
_TAXEL_NAME = re.compile(r"taxel_([0-9]{1,9})_([xyz]|[0-9]{1,9})(?:_([a-z]+))?")
_JOINT_NAME = re.compile(r"joint_([0-9]{1,9})(?:_(rad|deg))?")
_ACTION_NAME = re.compile(r"action_([0-9]{1,9})")


def write_wide_csv(recording: Recording, path: PathLike) -> None:
    r"""Writes a recording as a CSV file with a header and the time in the first column. The file is
    either complete or absent.

    The readings in the file are exact. Annotations are written to the ``annotations.csv`` beside
    the file. Label, metadata, further signals and privileged signals are not stored, and a warning
    lists them.

    Args:
        recording (Recording): The recording.
        path (str or PathLike): The file.

    Raises:
        ValueError: If there is no frame.

    Examples:
        >>> import tempfile
        >>> from pathlib import Path
        >>> recording = Recording(time=[0.0, 0.01], tactile=np.ones((2, 1, 3)))
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     write_wide_csv(recording, f"{folder}/grasp.csv")
        ...     print((Path(folder) / "grasp.csv").read_text().rstrip())
        time,taxel_0_x,taxel_0_y,taxel_0_z
        0.0,1,1,1
        0.01,1,1,1
    """
    if recording.num_frames == 0:
        raise ValueError("'recording' must hold at least one frame to be written as CSV (got none)")
    unsupported = [*recording.meta, *recording.privileged, *recording.extra]
    unsupported += [] if recording.label is None else ["label"]
    if unsupported:
        _log.warning("'%s' is CSV and cannot store %s", path, ", ".join(sorted(unsupported)))
    signals = [recording.tactile.reshape(recording.num_frames, -1)]
    if recording.joint is not None:
        signals.append(recording.joint)
    if recording.action is not None:
        signals.append(recording.action)
    table = np.concatenate(signals, axis=1)
    names = signal_names(
        recording.num_taxels, recording.num_channels, recording.num_joints, recording.num_actions
    )
    # Nine digits distinguish any two float32 numbers.
    row_format = ",".join(["%.9g"] * table.shape[1])
    with (
        atomic_path(path) as temporary,
        temporary.open("w", newline="", encoding="ascii") as file,
    ):
        file.write(",".join(["time", *names]) + "\n")
        # The repr of a float is the shortest text that reads back as the same number.
        for time, row in zip(recording.time.tolist(), table, strict=True):
            file.write(f"{time!r}," + row_format % tuple(row.tolist()) + "\n")
        write_annotations(Path(path), recording.annotations)


def read_wide_csv(
    path: PathLike,
    num_taxels: int | None = None,
    num_channels: int | None = None,
    num_joints: int | None = None,
    rate: float = 100.0,
    header: bool | None = None,
    csv_format: CsvFormat = _NO_FORMAT,
    num_frames: int | None = None,
) -> Recording:
    r"""Reads a recording from a CSV file with one frame per row.

    The names in the first line are as in :meth:`write_wide_csv`, in any order: :obj:`time`,
    :obj:`taxel_0_x`, :obj:`taxel_0_y`, ..., :obj:`joint_0`, ..., :obj:`action_0`, ... The name of a
    time, a joint or a reading may end in a unit:
    :obj:`time_ms`, :obj:`time_us`, :obj:`time_ns`, :obj:`time_min`, :obj:`time_h`, :obj:`time_d`,
    :obj:`joint_0_deg`, :obj:`taxel_0_x_n` (newtons), :obj:`taxel_0_x_mn` (millinewtons) and
    :obj:`taxel_0_x_count`. The unit of the readings becomes the :obj:`unit` in the metadata. Empty
    cells and :obj:`nan` are missing readings.

    A file without names must have its columns in this order, with the time first if there is one
    more column. The sizes default to the papers' hand data and must be set for other files.

    Args:
        path (str or PathLike): The file.
        num_taxels (int, optional): Number of taxels :math:`N`. Defaults to 384 without a header.
        num_channels (int, optional): Number of channels of a taxel :math:`C`. Defaults to 3 without
            a header.
        num_joints (int, optional): Number of joints :math:`J`. Defaults to 16 without a header.
        rate (float): Frames per second, for files without time.
        header (bool, optional): Whether the first line has names. By default, it has names if most
            of its cells are not numbers.
        csv_format (CsvFormat): Separator, decimal sign, encoding, and missing readings.
        num_frames (int, optional): The number of frames to read from the start of the file.
            Defaults to all frames.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If a name is unknown, missing or repeated, a line is empty or truncated or has a
            different number of cells, a cell is not a finite number, the time does not increase,
            there is no frame, the header contradicts the arguments, or pandas added a numbered
            header or an index. The message names the line.

    Examples:
        >>> import tempfile
        >>> from pathlib import Path
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     path = Path(folder) / "grasp.csv"
        ...     _ = path.write_text("time_ms,taxel_0_x,taxel_0_y,taxel_0_z\n0,1,2,3\n10,1,2,\n")
        ...     read_wide_csv(path).tactile.tolist()
        [[[1.0, 2.0, 3.0]], [[1.0, 2.0, nan]]]
    """
    path = recording_path(path)
    need_argument(rate > 0, "rate", "must be positive", rate)
    sizes = {"num_taxels": num_taxels, "num_channels": num_channels, "num_joints": num_joints}
    for name, size in sizes.items():
        if size is not None and size < (name != "num_joints"):
            raise ValueError(f"'{name}' must be at least {int(name != 'num_joints')} (got {size})")
    lines = csv_rows(path, csv_format)
    line, row = next(lines)
    if header or (header is None and is_header(row)):
        names = [cell.strip() for cell in row]
        check_no_index(path, names)
        units = read_units(path, lines, names) if csv_format.unit_row else [""] * len(names)
        lower_names = [normalized_name(*pair) for pair in zip(names, units, strict=True)]
        columns = _columns_by_name(path, names, lower_names, sizes)._replace(csv_format=csv_format)
        first_line = line + 1 + csv_format.unit_row
        frames = read_frames(path, islice(lines, num_frames), columns, first_line)
    else:
        if header is None:
            check_no_counted_header(path, row, "pass header=False if this is a frame")
        columns = _columns_by_position(path, len(row), sizes)._replace(csv_format=csv_format)
        lines = islice(chain([(line, row)], lines), num_frames)
        frames = read_frames(path, lines, columns, line)
        frame_numbers = [str(i) for i in range(len(frames.tactile))]
        if len(frame_numbers) > 1 and frames.time_cells == frame_numbers:
            raise ValueError(
                f"'{path}' must have the time in seconds in its first column (got 0, 1, 2, ..., "
                "like an index of pandas): write the file with to_csv(index=False), or name the "
                "columns"
            )
    if columns.time_unit == "s" and not frames.has_dates:
        warn_of_unit(path, frames.time, "name the column time_{}")
    meta = {} if columns.unit is None else {"unit": columns.unit}
    return frames_to_recording(path, frames, columns, rate, meta=meta)


def _columns_by_position(
    path: Path, num_cells: int, sizes: Mapping[str, int | None]
) -> FrameColumns:
    r"""Returns the columns of a file without names, in the order of :func:`write_wide_csv`."""
    taxels, channels, joints = (
        _HAND_SIZES[name] if size is None else size for name, size in sizes.items()
    )
    num_readings = taxels * channels
    num_time_columns = num_cells - num_readings - joints
    if num_time_columns not in (0, 1):
        raise ValueError(
            f"'{path}', line 1 must have {num_readings + joints} cells for {taxels} taxels of "
            f"{channels} channels and {joints} joints, or {num_readings + joints + 1} with the "
            f"time (got {num_cells}): name the columns as write_wide_csv does, or give num_taxels, "
            "num_channels and num_joints (tactile convert: --num-taxels, --num-channels, "
            "--num-joints)"
        )
    return FrameColumns(
        names=["time"] * num_time_columns + [*signal_names(taxels, channels, joints)],
        tactile=[*range(num_time_columns, num_time_columns + num_readings)],
        num_channels=channels,
        joint=[*range(num_time_columns + num_readings, num_cells)],
        degrees=[],
        time=0 if num_time_columns else None,
        time_unit="s",
    )


def _columns_by_name(
    path: Path, names: list[str], lower_names: Sequence[str], sizes: Mapping[str, int | None]
) -> FrameColumns:
    r"""Returns the columns of a header, which may be in any order. :obj:`lower_names` are the names
    in lower case with their units. The sizes in the header must match the :obj:`sizes` that are
    not :obj:`None`.
    """
    times = [i for i, key in enumerate(lower_names) if name_to_time_unit(key)]
    taxels = {
        i: match for i, key in enumerate(lower_names) if (match := _TAXEL_NAME.fullmatch(key))
    }
    joints = {
        i: match for i, key in enumerate(lower_names) if (match := _JOINT_NAME.fullmatch(key))
    }
    actions = {
        i: match for i, key in enumerate(lower_names) if (match := _ACTION_NAME.fullmatch(key))
    }
    matched = {*times, *taxels, *joints, *actions}
    unknown = [name for i, name in enumerate(names) if i not in matched]
    units = {match[3] for match in taxels.values()}
    if unknown or not taxels or not units <= {None, *READING_UNITS}:
        invalid = next(
            (names[i] for i, m in taxels.items() if m[3] not in (None, *READING_UNITS)), names[0]
        )
        raise _column_name_error(path, unknown[0] if unknown else invalid)
    if len(units) > 1:
        raise ValueError(
            f"'{path}', line 1 must have all readings in one unit (got "
            f"{sorted(str(unit) for unit in units)})"
        )
    if len(times) > 1:
        raise ValueError(
            f"'{path}', line 1 must have one time column (got {', '.join(names[i] for i in times)})"
        )
    keys = {i: f"taxel_{int(m[1])}_{m[2]}" for i, m in taxels.items()}
    keys |= {i: f"joint_{int(m[1])}" for i, m in joints.items()}
    keys |= {i: f"action_{int(m[1])}" for i, m in actions.items()}
    column_of_name = map_columns(path, names, keys)
    axes_in_header = {match[2] for match in taxels.values()}
    axes = channel_names(len(axes_in_header))
    if axes_in_header != set(axes):
        raise ValueError(
            f"'{path}', line 1 must have the axes {', '.join(axes)} for taxels of {len(axes)} "
            f"channels (got {', '.join(sorted(axes_in_header)[:6])})"
        )
    header_sizes = (len({int(match[1]) for match in taxels.values()}), len(axes), len(joints))
    all_sizes = (*header_sizes, len(actions))
    # A generator: with wrong numbers in the header, a list would take too much memory.
    missing = next((name for name in signal_names(*all_sizes) if name not in column_of_name), None)
    if missing is not None:
        raise ValueError(
            f"'{path}', line 1 must have the column '{missing}': taxels, joints and actions count "
            "from 0, without gaps, and each taxel has all axes"
        )
    for (name, size), header_size in zip(sizes.items(), header_sizes, strict=True):
        if size not in (None, header_size):
            raise ValueError(f"'{name}' must be {header_size}, as in '{path}' (got {size})")
    columns = [column_of_name[name] for name in signal_names(*all_sizes)]
    joint = columns[len(taxels) : len(taxels) + len(joints)]
    unit, per_unit = READING_UNITS.get(units.pop(), (None, 1.0))
    return FrameColumns(
        names=names,
        tactile=columns[: len(taxels)],
        num_channels=len(axes),
        joint=joint,
        degrees=[i for i, column in enumerate(joint) if joints[column][2] == "deg"],
        time=times[0] if times else None,
        time_unit=(name_to_time_unit(lower_names[times[0]]) if times else None) or "s",
        unit=unit,
        per_unit=per_unit,
        action=columns[len(taxels) + len(joints) :],
    )


def _column_name_error(path: Path, name: str) -> ValueError:
    return ValueError(
        f"'{path}', line 1 must name the columns 'time', 'taxel_0_x', 'taxel_0_y', 'taxel_0_z', "
        "'taxel_1_x', ..., 'joint_0', ..., 'action_0', ... in any order, with units 'time_ms', "
        "'time_us', 'time_ns', 'joint_0_deg', 'taxel_0_x_n', 'taxel_0_x_mn' or 'taxel_0_x_count' "
        f"if they are not s, rad and raw readings (got {quoted(name)}): rename the columns, or "
        "name their roles with read_named_csv(path, tactile=..., num_channels=..., joint=..., "
        "time=...) or the same options of tactile convert"
    )


def is_named_csv_header(row: Sequence[str]) -> bool:
    r"""Returns whether a line is a header for :func:`read_named_csv`: it has no taxel
    names as in :func:`write_wide_csv`, and its number of columns differs from the hand data.
    """
    if (
        not row
        or not is_header(row)
        or any(re.match(r"taxel_[0-9]", name.strip().lower()) for name in row)
    ):
        return False
    return len(row) - _HAND_COLUMNS not in (0, 1)
