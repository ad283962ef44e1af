r"""The CSV files of the BioTac SP stability set: one grasp a row."""

from itertools import islice
from pathlib import Path
from typing import NamedTuple

import numpy as np

from torch_geometric_tactile._texts import quoted
from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile.io._biotac_sp import FINGERS, NUM_ELECTRODES
from torch_geometric_tactile.io._csv_header import refuse_twice
from torch_geometric_tactile.io._csv_table import check_width, csv_rows, is_number

_READING_COLUMNS = tuple(
    f"{finger}_biotac_{i}" for finger in FINGERS for i in range(1, NUM_ELECTRODES + 1)
)
_HIGHEST = float(np.finfo(np.float32).max)
_COLUMNS = ("object", "slipped", *_READING_COLUMNS)


class GraspTable(NamedTuple):
    r"""The grasps of one file of the BioTac SP stability set.

    :obj:`reading` are counts :math:`(S, 24, 3)` (electrode, then index finger, middle finger,
    thumb), :obj:`slipped` is 1 where the object slipped :math:`(S,)`, :obj:`object_names` names
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
        path (str or PathLike): The file; its columns may be in any order.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If a column is missing or named twice, a line is empty or has no end (a file
            that was cut), or a cell is missing, not a number, not finite, or no 0/1 label. The
            message names file, line and column. Also if the file is no text.

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
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(
            f"'{path}' does not exist; put the file of the BioTac SP stability set there"
        )
    reading, slipped, object_names = [], [], []
    lines = csv_rows(path)
    header = [name.strip() for _, row in islice(lines, 1) for name in row]
    missing = [name for name in _COLUMNS if name not in header]
    if missing:
        raise ValueError(
            f"'{path}' must have the column '{missing[0]}' ({len(missing)} of "
            f"{len(_COLUMNS)} columns are missing)"
        )
    refuse_twice(path, header)
    place = [header.index(name) for name in _COLUMNS]
    for line, row in lines:
        where = f"'{path}', line {line}"
        check_width(path, line, row, len(header))
        cells = [row[i] for i in place]
        object_names.append(cells[0].strip())
        numbers = [
            _number(cell, where, name) for cell, name in zip(cells[1:], _COLUMNS[1:], strict=True)
        ]
        if numbers[0] not in (0.0, 1.0):
            raise ValueError(f"{where}: 'slipped' must be 0 or 1 (got {quoted(cells[1])})")
        slipped.append(int(numbers[0]))
        reading.append(numbers[1:])
    if not reading:
        raise ValueError(f"'{path}' must hold at least one grasp (got a header only)")
    by_finger = np.asarray(reading, dtype=np.float32).reshape(-1, len(FINGERS), NUM_ELECTRODES)
    return GraspTable(
        reading=np.ascontiguousarray(by_finger.transpose(0, 2, 1)),
        slipped=np.asarray(slipped, dtype=np.int64),
        object_names=object_names,
    )


def _number(cell: str, where: str, column: str) -> float:
    if not cell.strip() or not is_number(cell):
        raise ValueError(f"{where}: '{column}' must be a number (got {quoted(cell)})")
    value = float(cell)
    if not abs(value) <= _HIGHEST:
        raise ValueError(f"{where}: '{column}' must be finite (got {quoted(cell)})")
    return value
