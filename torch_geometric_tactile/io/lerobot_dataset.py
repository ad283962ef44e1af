r"""Data sets of `LeRobot <https://huggingface.co/docs/lerobot/lerobot-dataset-v3>`_, version 3.0,
with pyarrow alone.

====================================== =============================================================
``meta/info.json``                     version, sizes, rate, features
``meta/stats.json``                    statistics of the features over all episodes
``meta/tasks.parquet``                 names of the tasks, and their numbers
``meta/episodes/chunk-.../file-...``   length, task, place and statistics of each episode
``data/chunk-.../file-....parquet``    the frames of many episodes
``meta/tactile.json``                  ours: metadata and labels of the recordings
====================================== =============================================================

:obj:`observation.tactile` is float32 :math:`(N, C)` with NaN where a reading is missing, and
:obj:`observation.state` the joint angles in radians.
"""

import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from torch_geometric_tactile.data import Recording
from torch_geometric_tactile.files import atomic_path
from torch_geometric_tactile.io.lerobot_stats import (
    Stats,
    feature_stats,
    joined_stats,
    resampled,
    stats_json,
)
from torch_geometric_tactile.typing import PathLike

CODEBASE_VERSION = "v3.0"
TACTILE, STATE = "observation.tactile", "observation.state"
OWN = "meta/tactile.json"
_PATH = "chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
_DATA_MB, _VIDEO_MB, _FILES_PER_CHUNK = 100, 200, 1000
_INDICES = ("frame_index", "episode_index", "index", "task_index")
_INDEX_COLUMN = "__index_level_0__"


def require_pyarrow() -> Any:
    r"""Returns pyarrow, with its part for Parquet.

    Raises:
        ImportError: If it is missing.
    """
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError as error:
        raise ImportError(
            "LeRobot data sets need pyarrow: pip install 'torch-geometric-tactile[lerobot]'"
        ) from error
    return pyarrow


