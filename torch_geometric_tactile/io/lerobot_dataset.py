r"""Data sets of `LeRobot <https://huggingface.co/docs/lerobot/lerobot-dataset-v3>`_, version 3.0,
with pyarrow alone.

====================================== =============================================================
``meta/info.json``                     version, sizes, rate, features
``meta/stats.json``                    statistics of the features over all episodes
``meta/tasks.parquet``                 names of the tasks, and their numbers
``meta/episodes/chunk-.../file-...``   length, task, place and statistics of each episode
``data/chunk-.../file-....parquet``    the frames of many episodes
``meta/tactile.json``                  ours: shape, labels, annotations and metadata of recordings
``README.md``                          which files are the data, for :obj:`datasets`
====================================== =============================================================

:obj:`observation.tactile` is float32 :math:`(N \cdot C,)` with NaN where a reading is missing, and
:obj:`observation.state` the joint angles in radians. Further signals are
:obj:`observation.extra.NAME`.
"""

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile.data import Recording
from torch_geometric_tactile.io._lerobot_content import (
    check_alike,
    check_new_folder,
    own_content,
    task_of_label,
    write_description,
    write_json,
)
from torch_geometric_tactile.io._lerobot_steps import (
    INDICES,
    STATE,
    STATE_FRAMES,
    ExtraSignal,
    Stats,
    check_gap_options,
    check_gaps,
    extra_signals,
    feature,
    feature_stats,
    frames_since,
    joined_stats,
    regular_steps,
    stats_lists,
    touch_columns,
    touch_features,
    warn_of_lost,
)
from torch_geometric_tactile.io._lerobot_tables import (
    arrow_column,
    require_pyarrow,
    schema_metadata,
    write_parquet,
)

_CODEBASE_VERSION = "v3.0"
_PATH = "chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
_DATA_MB, _VIDEO_MB, _FILES_PER_CHUNK = 100, 200, 1000
_INDEX_COLUMN = "__index_level_0__"


