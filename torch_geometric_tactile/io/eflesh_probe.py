r"""Reader of the probe runs of eFlesh: folders with the readings of a magnetic skin, and the
position and force of a probe that pressed it."""

from itertools import chain
from pathlib import Path

import numpy as np

from torch_geometric_tactile._checks import need
from torch_geometric_tactile._files import existing_file
from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile.data import Recording
from torch_geometric_tactile.io._csv_table import csv_rows, csv_table
from torch_geometric_tactile.io._recording_schema import new_recording

_READINGS, _STATES = "sensor.csv", "states.csv"
_STATE_NAMES = ("time", "x", "y", "z", "force")
_NOT_MEASURED = -1.0
_MAX_COLUMNS = 1000


def read_eflesh_probe(folder: PathLike) -> Recording:
    r"""Reads a run of the probe of `eFlesh <https://github.com/notvenky/eFlesh>`_, a magnetic skin.
    The folder has two files without headers:

    * :obj:`sensor.csv`: the time and three readings of each magnetometer (in the published runs,
      five under a pressed skin and ten under a sheared skin);
    * :obj:`states.csv`: the time, three coordinates of the probe and the force.

    In each row, the times of both files must differ by less than a frame. The recording has the
    times of the readings. The files state no units: readings and force (up to 3,483 in the
    published runs) are returned as stored.

    Args:
        folder (str or PathLike): The folder of the run.

    Returns:
        Recording: With :obj:`extra["force"]` :math:`(T,)`, NaN where it was not measured (-1 in
        the file, in about half of the published rows), and :obj:`extra["probe"]` :math:`(T, 3)`.

    Raises:
        FileNotFoundError: If a file is missing.
        ValueError: If a cell is not a finite number, the number of readings is not a multiple of
            three, the files differ in their numbers of rows or their times, the time does not
            increase, or there is no frame.

    Examples:
        >>> import tempfile
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     _ = (Path(folder) / "sensor.csv").write_text("0.0,5,6,7\n0.1,5,6,9\n")
        ...     _ = (Path(folder) / "states.csv").write_text("0.01,1,2,3,-1\n0.11,1,2,3,40\n")
        ...     recording = read_eflesh_probe(folder)
        >>> recording
        Recording(num_frames=2, num_taxels=1, num_channels=3, extra=['force', 'probe'], rate=10)
        >>> recording.extra["force"].tolist()
        [nan, 40.0]
    """
    folder = Path(folder)
    advice = f"give the folder of a run, which has {_READINGS} and {_STATES}"
    paths = [existing_file(folder / name, advice) for name in (_READINGS, _STATES)]
    sensor, states = (_read_table(path) for path in paths)
    num_readings = sensor.shape[1] - 1
    if num_readings == 0 or num_readings % 3:
        raise ValueError(
            f"'{paths[0]}' must have a time and three readings of each magnetometer (got "
            f"{num_readings + 1} columns)"
        )
    if states.shape[1] != len(_STATE_NAMES):
        raise ValueError(
            f"'{paths[1]}' must have the columns {', '.join(_STATE_NAMES)} (got {states.shape[1]})"
        )
    _check_pairs(folder, sensor[:, 0], states[:, 0])
    force = states[:, 4]
    return new_recording(
        folder,
        time=sensor[:, 0],
        tactile=sensor[:, 1:].reshape(len(sensor), -1, 3),
        meta={"sensor": "eflesh", "trial": folder.absolute().name},
        extra={
            "force": np.where(force == _NOT_MEASURED, np.nan, force),
            "probe": states[:, 1:4],
        },
    )


def _read_table(path: Path) -> np.ndarray:
    lines = csv_rows(path)
    first_line = next(lines)
    num_columns = len(first_line[1])
    need(
        num_columns <= _MAX_COLUMNS,
        f"'{path}' must have at most {_MAX_COLUMNS} columns",
        num_columns,
    )
    names = [f"column {i + 1}" for i in range(num_columns)]
    table, _ = csv_table(path, chain([first_line], lines), names, required=range(num_columns))
    return table


def _check_pairs(folder: Path, sensor_time: np.ndarray, state_time: np.ndarray) -> None:
    if len(sensor_time) != len(state_time):
        raise ValueError(
            f"'{folder}' must have as many rows in {_READINGS} as in {_STATES} (got "
            f"{len(sensor_time)} and {len(state_time)}): is one of them truncated?"
        )
    differences = np.abs(sensor_time - state_time)
    # A single frame has no rate, so any difference of times is accepted.
    frame_seconds = float(np.median(np.diff(sensor_time))) if len(sensor_time) > 1 else np.inf
    largest = int(differences.argmax())
    if not differences[largest] < frame_seconds:
        raise ValueError(
            f"'{folder}' must have times in {_READINGS} and {_STATES} that differ by less than a "
            f"frame, {frame_seconds:.3g} s (got {differences[largest]:.3g} s in line {largest + 1})"
        )
