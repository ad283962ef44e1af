r"""Reader of the uSkin pick-and-move data set, with the CSV files of one trial per folder."""

from pathlib import Path
from typing import Any

import numpy as np

from torch_geometric_tactile._checks import need
from torch_geometric_tactile._files import existing_file
from torch_geometric_tactile._texts import quoted
from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile.data import Recording
from torch_geometric_tactile.io._csv_table import csv_columns, csv_rows

_SENSOR_FILES = ("xela_sensor1.csv", "xela_sensor2.csv")
_STATE_FILE, _META_FILE = "robot_state.csv", "meta_data.csv"
_READINGS = [f"txl{taxel}_{axis}" for taxel in range(1, 17) for axis in "xyz"]
_JOINTS = [f"position_panda_joint{i}" for i in range(1, 8)]
_POSE = [f"ee_state_position_{axis}" for axis in "xyz"]
_POSE += [f"ee_state_orientation_{axis}" for axis in "xyzw"]
_FINGER_COLUMN = "position_panda_finger"
_FLAGS = ("seen", "dropped")
_META_NUMBERS = ("frequency_hz", *_FLAGS)
_MAX_LENGTH_DIFFERENCE = 5  # frames; the files of a trial may have different lengths
_MAX_RATE = 1000.0  # frames per second


def read_uskin_pick(folder: PathLike, repeats: bool = True) -> Recording:
    r"""Reads one trial of `tactile_prediction_flat_dataset
    <https://github.com/imanlab/tactile_prediction_flat_dataset>`_. A trial is a folder with the
    files :obj:`xela_sensor1.csv`, :obj:`xela_sensor2.csv`, :obj:`robot_state.csv` and
    :obj:`meta_data.csv`, with columns in any order. Other files are not read.

    The files hold no times, so frames are 1 / :obj:`frequency_hz` (from :obj:`meta_data.csv`)
    apart. Files that differ by up to five frames are cut to the length of the shortest file.

    Args:
        folder (str or PathLike): The folder.
        repeats (bool): Whether to keep frames with the same readings as the previous frame, which
            occur where the sensors were slower than the log. If :obj:`False`, these frames are
            removed, :obj:`"stale_rows"` in the metadata is their number, and the other frames keep
            their times.

    Returns:
        Recording: 32 taxels (two patches of 4 x 4) with three channels in counts, and seven joint
        angles. :obj:`extra` holds the pose of the end effector :math:`(T, 7)`, a position in
        metres and a quaternion (x, y, z, w), and the opening :obj:`finger` :math:`(T,)` as
        published. The metadata have :obj:`"object"`, :obj:`"seen"` and :obj:`"dropped"`.

    Raises:
        FileNotFoundError: If a file is missing.
        ValueError: If a column is missing or named twice, a line is empty or truncated, a cell is
            not a finite number, the files differ by more than five frames, or the metadata are not
            one line with an object, a frequency and 0 or 1 for :obj:`seen` and :obj:`dropped`. The
            message names the file.

    Examples:
        >>> read_uskin_pick("train/data_sample_2021-11-24-15-19-34")  # doctest: +SKIP
        Recording(num_frames=1064, num_taxels=32, num_channels=3, num_joints=7, extra=[...], ...)
    """
    folder = Path(folder)
    meta = _read_meta(_find_file(folder, _META_FILE))
    state_columns = [*_JOINTS, _FINGER_COLUMN, *_POSE]
    columns_of_file = {
        _SENSOR_FILES[0]: _READINGS,
        _SENSOR_FILES[1]: _READINGS,
        _STATE_FILE: state_columns,
    }
    tables = []
    for name, names in columns_of_file.items():
        path = _find_file(folder, name)
        tables.append(csv_columns(path, csv_rows(path), names)[0].astype(np.float32))
    lengths = [len(table) for table in tables]
    num_frames = min(lengths)
    if max(lengths) > num_frames + _MAX_LENGTH_DIFFERENCE:
        described_lengths = ", ".join(
            f"{n} in {name}" for name, n in zip(columns_of_file, lengths, strict=True)
        )
        raise ValueError(
            f"'{folder}' must have files whose numbers of frames differ by at most "
            f"{_MAX_LENGTH_DIFFERENCE} (got {described_lengths}): "
            "is one of them truncated?"
        )
    first_patch, second_patch, robot = (table[:num_frames] for table in tables)
    readings = np.concatenate([first_patch, second_patch], axis=1).reshape(num_frames, -1, 3)
    is_kept = np.ones(num_frames, dtype=bool)
    if not repeats:
        is_kept[1:] = (readings[1:] != readings[:-1]).any(axis=(1, 2))
        meta["stale_rows"] = int((~is_kept).sum())
    joint, finger, pose = np.split(robot[is_kept], [len(_JOINTS), len(_JOINTS) + 1], axis=1)
    return Recording(
        time=np.flatnonzero(is_kept) / meta["rate"],
        tactile=readings[is_kept],
        joint=joint,
        meta=meta,
        extra={"finger": finger[:, 0], "end_effector": pose},
    )


def _find_file(folder: Path, name: str) -> Path:
    return existing_file(
        folder / name, "put all files of this trial from tactile_prediction_flat_dataset there"
    )


def _read_meta(path: Path) -> dict[str, Any]:
    numbers, cells = csv_columns(
        path, csv_rows(path), _META_NUMBERS, ["object_name"], row_noun="trial"
    )
    need(len(numbers) == 1, f"'{path}' must have one line below its header", len(numbers))
    rate, *flags = numbers[0].tolist()
    need(0 < rate <= _MAX_RATE, f"'{path}': 'frequency_hz' must be up to {_MAX_RATE:g}", rate)
    for name, flag in zip(_FLAGS, flags, strict=True):
        need(flag in (0, 1), f"'{path}': '{name}' must be 0 or 1", flag)
    object_name = cells[0][0].strip()
    need(object_name, f"'{path}' must name an object in 'object_name'", quoted(cells[0][0]))
    flag_values = {name: int(flag) for name, flag in zip(_FLAGS, flags, strict=True)}
    return {
        "sensor": "XELA uSkin",
        "unit": "count",
        "rate": rate,
        "object": object_name,
        **flag_values,
    }
