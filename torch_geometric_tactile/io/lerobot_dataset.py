r"""Data sets of `LeRobot <https://huggingface.co/docs/lerobot/lerobot-dataset-v3>`_, version 3.0,
written with pyarrow only.

====================================== =============================================================
``meta/info.json``                     version, sizes, rate, features
``meta/stats.json``                    statistics of the features over all episodes
``meta/tasks.parquet``                 names of the tasks, and their numbers
``meta/episodes/chunk-.../file-...``   length, task, file and statistics of each episode
``data/chunk-.../file-....parquet``    the frames of many episodes
``meta/tactile.json``                  file of this package: shape, labels, annotations, metadata
``README.md``                          list of the data files, for :obj:`datasets`
====================================== =============================================================

:obj:`observation.tactile` is float32 :math:`(N \cdot C,)` with NaN for missing readings, and
:obj:`observation.state` holds the joint angles in radians. Further signals are
:obj:`observation.extra.NAME`, and commands are :obj:`action`.
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
    MAX_FPS,
    check_alike,
    check_new_folder,
    label_to_task,
    tactile_content,
    write_description,
    write_json,
)
from torch_geometric_tactile.io._lerobot_steps import (
    ACTION,
    INDICES,
    STATE,
    STATE_FRAMES,
    TACTILE,
    ExtraSignal,
    Stats,
    check_complete,
    check_gap_options,
    check_gaps,
    check_key_and_fill,
    describe_feature,
    extra_signals,
    feature_stats,
    frames_since,
    pool_stats,
    regular_steps,
    stats_to_lists,
    touch_columns,
    touch_features,
    warn_of_unsupported_signals,
)
from torch_geometric_tactile.io._lerobot_tables import (
    arrow_column,
    require_pyarrow,
    schema_metadata,
    write_parquet,
)

_CODEBASE_VERSION = "v3.0"
_FILE_PATTERN = "chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
_DATA_MB, _VIDEO_MB, _FILES_PER_CHUNK = 100, 200, 1000  # the defaults of LeRobot
_INDEX_COLUMN = "__index_level_0__"


def write_lerobot(
    recordings: Sequence[Recording],
    root: PathLike,
    fps: float,
    *,
    robot_type: str | None = None,
    task: str | None = None,
    nearest: bool = False,
    every_frame: bool = False,
    gaps: Literal["nan", "error"] = "nan",
    max_gap: float | None = None,
    key: str = TACTILE,
    fill: float | None = None,
) -> None:
    r"""Writes recordings as the episodes of a LeRobot data set.

    Each recording is resampled at :obj:`fps`. A step has the last frame at or before it, which a
    robot would have at that moment, or with :obj:`nearest` the nearest frame. Nothing is
    interpolated. Frames between steps are left out unless :obj:`every_frame` is set. Steps in a
    gap, where frames are missing, are NaN, and a warning is logged. Time starts at 0 in each
    episode, and annotations are shifted accordingly. Further signals (:obj:`extra`) become features
    if they are numbers of the same shape in all recordings. Other signals, such as privileged ones,
    are left out, and a warning names them.

    Actions become the feature :obj:`action`. The action of a step is the last command at or before
    it, as LeRobot records it.

    Args:
        recordings (sequence of Recording): The recordings, all with the same taxels, channels,
            joints and actions. The names of joints and actions are taken from the first recording.
        root (str or PathLike): The folder, which must be new or empty.
        fps (float): Steps per second, such as 30 or 29.97.
        robot_type (str, optional): Name of the robot.
        task (str, optional): The task of all recordings. Defaults to the label of each recording.
        nearest (bool): Whether to take the nearest frame, which may be after the step.
        every_frame (bool): Whether to store all frames since the previous step as well, in the
            features :obj:`observation.tactile_frames` (and :obj:`observation.state_frames`)
            :math:`(R \cdot N \cdot C,)` and :obj:`observation.tactile_frames_time` :math:`(R,)`,
            in seconds after the step. The newest frame is in the last of :math:`R` rows, and unused
            rows are NaN. :func:`read_lerobot` returns the frames with their times. With another
            :obj:`key`, the names begin with it.
        gaps (str): Whether steps in a gap are NaN (:obj:`"nan"`) or an error (:obj:`"error"`).
        max_gap (float, optional): The longest time in seconds that is not a gap. A step is in a gap
            if its frame is farther away than this, and farther than one step. Defaults to five
            times the median time between frames of the recording.
        key (str): The feature of the readings, which begins with :obj:`"observation."`. LeRobot's
            policies ignore the default. ACT, diffusion and TD-MPC read
            :obj:`"observation.environment_state"`, and all policies read
            :obj:`"observation.state"`. The latter has the joint angles first, then the readings.
            The frames of :obj:`every_frame` stay in :obj:`observation.tactile_frames`.
        fill (float, optional): The number that replaces missing readings and further signals, since
            a missing input makes the loss of a policy NaN. Statistics include it. It also fills
            unused rows of :obj:`every_frame`, whose time is :obj:`-2 / fps`. Joint angles and
            actions are not replaced.

    Raises:
        FileExistsError: If the folder is not empty.
        ImportError: If the extra :obj:`lerobot` is missing.
        OSError: If the disk is full.
        ValueError: If there is no recording, a recording has no frames or a different shape,
            :obj:`fps` is not a positive number, :obj:`nearest` and :obj:`every_frame` are both set,
            there is a gap and :obj:`gaps` is :obj:`"error"`, :obj:`key` or :obj:`fill` is invalid,
            or a joint angle or an action is missing and :obj:`fill` is set.

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
    fps = _checked_fps(fps)
    if nearest and every_frame:
        raise ValueError("'nearest' must be False with 'every_frame', which has only past frames")
    check_gap_options(gaps, max_gap)
    check_key_and_fill(key, fill)
    recordings = list(recordings)
    check_alike(recordings)
    for number, recording in enumerate(recordings):
        time = recording.time - recording.time[0]
        steps = regular_steps(time, fps, cover_last=every_frame)
        check_gaps(number, time, steps, fps, nearest, gaps, max_gap, fill)
        if fill is not None:
            check_complete(number, recording, steps, fps, nearest, max_gap, every_frame)
    root = Path(root)
    check_new_folder(root)
    extra = extra_signals(recordings)
    warn_of_unsupported_signals(root, recordings, extra)
    task_names = [label_to_task(r.label) if task is None else task for r in recordings]
    tasks = list(dict.fromkeys(task_names))
    rows = max(map(len, _frames_of_all_steps(recordings, fps))) if every_frame else 0
    features = _features(recordings[0], rows, extra, key)
    num_steps = 0
    episodes: list[dict[str, Any]] = []
    stats: list[dict[str, Stats]] = []
    for file_indices, batch in _group_by_file(
        recordings, _Sampling(fps, nearest, rows, max_gap, extra, key, fill)
    ):
        tables = []
        for index, columns in batch:
            length = len(columns["timestamp"])
            columns |= {
                "episode_index": np.full(length, index),
                "index": np.arange(num_steps, num_steps + length),
                "task_index": np.full(length, tasks.index(task_names[index])),
            }
            tables.append(pa.table({name: arrow_column(columns[name]) for name in features}))
            stats.append({name: feature_stats(columns[name]) for name in features})
            episodes.append(
                _episode_row(index, task_names[index], num_steps, length, file_indices, stats[-1])
            )
            num_steps += length
        table = pa.concat_tables(tables).replace_schema_metadata(schema_metadata(features))
        write_parquet(table, root / "data" / _FILE_PATTERN.format(**file_indices))
    table = pa.Table.from_pylist(episodes)
    first_file = {"chunk_index": 0, "file_index": 0}
    write_parquet(table, root / "meta" / "episodes" / _FILE_PATTERN.format(**first_file))
    write_parquet(_task_table(pa, tasks), root / "meta" / "tasks.parquet")
    write_json(root / "meta/stats.json", stats_to_lists(pool_stats(stats)), allow_nan=False)
    lengths = [episode["length"] for episode in episodes]
    starts = [float(recording.time[0]) for recording in recordings]
    content = tactile_content(
        dict(enumerate(recordings)),
        starts,
        lengths,
        task_names,
        rows,
        extra,
        key=key,
        first_column=recordings[0].num_joints if key == STATE else None,
        fill=fill,
    )
    info = {
        "codebase_version": _CODEBASE_VERSION,
        "robot_type": robot_type,
        "total_episodes": len(recordings),
        "total_frames": num_steps,
        "total_tasks": len(tasks),
        "chunks_size": _FILES_PER_CHUNK,
        "data_files_size_in_mb": _DATA_MB,
        "video_files_size_in_mb": _VIDEO_MB,
        "fps": fps,
        "splits": {"train": f"0:{len(recordings)}"},
        "data_path": f"data/{_FILE_PATTERN}",
        "video_path": None,
        "features": features,
    }
    write_description(root, content, info)


