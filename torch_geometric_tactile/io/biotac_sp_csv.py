r"""The CSV files of the BioTac SP stability set: one grasp a row."""

import csv
from pathlib import Path
from typing import NamedTuple

import numpy as np

from torch_geometric_tactile.typing import PathLike

FINGERS = ("ff", "mf", "th")
NUM_ELECTRODES = 24
_READING_COLUMNS = tuple(
    f"{finger}_biotac_{i}" for finger in FINGERS for i in range(1, NUM_ELECTRODES + 1)
)
_COLUMNS = ("object", "slipped", *_READING_COLUMNS)


class GraspTable(NamedTuple):
    r"""Grasps as a file holds them.

    :obj:`reading` are counts :math:`(S, 24, 3)` (electrode, then index finger, middle finger,
    thumb), :obj:`slipped` is 1 where the object slipped :math:`(S,)`, :obj:`object_names` names
    the object of each grasp.
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
        ValueError: If a column is missing, or a cell is missing, not a number, not finite, or no
            0/1 label. The message names file, line and column. Also if the file is no text.
    """
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(
            f"'{path}' does not exist; put the file of the BioTac SP stability set there"
        )
    reading, slipped, object_names = [], [], []
    header, rows = _rows(path)
    missing = [name for name in _COLUMNS if name not in header]
    if missing:
        raise ValueError(
            f"'{path}' must have the column '{missing[0]}' ({len(missing)} of "
            f"{len(_COLUMNS)} columns are missing)"
        )
    place = [header.index(name) for name in _COLUMNS]
    for line, row in rows:
        where = f"'{path}', line {line}"
        if len(row) != len(header):
            raise ValueError(
                f"{where} must have {len(header)} cells (got {len(row)}): is the file cut?"
            )
        cells = [row[i] for i in place]
        object_names.append(cells[0].strip())
        numbers = [
            _number(cell, where, name) for cell, name in zip(cells[1:], _COLUMNS[1:], strict=True)
        ]
        if numbers[0] not in (0.0, 1.0):
            raise ValueError(f"{where}: 'slipped' must be 0 or 1 (got '{cells[1]}')")
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


def _rows(path: Path) -> tuple[list[str], list[tuple[int, list[str]]]]:
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            reader = csv.reader(file)
            header = [name.strip() for name in next(reader, [])]
            return header, [(reader.line_num, row) for row in reader if row]
    except (csv.Error, UnicodeDecodeError) as error:
        raise ValueError(f"'{path}' cannot be read as CSV: {error}") from error


def _number(cell: str, where: str, column: str) -> float:
    try:
        value = float(cell)
    except ValueError:
        raise ValueError(f"{where}: '{column}' must be a number (got '{cell}')") from None
    if not np.isfinite(value):
        raise ValueError(f"{where}: '{column}' must be finite (got '{cell}')")
    return value
