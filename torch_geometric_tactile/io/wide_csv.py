r"""Recordings as CSV files with one frame a row: time, the axes of each taxel, and joints, as the
hand data of the papers (384 taxels of 3 axes and 16 joints: 1168 columns).
"""

import logging
from collections.abc import Sequence
from itertools import chain

import numpy as np

from torch_geometric_tactile._files import atomic_path
from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile.data import Recording
from torch_geometric_tactile.io._csv_frames import read_frames, recording_of, warn_of_unit
from torch_geometric_tactile.io._csv_table import (
    csv_rows,
    has_names,
    refuse_counted,
    refuse_index,
)
from torch_geometric_tactile.io._recording_schema import checked_file
from torch_geometric_tactile.io._wide_csv_header import (
    HAND_COLUMNS,
    columns_by_name,
    columns_by_place,
    is_wide_name,
    wide_csv_header,
)

_log = logging.getLogger(__name__)


def write_wide_csv(recording: Recording, path: PathLike) -> None:
    r"""Writes a recording as a CSV file with a header and the time in the first column. The file is
    either complete or absent.

    Readings come back equal. Label, metadata, further signals and what only a simulator knows have
    no place in the file; a warning is logged when there are any.

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
        raise ValueError("'recording' must hold at least one frame to be a CSV file (got none)")
    lost = [*recording.meta, *recording.privileged, *recording.extra]
    lost += [] if recording.label is None else ["label"]
    if lost:
        _log.warning("'%s' is CSV and cannot hold %s", path, ", ".join(sorted(lost)))
    parts = [recording.tactile.reshape(recording.num_frames, -1)]
    if recording.joint is not None:
        parts.append(recording.joint)
    table = np.concatenate(parts, axis=1)
    header = wide_csv_header(recording.num_taxels, recording.num_channels, recording.num_joints)
    # Nine digits tell any two float32 apart.
    line = ",".join(["%.9g"] * table.shape[1])
    with (
        atomic_path(path) as temporary,
        temporary.open("w", newline="", encoding="ascii") as file,
    ):
        file.write(",".join(header) + "\n")
        for time, row in zip(recording.time.tolist(), table, strict=True):
            file.write(f"{time!r}," + line % tuple(row.tolist()) + "\n")


def read_wide_csv(
    path: PathLike,
    num_taxels: int | None = None,
    num_channels: int | None = None,
    num_joints: int | None = None,
    rate: float = 100.0,
    header: bool | None = None,
) -> Recording:
    r"""Reads a recording from a CSV file with one frame per row.

    The names of the first line are those of :meth:`write_wide_csv`, in any order: :obj:`time`,
    :obj:`taxel_0_x`, :obj:`taxel_0_y`, ..., :obj:`joint_0`, ... A name may end in a unit:
    :obj:`time_ms`, :obj:`time_us`, :obj:`time_ns`; :obj:`joint_0_deg`; :obj:`taxel_0_x_n`,
    :obj:`taxel_0_x_mn` (newtons and thousandths) and :obj:`taxel_0_x_count`, which is the
    :obj:`unit` in the metadata. Empty cells and :obj:`nan` are missing readings.

    A file without names is read by the place of its columns, in this order, with the time in front
    if there is one column more; its sizes are to be given, unless they are those of the hand.

    Args:
        path (str or PathLike): The file.
        num_taxels (int, optional): Number of taxels :math:`N`; 384 if no header tells.
        num_channels (int, optional): Number of channels of a taxel :math:`C`; 3 if no header tells.
        num_joints (int, optional): Number of joints :math:`J`; 16 if no header tells.
        rate (float): Frames per second, for files without time.
        header (bool, optional): Whether the first line has names; if left out, it is seen whether
            most of its cells are no numbers.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If a name is not understood, named twice or missing, a line is empty, has
            another number of cells or no end (a file that was cut), a cell is no finite number, the
            time does not increase, there is no frame, a header contradicts the arguments, or there
            is a header or an index that pandas made up. The message names the line.

    Examples:
        >>> import tempfile
        >>> from pathlib import Path
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     path = Path(folder) / "grasp.csv"
        ...     _ = path.write_text("time_ms,taxel_0_x,taxel_0_y,taxel_0_z\n0,1,2,3\n10,1,2,\n")
        ...     read_wide_csv(path).tactile.tolist()
        [[[1.0, 2.0, 3.0]], [[1.0, 2.0, nan]]]
    """
    path = checked_file(path)
    if not rate > 0:
        raise ValueError(f"'rate' must be positive (got {rate})")
    sizes = {"num_taxels": num_taxels, "num_channels": num_channels, "num_joints": num_joints}
    for name, size in sizes.items():
        if size is not None and size < (name != "num_joints"):
            raise ValueError(f"'{name}' must be at least {int(name != 'num_joints')} (got {size})")
    lines = csv_rows(path)
    line, row = next(lines)
    if header or (header is None and has_names(row)):
        names = [cell.strip() for cell in row]
        refuse_index(path, names)
        columns = columns_by_name(path, names, sizes)
        frames = read_frames(path, lines, columns)
    else:
        if header is None:
            refuse_counted(path, row, "pass header=False if this is a frame")
        columns = columns_by_place(path, len(row), sizes)
        frames = read_frames(path, chain([(line, row)], lines), columns, first_line=1)
        counted = [str(i) for i in range(len(frames.tactile))]
        if len(counted) > 1 and frames.time_cells == counted:
            raise ValueError(
                f"'{path}' must have the time in seconds in its first column (got 0, 1, 2, ..., as "
                "the index of pandas): write the file with to_csv(index=False), or name the columns"
            )
    if columns.time_unit == "s":
        warn_of_unit(path, frames.time, "name the column time_ms")
    meta = {} if columns.unit is None else {"unit": columns.unit}
    return recording_of(path, frames, columns, rate, meta=meta)


def has_own_names(row: Sequence[str]) -> bool:
    r"""Tells whether a first line is a header whose names and number are not those of a recording
    that :func:`read_wide_csv` reads without arguments, or refuses since they are meant so.
    """
    if not row or not has_names(row) or any(map(is_wide_name, row)):
        return False
    return len(row) - HAND_COLUMNS not in (0, 1)