def _checked_fps(fps: Any) -> float:
    # LeRobot declares integers, so that 30.0 is written as 30.
    is_number = isinstance(fps, int | float) and not isinstance(fps, bool)
    if not is_number or not 0 < fps < MAX_FPS:
        raise ValueError(f"'fps' must be a positive number below {MAX_FPS:,} (got {fps!r:.80})")
    return int(fps) if fps == int(fps) else float(fps)


@dataclass
class _Sampling:
    # The options of resampling.
    fps: float
    nearest: bool
    rows: int
    max_gap: float | None
    extra: Mapping[str, ExtraSignal]
    key: str
    fill: float | None

    def columns(self, recording: Recording) -> dict[str, np.ndarray]:
        time = recording.time - recording.time[0]
        steps = regular_steps(time, self.fps, cover_last=self.rows > 0)
        columns = touch_columns(
            replace(recording, time=time),
            steps,
            self.fps,
            self.rows,
            self.nearest,
            extra=self.extra,
            max_gap=self.max_gap,
            key=self.key,
            fill=self.fill,
        )
        return {
            **columns,
            "timestamp": steps.astype(np.float32),
            "frame_index": np.arange(len(steps)),
        }


def _features(
    recording: Recording, rows: int, extra: Mapping[str, ExtraSignal], key: str
) -> dict[str, Any]:
    joint_names = _column_names(recording, "joint", recording.num_joints)
    features = touch_features(recording, rows, extra, key, joint_names if key == STATE else ())
    if recording.joint is not None:
        if key != STATE:
            features[STATE] = describe_feature(recording.num_joints, joint_names)
        if rows:
            features[STATE_FRAMES] = describe_feature(rows * recording.num_joints)
    if recording.action is not None:
        names = _column_names(recording, "action", recording.num_actions)
        features[ACTION] = describe_feature(recording.num_actions, names)
    features["timestamp"] = describe_feature(1)
    return features | {name: describe_feature(1, dtype="int64") for name in INDICES}