def write_lerobot(
    recordings: Sequence[Recording],
    root: PathLike,
    fps: int,
    *,
    robot_type: str | None = None,
    task: str | None = None,
    nearest: bool = False,
) -> None:
    r"""Writes recordings as the episodes of a LeRobot data set.

    Each one is sampled anew at :obj:`fps`: each step has the last frame up to it, as a robot that
    acts at that moment would, or the nearest one. Nothing is interpolated, and frames between are
    left out. Privileged and further signals are left out.

    Args:
        recordings (sequence of Recording): The recordings, all with the same taxels, channels and
            joints.
        root (str or PathLike): The folder; it must not exist, or be empty.
        fps (int): Steps per second.
        robot_type (str, optional): Name of the robot.
        task (str, optional): What is done in all of them; the label of each one if left out.
        nearest (bool): Whether to take the nearest frame, which may be one of the future.

    Raises:
        FileExistsError: If the folder is not empty.
        ImportError: If the extra :obj:`lerobot` is missing.
        OSError: If the disk is full.
        ValueError: If there is no recording, one has no frames or other shapes, or :obj:`fps` is no
            positive integer.

    Examples:
        >>> import tempfile
        >>> import numpy as np
        >>> from torch_geometric_tactile.io import read_lerobot
        >>> recording = Recording(time=np.arange(20) / 100, tactile=np.ones((20, 4, 3)), label=1)
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     write_lerobot([recording], f"{folder}/cups", fps=10)
        ...     read_lerobot(f"{folder}/cups")
        [Recording(num_frames=2, num_taxels=4, num_channels=3, rate=10, label=1)]
    """
    pa = require_pyarrow()
    if isinstance(fps, bool) or not isinstance(fps, int) or fps < 1:
        raise ValueError(f"'fps' must be a positive integer (got {fps!r})")
    recordings = list(recordings)
    _check_alike(recordings)
    root = Path(root)
    if root.exists() and (not root.is_dir() or any(root.iterdir())):
        raise FileExistsError(f"'{root}' must be a new or empty folder (got one that is not)")
    names = [_task_of(recording, task) for recording in recordings]
    tasks = list(dict.fromkeys(names))
    features = _features(recordings[0])
    total = 0
    episodes: list[dict[str, Any]] = []
    stats: list[dict[str, Stats]] = []
    for place, batch in _files(recordings, fps, nearest):
        tables = []
        for index, columns in batch:
            length = len(columns["timestamp"])
            columns |= {
                "episode_index": np.full(length, index),
                "index": np.arange(total, total + length),
                "task_index": np.full(length, tasks.index(names[index])),
            }
            tables.append(_table(pa, columns))
            own = {name: feature_stats(value) for name, value in columns.items()}
            stats.append(own)
            episodes.append(_episode(index, names[index], total, length, place, own))
            total += length
        _write_table(pa, pa.concat_tables(tables), root / "data" / _PATH.format(**place))
    table = pa.Table.from_pylist(episodes)
    first = {"chunk_index": 0, "file_index": 0}
    _write_table(pa, table, root / "meta" / "episodes" / _PATH.format(**first))
    _write_table(pa, _task_table(pa, tasks), root / "meta" / "tasks.parquet")
    _write_text(root / "meta" / "stats.json", stats_json(joined_stats(stats)))
    own_content = {
        "version": 1,
        "episodes": [{"label": r.label, "meta": dict(r.meta)} for r in recordings],
    }
    _write_text(root / OWN, json.dumps(own_content, indent=4, ensure_ascii=False))
    info = {
        "codebase_version": CODEBASE_VERSION,
        "robot_type": robot_type,
        "total_episodes": len(recordings),
        "total_frames": total,
        "total_tasks": len(tasks),
        "chunks_size": _FILES_PER_CHUNK,
        "data_files_size_in_mb": _DATA_MB,
        "video_files_size_in_mb": _VIDEO_MB,
        "fps": fps,
        "splits": {"train": f"0:{len(recordings)}"},
        "data_path": f"data/{_PATH}",
        "video_path": None,
        "features": features,
    }
    # At last: a folder without it is no data set.
    _write_text(root / "meta" / "info.json", json.dumps(info, indent=4, ensure_ascii=False))


def _check_alike(recordings: Sequence[Recording]) -> None:
    if not recordings:
        raise ValueError("'recordings' must hold at least one recording (got none)")
    shapes = [(r.num_taxels, r.num_channels, r.num_joints) for r in recordings]
    for i, (recording, shape) in enumerate(zip(recordings, shapes, strict=True)):
        if recording.num_frames == 0:
            raise ValueError(f"recording {i} must hold at least one frame (got none)")
        if shape != shapes[0]:
            raise ValueError(
                f"recording {i} must have {shapes[0][0]} taxels, {shapes[0][1]} channels and "
                f"{shapes[0][2]} joints, as the first one (got {shape})"
            )
    units = {r.meta.get("unit") for r in recordings}
    if len(units) > 1:
        raise ValueError(f"'recordings' must have one unit (got {sorted(map(str, units))})")


def _task_of(recording: Recording, task: str | None) -> str:
    if task is not None:
        return task
    return "touch" if recording.label is None else str(recording.label)


def _features(recording: Recording) -> dict[str, Any]:
    out: dict[str, Any] = {
        TACTILE: {
            "dtype": "float32",
            "shape": [recording.num_taxels, recording.num_channels],
            "names": ["taxels", "channels"],
        }
    }
    if recording.joint is not None:
        names = recording.meta.get("joint_names")
        known = isinstance(names, list) and len(names) == recording.num_joints
        numbered = [f"joint_{i}" for i in range(recording.num_joints)]
        out[STATE] = {
            "dtype": "float32",
            "shape": [recording.num_joints],
            "names": [str(name) for name in names or ()] if known else numbered,
        }
    out["timestamp"] = {"dtype": "float32", "shape": [1], "names": None}
    for name in _INDICES:
        out[name] = {"dtype": "int64", "shape": [1], "names": None}
    return out


