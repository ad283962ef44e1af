r"""The runs of eFlesh's probe: a folder with the readings of a magnetic skin, and where a probe
pressed it how hard."""

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
_MOST_COLUMNS = 1000


def read_eflesh_probe(folder: PathLike) -> Recording:
    r"""Reads a run of the probe of `eFlesh <https://github.com/notvenky/eFlesh>`_, a magnetic skin:
    :obj:`sensor.csv` with the time and three readings of each magnetometer (published: five under a
    skin that is pressed, ten under one that is sheared), and :obj:`states.csv` with the time, three
    coordinates of the probe and the force, both without names of columns.

    The rows of both files belong together; their times must differ by less than a frame, and those
    of the readings are kept. Neither file names a unit: the readings are as the magnetometers gave
    them, and the force, up to 3,483 in the published runs, is in the unit of the file.

    Args:
        folder (str or PathLike): The folder of the run.

    Returns:
        Recording: With :obj:`extra["force"]` :math:`(T,)`, NaN where none was measured (-1 in the
        file, in about half of the published rows), and :obj:`extra["probe"]` :math:`(T, 3)`.

    Raises:
        FileNotFoundError: If a file is missing.
        ValueError: If a cell is no finite number, the readings are no multiple of three, the files
            differ in their rows or times, the time does not increase, or there is no frame.

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
    sensor, states = (_table(path) for path in paths)
    axes = sensor.shape[1] - 1
    if axes == 0 or axes % 3:
        raise ValueError(
            f"'{paths[0]}' must have a time and three readings of each magnetometer (got "
            f"{axes + 1} columns)"
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


def _table(path: Path) -> np.ndarray:
    lines = csv_rows(path)
    first = next(lines)
    count = len(first[1])
    need(count <= _MOST_COLUMNS, f"'{path}' must have {_MOST_COLUMNS} columns at most", count)
    names = [f"column {i + 1}" for i in range(count)]
    table, _ = csv_table(path, chain([first], lines), names, required=range(count))
    return table


def _check_pairs(folder: Path, sensor: np.ndarray, states: np.ndarray) -> None:
    if len(sensor) != len(states):
        raise ValueError(
            f"'{folder}' must have as many rows in {_READINGS} as in {_STATES} (got {len(sensor)} "
            f"and {len(states)}): is one truncated?"
        )
    apart = np.abs(sensor - states)
    frame = float(np.median(np.diff(sensor))) if len(sensor) > 1 else np.inf
    late = int(apart.argmax())
    if not apart[late] < frame:
        raise ValueError(
            f"'{folder}' must have times in {_READINGS} and {_STATES} that differ by less than a "
            f"frame, {frame:.3g} s (got {apart[late]:.3g} s in line {late + 1})"
        )