def _column_names(recording: Recording, kind: str, size: int) -> list[str]:
    names = recording.meta.get(f"{kind}_names")
    if isinstance(names, list) and len(names) == size:
        return [str(name) for name in names]
    return [f"{kind}_{i}" for i in range(size)]


def _frames_of_all_steps(recordings: Sequence[Recording], fps: float) -> Iterator[np.ndarray]:
    for recording in recordings:
        time = recording.time - recording.time[0]
        yield from frames_since(time, regular_steps(time, fps, cover_last=True), fps)


def _group_by_file(
    recordings: Sequence[Recording], sampling: _Sampling
) -> Iterator[tuple[dict[str, int], list[tuple[int, dict[str, np.ndarray]]]]]:
    # Yields the indices of a file and the episodes in it. An episode is never split.
    batch: list[tuple[int, dict[str, np.ndarray]]] = []
    file_number = batch_bytes = 0
    for index, recording in enumerate(recordings):
        columns = sampling.columns(recording)
        num_bytes = sum(value.nbytes for value in columns.values())
        if batch and batch_bytes + num_bytes > _DATA_MB * 2**20:
            yield _file_indices(file_number), batch
            batch, file_number, batch_bytes = [], file_number + 1, 0
        batch.append((index, columns))
        batch_bytes += num_bytes
    yield _file_indices(file_number), batch


def _file_indices(number: int) -> dict[str, int]:
    chunk, file = divmod(number, _FILES_PER_CHUNK)
    return {"chunk_index": chunk, "file_index": file}


def _episode_row(
    index: int,
    task: str,
    start: int,
    length: int,
    file_indices: dict[str, int],
    stats: dict[str, Stats],
) -> dict[str, Any]:
    row: dict[str, Any] = {
        "episode_index": index,
        "tasks": [task],
        "length": length,
        "data/chunk_index": file_indices["chunk_index"],
        "data/file_index": file_indices["file_index"],
        "dataset_from_index": start,
        "dataset_to_index": start + length,
    }
    for name, part in stats.items():
        row |= {f"stats/{name}/{key}": value.tolist() for key, value in part.items()}
    return {**row, "meta/episodes/chunk_index": 0, "meta/episodes/file_index": 0}


def _task_table(pa: Any, tasks: list[str]) -> Any:
    # LeRobot reads this table with pandas, with the names as index.
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