def _columns(recording: Recording, fps: int, nearest: bool) -> dict[str, np.ndarray]:
    frames = resampled(recording.time, fps, nearest)
    out = {TACTILE: recording.tactile[frames]}
    if recording.joint is not None:
        out[STATE] = recording.joint[frames]
    steps = np.arange(len(frames))
    return {**out, "timestamp": (steps / fps).astype(np.float32), "frame_index": steps}


def _files(
    recordings: Sequence[Recording], fps: int, nearest: bool
) -> Iterator[tuple[dict[str, int], list[tuple[int, dict[str, np.ndarray]]]]]:
    # Episodes that go into one file, and which one; an episode is never cut.
    batch: list[tuple[int, dict[str, np.ndarray]]] = []
    number = size = 0
    for index, recording in enumerate(recordings):
        columns = _columns(recording, fps, nearest)
        more = sum(value.nbytes for value in columns.values())
        if batch and size + more > _DATA_MB * 2**20:
            yield _place(number), batch
            batch, number, size = [], number + 1, 0
        batch.append((index, columns))
        size += more
    yield _place(number), batch


def _place(number: int) -> dict[str, int]:
    chunk, file = divmod(number, _FILES_PER_CHUNK)
    return {"chunk_index": chunk, "file_index": file}


def _table(pa: Any, columns: dict[str, np.ndarray]) -> Any:
    arrays = {}
    for name, value in columns.items():
        array = pa.array(np.ascontiguousarray(value).ravel())
        if name == TACTILE:
            frames, taxels, channels = value.shape
            rows = np.arange(0, value.size + 1, channels, dtype=np.int32)
            inner = pa.ListArray.from_arrays(rows, array)
            starts = np.arange(0, frames * taxels + 1, taxels, dtype=np.int32)
            array = pa.ListArray.from_arrays(starts, inner)
        elif name == STATE:
            array = pa.FixedSizeListArray.from_arrays(array, value.shape[1])
        arrays[name] = array
    order = [name for name in (TACTILE, STATE, "timestamp", *_INDICES) if name in arrays]
    return pa.table({name: arrays[name] for name in order})


def _episode(
    index: int, task: str, start: int, length: int, place: dict[str, int], own: dict[str, Stats]
) -> dict[str, Any]:
    row: dict[str, Any] = {
        "episode_index": index,
        "tasks": [task],
        "length": length,
        "data/chunk_index": place["chunk_index"],
        "data/file_index": place["file_index"],
        "dataset_from_index": start,
        "dataset_to_index": start + length,
    }
    for name, part in own.items():
        row |= {f"stats/{name}/{key}": value.tolist() for key, value in part.items()}
    return {**row, "meta/episodes/chunk_index": 0, "meta/episodes/file_index": 0}


def _task_table(pa: Any, tasks: list[str]) -> Any:
    # LeRobot reads it with pandas, and the names as its index.
    table = pa.table({"task_index": np.arange(len(tasks)), _INDEX_COLUMN: pa.array(tasks)})
    column = {"metadata": None, "field_name": "task_index", "name": "task_index"}
    index = {"metadata": None, "field_name": _INDEX_COLUMN, "name": None}
    pandas = {
        "index_columns": [_INDEX_COLUMN],
        "column_indexes": [],
        "columns": [
            {**column, "pandas_type": "int64", "numpy_type": "int64"},
            {**index, "pandas_type": "unicode", "numpy_type": "object"},
        ],
        "creator": {"library": "pyarrow", "version": pa.__version__},
        "pandas_version": "2.0.0",
    }
    return table.replace_schema_metadata({"pandas": json.dumps(pandas)})


def _write_table(pa: Any, table: Any, path: Path) -> None:
    with atomic_path(path) as temporary:
        pa.parquet.write_table(
            table, temporary, compression="snappy", use_dictionary=True, write_page_checksum=True
        )


def _write_text(path: Path, text: str) -> None:
    with atomic_path(path) as temporary:
        temporary.write_text(text, encoding="utf-8")