def write_lerobot(
    recordings: Sequence[Recording],
    root: PathLike,
    fps: int,
    *,
    robot_type: str | None = None,
    task: str | None = None,
    nearest: bool = False,
    every_frame: bool = False,
    gaps: Literal["nan", "error"] = "nan",
    max_gap: float | None = None,
) -> None:
    r"""Writes recordings as the episodes of a LeRobot data set.

    Each one is sampled anew at :obj:`fps`: each step has the last frame up to it, as a robot that
    acts at that moment would, or the nearest one. Nothing is interpolated, and frames between are
    left out unless :obj:`every_frame` is given. Steps in a gap, where frames are missing, are NaN,
    and a warning is logged. Time starts at 0 in each episode, and annotations are shifted with it.
    Further signals (:obj:`extra`) that are numbers, of one shape in all recordings, are features; a
    warning names all other signals, as privileged ones, which are left out.

    Args:
        recordings (sequence of Recording): The recordings, all with the same taxels, channels and
            joints.
        root (str or PathLike): The folder; it must not exist, or be empty.
        fps (int): Steps per second.
        robot_type (str, optional): Name of the robot.
        task (str, optional): What is done in all of them; the label of each one if left out.
        nearest (bool): Whether to take the nearest frame, which may be one of the future.
        every_frame (bool): Whether each step has all frames since the last step as well, in the
            features :obj:`observation.tactile_frames` (and :obj:`observation.state_frames`)
            :math:`(R \cdot N \cdot C,)` and :obj:`observation.tactile_frames_time` :math:`(R,)`,
            in seconds after the step. The newest is the last of :math:`R` rows, and rows before
            the oldest are NaN. :func:`read_lerobot` returns the frames with their times.
        gaps (str): Whether steps in a gap are NaN (:obj:`"nan"`) or an error (:obj:`"error"`).
        max_gap (float, optional): A step is in a gap if its frame is farther away than so many
            seconds, and than a step; if left out, than five frames at the usual distance of frames
            of the recording.

    Raises:
        FileExistsError: If the folder is not empty.
        ImportError: If the extra :obj:`lerobot` is missing.
        OSError: If the disk is full.
        ValueError: If there is no recording, one has no frames or other shapes, :obj:`fps` is no
            positive integer, :obj:`nearest` and :obj:`every_frame` are both given, or there is a
            gap and :obj:`gaps` is :obj:`"error"`.

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
    if nearest and every_frame:
        raise ValueError("'nearest' must be False with 'every_frame', which has only past frames")
    check_gap_options(gaps, max_gap)
    recordings = list(recordings)
    check_alike(recordings)
    for number, recording in enumerate(recordings):
        since = recording.time - recording.time[0]
        steps = regular_steps(since, fps, whole=every_frame)
        check_gaps(number, since, steps, fps, nearest, gaps, max_gap)
    root = Path(root)
    check_new_folder(root)
    extra = extra_signals(recordings)
    warn_of_lost(root, recordings, extra)
    names = [task_of_label(r.label) if task is None else task for r in recordings]
    tasks = list(dict.fromkeys(names))
    rows = max(map(len, _all_since(recordings, fps))) if every_frame else 0
    features = _features(recordings[0], rows, extra)
    total = 0
    episodes: list[dict[str, Any]] = []
    stats: list[dict[str, Stats]] = []
    for place, batch in _files(recordings, _Sampling(fps, nearest, rows, max_gap, extra)):
        tables = []
        for index, columns in batch:
            length = len(columns["timestamp"])
            columns |= {
                "episode_index": np.full(length, index),
                "index": np.arange(total, total + length),
                "task_index": np.full(length, tasks.index(names[index])),
            }
            tables.append(pa.table({name: arrow_column(columns[name]) for name in features}))
            stats.append({name: feature_stats(columns[name]) for name in features})
            episodes.append(_episode(index, names[index], total, length, place, stats[-1]))
            total += length
        table = pa.concat_tables(tables).replace_schema_metadata(schema_metadata(features))
        write_parquet(table, root / "data" / _PATH.format(**place))
    table = pa.Table.from_pylist(episodes)
    first = {"chunk_index": 0, "file_index": 0}
    write_parquet(table, root / "meta" / "episodes" / _PATH.format(**first))
    write_parquet(_task_table(pa, tasks), root / "meta" / "tasks.parquet")
    write_json(root / "meta/stats.json", stats_lists(joined_stats(stats)), allow_nan=False)
    lengths = [episode["length"] for episode in episodes]
    starts = [float(recording.time[0]) for recording in recordings]
    own = own_content(recordings, starts, lengths, names, rows, extra)
    info = {
        "codebase_version": _CODEBASE_VERSION,
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
    write_description(root, own, info)


@dataclass
class _Sampling:
    # How the recordings are sampled.
    fps: int
    nearest: bool
    rows: int
    max_gap: float | None
    extra: Mapping[str, ExtraSignal]

    def columns(self, recording: Recording) -> dict[str, np.ndarray]:
        since = recording.time - recording.time[0]
        steps = regular_steps(since, self.fps, whole=self.rows > 0)
        out = touch_columns(
            replace(recording, time=since),
            steps,
            self.fps,
            self.rows,
            self.nearest,
            extra=self.extra,
            max_gap=self.max_gap,
        )
        return {
            **out,
            "timestamp": steps.astype(np.float32),
            "frame_index": np.arange(len(steps)),
        }


def _features(recording: Recording, rows: int, extra: Mapping[str, ExtraSignal]) -> dict[str, Any]:
    out = touch_features(recording, rows, extra)
    if recording.joint is not None:
        names = recording.meta.get("joint_names")
        known = isinstance(names, list) and len(names) == recording.num_joints
        numbered = [f"joint_{i}" for i in range(recording.num_joints)]
        named = [str(name) for name in names or ()] if known else numbered
        out[STATE] = feature(recording.num_joints, named)
        if rows:
            out[STATE_FRAMES] = feature(rows * recording.num_joints)
    out["timestamp"] = feature(1)
    return out | {name: feature(1, dtype="int64") for name in INDICES}


def _all_since(recordings: Sequence[Recording], fps: int) -> Iterator[np.ndarray]:
    for recording in recordings:
        since = recording.time - recording.time[0]
        yield from frames_since(since, regular_steps(since, fps, whole=True), fps)


def _files(
    recordings: Sequence[Recording], sampling: _Sampling
) -> Iterator[tuple[dict[str, int], list[tuple[int, dict[str, np.ndarray]]]]]:
    # Episodes that go into one file, and which one; an episode is never cut.
    batch: list[tuple[int, dict[str, np.ndarray]]] = []
    number = size = 0
    for index, recording in enumerate(recordings):
        columns = sampling.columns(recording)
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
