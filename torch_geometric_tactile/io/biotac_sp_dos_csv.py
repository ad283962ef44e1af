r"""The CSV files of BioTac SP DoS, directions of slip: one sequence a file."""

from itertools import islice
from pathlib import Path

import numpy as np

from torch_geometric_tactile._texts import quoted
from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile.data import Recording
from torch_geometric_tactile.io._biotac_sp import FINGERS, NUM_ELECTRODES
from torch_geometric_tactile.io._csv_header import refuse_twice
from torch_geometric_tactile.io._csv_table import csv_numbers, csv_rows

_RATE = 100.0  # frames per second
_COLUMNS = tuple(f"{finger}_e{i}" for finger in FINGERS for i in range(1, NUM_ELECTRODES + 1))
_OWN = _COLUMNS[:NUM_ELECTRODES]


def read_biotac_sp_dos_csv(path: PathLike) -> Recording:
    r"""Reads one file of `BioTac SP DoS <https://github.com/yayaneath/BioTacSP-DoS>`_: a header
    ``ff_e1,...,ff_e24``, in any order, and a line of counts for each frame. The files hold no
    times; frames are 1 / 100 s apart, which is the peak rate of the sensor.

    Files as they were first published have the columns of two more fingers, ``mf_e1`` to
    ``th_e24``, which were not recorded for the task; they are left out.

    Args:
        path (str or PathLike): The file.

    Returns:
        Recording: Of 24 taxels with one channel.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If a column is missing, unknown or named twice, a line is empty or has no end (a
            file that was cut), or a cell is missing, not a number or not finite. The message names
            file, line and column. Also if the file is no text.

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
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"'{path}' does not exist; put the file of BioTac SP DoS there")
    lines = csv_rows(path)
    header = [name.strip() for _, row in islice(lines, 1) for name in row]
    _check_header(path, header)
    places = [header.index(name) for name in _OWN]
    frames = []
    for line, row in lines:
        numbers = csv_numbers(path, line, row, header)
        missing = np.flatnonzero(np.isnan(numbers))
        if len(missing):
            column = int(missing[0])
            raise ValueError(
                f"'{path}', line {line}, column {column + 1}: '{header[column]}' must be a number "
                f"(got {quoted(row[column])})"
            )
        frames.append(numbers[places])
    if not frames:
        raise ValueError(f"'{path}' must hold at least one frame (got a header only)")
    return Recording(
        time=np.arange(len(frames)) / _RATE,
        tactile=np.array(frames)[:, :, None],
        meta={"sensor": "biotac_sp", "unit": "count", "rate": _RATE},
    )


def _check_header(path: Path, header: list[str]) -> None:
    refuse_twice(path, header)
    expected = _OWN if {*header} <= {*_OWN} else _COLUMNS
    unknown = [name for name in header if name not in _COLUMNS]
    if unknown:
        raise ValueError(
            f"'{path}' must have the columns '{_OWN[0]}' to '{_OWN[-1]}' only (got "
            f"{quoted(unknown[0])}): is it a file of another data set, or written with an index?"
        )
    missing = [name for name in expected if name not in header]
    if missing:
        raise ValueError(
            f"'{path}' must have the column '{missing[0]}' ({len(missing)} of {len(expected)} "
            "columns are missing)"
        )
