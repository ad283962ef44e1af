r"""Recordings as CSV files with one frame a row: taxel by taxel its axes, then the joints, as the
hand data of the papers (384 taxels of 3 axes and 16 joints: 1168 columns).
"""

import logging
import re
from collections.abc import Sequence

import numpy as np

from torch_geometric_tactile.data import Recording
from torch_geometric_tactile.files import atomic_path
from torch_geometric_tactile.io.csv_table import csv_numbers, csv_rows
from torch_geometric_tactile.io.recording_schema import checked_file
from torch_geometric_tactile.typing import PathLike

_log = logging.getLogger(__name__)

NUM_TAXELS, NUM_CHANNELS, NUM_JOINTS = 384, 3, 16
_AXES = ("x", "y", "z")
_TIMES = ("time", "timestamp", "t")
_TAXEL = re.compile(r"taxel_(\d+)_(\w+)")
_JOINT = re.compile(r"joint_(\d+)")


def wide_csv_header(num_taxels: int, num_channels: int, num_joints: int) -> list[str]:
    r"""Returns the names of the columns: :obj:`time`, :obj:`taxel_0_x`, ..., :obj:`joint_0`, ...

    Args:
        num_taxels (int): Number of taxels :math:`N`.
        num_channels (int): Number of channels of a taxel :math:`C`; up to three are axes.
        num_joints (int): Number of joints :math:`J`.

    Examples:
        >>> wide_csv_header(1, 2, 1)
        ['time', 'taxel_0_x', 'taxel_0_y', 'joint_0']
    """
    axes = _AXES[:num_channels] if num_channels <= len(_AXES) else range(num_channels)
    return [
        "time",
        *(f"taxel_{taxel}_{axis}" for taxel in range(num_taxels) for axis in axes),
        *(f"joint_{joint}" for joint in range(num_joints)),
    ]


def write_wide_csv(recording: Recording, path: PathLike) -> None:
    r"""Writes a recording as a CSV file with a header and the time in front, whole or not at all.

    Readings come back equal. Label, metadata and what only a simulator knows have no place in the
    file; a warning is logged when there are any.

    Args:
        recording (Recording): The recording.
        path (str or PathLike): The file.

    Raises:
        ValueError: If there is no frame.
    """
    if recording.num_frames == 0:
        raise ValueError("'recording' must hold at least one frame to be a CSV file (got none)")
    lost = [*recording.meta, *recording.privileged]
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
) -> Recording:
    r"""Reads a recording from a CSV file with one frame a row.

    The columns are: the time in seconds, if there is one column more than readings and joints; the
    readings, taxel by taxel; the joint angles in radians. Empty cells and :obj:`nan` are missing
    readings. A header is optional. That of :meth:`write_wide_csv` tells the sizes; without it they
    are those of the arguments.

    Args:
        path (str or PathLike): The file.
        num_taxels (int, optional): Number of taxels :math:`N`; 384 if no header tells.
        num_channels (int, optional): Number of channels of a taxel :math:`C`; 3 if no header tells.
        num_joints (int, optional): Number of joints :math:`J`; 16 if no header tells.
        rate (float): Frames per second, for files without time.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If a line has another number of cells or no end (a file that was cut), a cell
            is no finite number, the time does not increase, there is no frame, or a header
            contradicts the arguments. The message names the line.
    """
    path = checked_file(path)
    if not rate > 0:
        raise ValueError(f"'rate' must be positive (got {rate})")
    given = {"num_taxels": num_taxels, "num_channels": num_channels, "num_joints": num_joints}
    for name, size in given.items():
        if size is not None and size < (name != "num_joints"):
            raise ValueError(f"'{name}' must be at least {int(name != 'num_joints')} (got {size})")
    defaults = (NUM_TAXELS, NUM_CHANNELS, NUM_JOINTS)
    sizes = [d if s is None else s for s, d in zip(given.values(), defaults, strict=True)]
    names: list[str] = []
    rows: list[np.ndarray] = []
    for line, row in csv_rows(path):
        if not names:
            header = _is_header(row)
            found = _header_sizes(row) if header else None
            for (name, size), own in zip(given.items(), found or (), strict=False):
                if size not in (None, own):
                    raise ValueError(f"'{name}' must be {own}, as '{path}' has (got {size})")
            sizes = list(found or sizes)
            names = wide_csv_header(*sizes)
            if len(row) == len(names) - 1 and not (header and row[0].strip().lower() in _TIMES):
                names = names[1:]
            elif len(row) != len(names):
                raise ValueError(
                    f"'{path}', line {line} must have {len(names) - 1} cells for {sizes[0]} taxels "
                    f"of {sizes[1]} channels and {sizes[2]} joints, or {len(names)} with the time "
                    f"(got {len(row)})"
                )
            if header:
                continue
        numbers = csv_numbers(path, line, row, names)
        if names[0] == "time":
            if np.isnan(numbers[0]):
                raise ValueError(f"'{path}', line {line}: 'time' must be a number (got '{row[0]}')")
            if rows and numbers[0] <= rows[-1][0]:
                raise ValueError(
                    f"'{path}', line {line}: 'time' must increase (got {float(numbers[0])} s after "
                    f"{float(rows[-1][0])} s)"
                )
        rows.append(numbers)
    if not rows:
        raise ValueError(f"'{path}' must hold at least one frame (got a header only)")
    table = np.stack(rows)
    if names[0] == "time":
        time, table = table[:, 0], table[:, 1:]
    else:
        time = np.arange(len(table)) / rate
    num_readings = sizes[0] * sizes[1]
    return Recording(
        time=time,
        tactile=table[:, :num_readings].reshape(-1, *sizes[:2]),
        joint=table[:, num_readings:] if sizes[2] else None,
    )


def has_own_names(path: PathLike) -> bool:
    r"""Tells whether a CSV file has a header whose names and number are not those of a recording
    that :func:`read_wide_csv` reads without arguments.

    Args:
        path (str or PathLike): The file.
    """
    try:
        _, row = next(csv_rows(checked_file(path)), (0, []))
    except ValueError:  # is reported when the file is read
        return False
    if not row or not _is_header(row) or any(_TAXEL.fullmatch(cell.strip()) for cell in row):
        return False
    return len(row) - NUM_TAXELS * NUM_CHANNELS - NUM_JOINTS not in (0, 1)


def _is_header(row: Sequence[str]) -> bool:
    def is_name(cell: str) -> bool:
        try:
            float(cell or "nan")
        except ValueError:
            return True
        return False

    # One wrong cell does not make a line of numbers a header.
    return sum(map(is_name, row)) > len(row) / 2


def _header_sizes(row: Sequence[str]) -> tuple[int, int, int] | None:
    names = [cell.strip() for cell in row]
    taxels = [match for match in map(_TAXEL.fullmatch, names) if match]
    if not taxels:
        return None
    num_taxels = len({match[1] for match in taxels})
    num_channels = len({match[2] for match in taxels})
    num_joints = sum(_JOINT.fullmatch(name) is not None for name in names)
    header = wide_csv_header(num_taxels, num_channels, num_joints)
    return (num_taxels, num_channels, num_joints) if names in (header, header[1:]) else None
