r"""Readers of two sets of CSV files: the BioTac SP stability set with one grasp per row, and BioTac
SP DoS (directions of slip) with one sequence per file.
"""

from typing import NamedTuple

import numpy as np

from torch_geometric_tactile._files import existing_file
from torch_geometric_tactile._texts import quoted
from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile.data import Recording
from torch_geometric_tactile.io._csv_table import (
    check_columns_exist,
    csv_columns,
    csv_rows,
    csv_table,
    map_columns,
    read_header,
)

_FINGERS = ("ff", "mf", "th")
_NUM_ELECTRODES = 24
_ELECTRODES = [(finger, i) for finger in _FINGERS for i in range(1, _NUM_ELECTRODES + 1)]
_GRASP_COLUMNS = ["object", "slipped", *(f"{finger}_biotac_{i}" for finger, i in _ELECTRODES)]
_ALL_SLIP_COLUMNS = [f"{finger}_e{i}" for finger, i in _ELECTRODES]
_SLIP_COLUMNS = _ALL_SLIP_COLUMNS[:_NUM_ELECTRODES]
_SLIP_FRAME_RATE = 100.0  # frames per second


class GraspTable(NamedTuple):
    r"""The grasps of one file of the BioTac SP stability set.

    :obj:`reading` holds counts :math:`(S, 24, 3)` (electrode, then index finger, middle finger,
    thumb), :obj:`slipped` is 1 if the object slipped :math:`(S,)`, and :obj:`object_names` holds
    the object of each grasp.

    Examples:
        >>> table = GraspTable(np.zeros((2, 24, 3)), np.array([0, 1]), ["cup", "can"])
        >>> table.object_names[1], table.reading[1].shape
        ('can', (24, 3))
    """

    reading: np.ndarray
    slipped: np.ndarray
    object_names: list[str]


def read_biotac_sp_csv(path: PathLike) -> GraspTable:
    r"""Reads one file of the `BioTac SP stability set
    <https://github.com/3dperceptionlab/biotacsp-stability-set-v2>`_.

    Args:
        path (str or PathLike): The file. Its columns may be in any order.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If the file is not text, a column is missing or named twice, a line is empty or
            truncated, or a cell is missing, not a finite number, or not a 0/1 label. The message
            names file, line and column.

    Examples:
        >>> import tempfile
        >>> from pathlib import Path
        >>> names = [f"{finger}_biotac_{i}" for finger in ("ff", "mf", "th") for i in range(1, 25)]
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     path = Path(folder) / "grasps.csv"
        ...     _ = path.write_text(f"object,slipped,{','.join(names)}\ncup,1{',1000' * 72}\n")
        ...     table = read_biotac_sp_csv(path)
        >>> table.reading.shape, table.slipped.tolist(), table.object_names
        ((1, 24, 3), [1], ['cup'])
    """
    path = existing_file(path, "put the file from the BioTac SP stability set there")
    text_columns, numeric_columns = _GRASP_COLUMNS[:2], _GRASP_COLUMNS[1:]
    numbers, cells = csv_columns(
        path, csv_rows(path), numeric_columns, text_columns, row_noun="grasp"
    )
    invalid_rows = np.flatnonzero(~np.isin(numbers[:, 0], (0.0, 1.0)))
    if len(invalid_rows):
        raise ValueError(
            f"'{path}', line {invalid_rows[0] + 2}: 'slipped' must be 0 or 1 (got "
            f"{quoted(cells[invalid_rows[0]][1])})"
        )
    # The columns are sorted by finger; readings have the fingers last.
    by_finger = numbers[:, 1:].astype(np.float32).reshape(-1, len(_FINGERS), _NUM_ELECTRODES)
    return GraspTable(
        reading=np.ascontiguousarray(by_finger.transpose(0, 2, 1)),
        slipped=numbers[:, 0].astype(np.int64),
        object_names=[row[0].strip() for row in cells],
    )


def read_biotac_sp_dos_csv(path: PathLike) -> Recording:
    r"""Reads one file of `BioTac SP DoS <https://github.com/yayaneath/BioTacSP-DoS>`_.

    The header has the columns ``ff_e1,...,ff_e24``, in any order. Each line holds the counts of a
    frame. The files hold no times, so frames are taken to be 1 / 100 s apart, the peak rate of the
    sensor.

    The first published version of the files also has columns of two more fingers, ``mf_e1`` to
    ``th_e24``, which were not recorded for the task. They are ignored.

    Args:
        path (str or PathLike): The file.

    Returns:
        Recording: The readings of 24 taxels with one channel, in counts.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If the file is not text, a column is missing, unknown or named twice, a line is
            empty or truncated, or a cell is missing or not a finite number. The message names file,
            line and column.

    Examples:
        >>> import tempfile
        >>> from pathlib import Path
        >>> head = ",".join(f"ff_e{i}" for i in range(1, 25))
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     path = Path(folder) / "task.csv"
        ...     _ = path.write_text(f"{head}\n" + 2 * f"3000{',3001' * 23}\n")
        ...     read_biotac_sp_dos_csv(path)
        Recording(num_frames=2, num_taxels=24, num_channels=1, rate=100)
    """
    path = existing_file(path, "put the file from BioTac SP DoS there")
    lines = csv_rows(path)
    header = read_header(lines)
    column_of_name = map_columns(path, header, dict(enumerate(header)))
    unknown = [name for name in header if name not in _ALL_SLIP_COLUMNS]
    if unknown:
        raise ValueError(
            f"'{path}' must have the columns '{_SLIP_COLUMNS[0]}' to '{_SLIP_COLUMNS[-1]}' only "
            f"(got {quoted(unknown[0])}): is it a file of another data set, or written with an "
            "index?"
        )
    check_columns_exist(
        path, column_of_name, _SLIP_COLUMNS if {*header} <= {*_SLIP_COLUMNS} else _ALL_SLIP_COLUMNS
    )
    table, _ = csv_table(path, lines, header, required=range(len(header)))
    return Recording(
        time=np.arange(len(table)) / _SLIP_FRAME_RATE,
        tactile=table[:, [column_of_name[name] for name in _SLIP_COLUMNS], None],
        meta={"sensor": "biotac_sp", "unit": "count", "rate": _SLIP_FRAME_RATE},
    )
