r"""Reader of CSV files that each hold one slide of a BioTac over a material."""

import numpy as np

from torch_geometric_tactile._files import existing_file
from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile.data import Recording
from torch_geometric_tactile.io._csv_frames import check_increasing_time
from torch_geometric_tactile.io._csv_table import csv_columns, csv_rows

_NUM_ELECTRODES, _NUM_PRESSURES = 19, 22
_SIGNALS = ("tdc", "tac", "pdc")
_PRESSURES = [f"pac{i}" for i in range(1, _NUM_PRESSURES + 1)]
_ELECTRODES = [f"ele{i}" for i in range(1, _NUM_ELECTRODES + 1)]


def read_biotac_slide_csv(path: PathLike) -> Recording:
    r"""Reads one file ``mat<material>_<trial>_bio.csv`` of `BioTac_slide_20_50
    <https://github.com/dexrob/BioTac_slide_20_50>`_.

    The header has the columns ``timestamp,tdc,tac,pdc,pac1,...,pac22,ele1,...,ele19``, in any
    order. Each line is a frame and may end with one comma more than the header.

    Args:
        path (str or PathLike): The file.

    Returns:
        Recording: The 19 electrodes in counts, with times in seconds since 1970. :obj:`extra` holds
        the static temperature :obj:`tdc`, its change :obj:`tac` and the static pressure :obj:`pdc`,
        each :math:`(T,)`, and the vibration :obj:`pac` :math:`(T, 22)` with 22 samples per frame.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If a column is missing or named twice, a line is empty or truncated, a cell is
            not a finite number, or the time does not increase. The message names file and line.

    Examples:
        >>> import tempfile
        >>> from pathlib import Path
        >>> names = [f"pac{i}" for i in range(1, 23)] + [f"ele{i}" for i in range(1, 20)]
        >>> head = ",".join(["timestamp", "tdc", "tac", "pdc", *names])
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     path = Path(folder) / "mat1_1_bio.csv"
        ...     _ = path.write_text(f"{head}\n0.69,{'7,' * 44}\n0.70,{'8,' * 44}\n")
        ...     recording = read_biotac_slide_csv(path)
        >>> recording.tactile.shape, recording.extra["pac"].shape
        ((2, 19, 1), (2, 22))
    """
    path = existing_file(path, "put the file from BioTac_slide_20_50 there")
    table, _ = csv_columns(
        path, csv_rows(path), ["timestamp", *_SIGNALS, *_PRESSURES, *_ELECTRODES]
    )
    check_increasing_time(path, table[:, 0], range(2, len(table) + 2), "timestamp")
    signals = table[:, 1:].astype(np.float32)
    pac, electrodes = np.split(signals[:, len(_SIGNALS) :], [_NUM_PRESSURES], axis=1)
    return Recording(
        time=table[:, 0],
        tactile=electrodes[:, :, None],
        meta={"sensor": "biotac", "unit": "count"},
        extra={"pac": pac, **{name: signals[:, i] for i, name in enumerate(_SIGNALS)}},
    )
