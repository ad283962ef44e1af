r"""Checked reading of the folders of LeRobot data sets: descriptions, tasks, episodes and values.
``meta/tactile.json`` holds the content that LeRobot cannot store.
"""

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from torch_geometric_tactile._checks import need
from torch_geometric_tactile._files import atomic_path, existing_file
from torch_geometric_tactile._limits import LEROBOT_TASKS
from torch_geometric_tactile._texts import printable, read_json, short_list
from torch_geometric_tactile.data import Recording
from torch_geometric_tactile.data._recording_arrays import warn_of_rounding
from torch_geometric_tactile.io._lerobot_steps import (
    EXTRA,
    TACTILE,
    ExtraSignal,
    frame_times_feature,
    frames_feature,
)
from torch_geometric_tactile.io._lerobot_tables import (
    is_list,
    num_rows,
    read_texts,
    require_pyarrow,
)

# Without this README, `datasets` reads the files in `meta` as data.
_README = """\
---
configs:
- config_name: default
  data_files: data/*/*.parquet
task_categories:
- robotics
tags:
- LeRobot
- tactile
---

A LeRobot data set (v3.0) with touch, written by torch_geometric_tactile. `meta/tactile.json` has
its shape, labels, annotations and metadata.
"""

_TACTILE_JSON = "meta/tactile.json"
_REMOVE_ADVICE = "remove it if another program changed the data set"
MAX_FPS = 1_000_000
_MAX_DIMS = 8  # dimensions of a further signal in a frame
# Between two steps, as lerobot's `tolerance_s`, in addition to the rounding of float32.
_TIME_TOLERANCE = 1e-4  # seconds
_DTYPES = ("bool", *(f"{sign}int{n}" for sign in ("", "u") for n in (8, 16, 32, 64)))
_DTYPES += ("float16", "float32", "float64")
_Item = TypeVar("_Item")


def check_new_folder(root: Path) -> None:
    r"""Raises an error unless a folder is missing or empty."""
    if root.exists() and (not root.is_dir() or any(root.iterdir())):
        raise FileExistsError(
            f"'{root}' must be a new or empty folder (got a file or a folder with files)"
        )


def check_alike(recordings: Sequence[Recording]) -> None:
    r"""Raises an error unless all recordings have frames, and the same shapes and unit."""
    need(recordings, "'recordings' must hold at least one recording (got none)")
    shapes = [(r.num_taxels, r.num_channels, r.num_joints, r.num_actions) for r in recordings]
    for i, (recording, shape) in enumerate(zip(recordings, shapes, strict=True)):
        if recording.num_frames == 0:
            raise ValueError(f"recording {i} must hold at least one frame (got none)")
        if shape != shapes[0]:
            raise ValueError(
                f"recording {i} must have {shapes[0][0]} taxels, {shapes[0][1]} channels, "
                f"{shapes[0][2]} joints and {shapes[0][3]} actions, as recording 0 (got {shape})"
            )
    units = {r.meta.get("unit") for r in recordings}
    if len(units) > 1:
        raise ValueError(f"'recordings' must have one unit (got {sorted(map(str, units))})")


def write_json(path: Path, content: Any, **settings: Any) -> None:
    r"""Writes a JSON file."""
    _write_text(path, json.dumps(content, indent=4, **settings))


def write_description(root: Path, tactile_content: dict[str, Any], info: dict[str, Any]) -> None:
    r"""Writes the description of a data set. The file ``info.json`` is written last, since a folder
    without it is not a data set.
    """
    write_json(root / _TACTILE_JSON, tactile_content, ensure_ascii=False)
    if not (root / "README.md").exists():
        _write_text(root / "README.md", _README)
    write_json(root / "meta/info.json", info, ensure_ascii=False)


def _write_text(path: Path, text: str) -> None:
    with atomic_path(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


@dataclass
class TactileContent:
    r"""The content of a ``meta/tactile.json``."""

    path: Path
    feature: str = TACTILE
    columns: tuple[int, int] | None = None  # of the readings, if the feature has other values too
    shape: tuple[int, int] | None = None
    episodes: dict[int, dict[str, Any]] = field(default_factory=dict)
    extra: dict[str, ExtraSignal] = field(default_factory=dict)

    def episode(self, number: int, length: int, task: str) -> dict[str, Any]:
        r"""Returns the label, metadata and annotations of an episode.

        Raises:
            ValueError: If the file lacks this episode, or has a different length or task for it.
        """
        if not self.episodes:
            return {"label": task, "meta": {"episode": number}}
        episode = self.episodes.get(number)
        if episode is None:
            raise ValueError(
                f"'{self.path}' must hold episode {number} (got "
                f"{short_list([*self.episodes], 20)}): {_REMOVE_ADVICE}"
            )
        for key, value in {"length": length, "task": task}.items():
            if episode.get(key) not in (None, value):
                raise ValueError(
                    f"'{self.path}' must have the {key} {printable(value)[:40]} of episode {number}"
                    f" (got {printable(episode[key])[:40]}): {_REMOVE_ADVICE}"
                )
        return episode


def tactile_content(
    recordings: Mapping[int, Recording],
    starts: Sequence[float],
    lengths: Sequence[int],
    tasks: Sequence[str],
    rows: int,
    extra: Mapping[str, ExtraSignal],
    *,
    key: str = TACTILE,
    first_column: int | None = None,
    fill: float | None = None,
) -> dict[str, Any]:
    r"""Returns the content of a new ``meta/tactile.json``.

    Args:
        recordings (Mapping of int to Recording): The recordings by the indices of their episodes.
        starts (sequence of float): Start of each episode on the clock of its recording, in seconds.
        lengths (sequence of int): Number of steps of each episode.
        tasks (sequence of str): Task of each episode.
        rows (int): Number of frames stored per step, or 0 if only one is stored.
        extra (Mapping): The further signals.
        key (str): The feature of the readings.
        first_column (int, optional): The first reading in this feature, if it has other values too.
        fill (float, optional): The number that stands for missing readings.
    """
    first = next(iter(recordings.values()))
    shape = [first.num_taxels, first.num_channels]
    content: dict[str, Any] = {"version": 2, "feature": key, "shape": shape}
    if first_column is not None:
        content["columns"] = [first_column, first_column + math.prod(shape)]
    if fill is not None:
        content["fill"] = fill
    if rows:
        frames = {"feature": frames_feature(key), "shape": [rows, *shape]}
        missing_row = "NaN" if fill is None else f"{fill}, at a time of -2 steps"
        content["every_frame"] = {
            **frames,
            "time": frame_times_feature(key),
            "missing": f"{missing_row}, before the others",
        }
    if extra:
        content["extra"] = {
            name: {"feature": EXTRA + name, "shape": [*signal.shape], "dtype": signal.dtype}
            for name, signal in extra.items()
        }
    content["episodes"] = [
        {
            "episode_index": index,
            "length": length,
            "task": task,
            "label": recording.label,
            "meta": dict(recording.meta),
            "annotations": [
                [begin - float(start), end - float(start), label]
                for begin, end, label in recording.annotations
            ],
        }
        for (index, recording), start, length, task in zip(
            recordings.items(), starts, lengths, tasks, strict=True
        )
    ]
    return content


def read_tactile_content(root: Path, num_episodes: int, tasks: Sequence[str]) -> TactileContent:
    r"""Reads the ``meta/tactile.json`` of a data set. Returns an empty content without this file.

    Raises:
        ValueError: If the file is invalid, or does not have each episode once.
    """
    path = root / _TACTILE_JSON
    if not path.is_file():
        return TactileContent(path)
    content = read_object(path)
    version, episodes = content.get("version"), content.get("episodes")
    if version not in (1, 2):
        raise ValueError(f"'{path}' must have version 1 or 2 (got {printable(version)[:40]})")
    if not isinstance(episodes, list) or not all(
        isinstance(e, dict) and isinstance(e.get("meta"), dict) for e in episodes
    ):
        raise ValueError(f"'{path}' must hold 'episodes', each with 'meta' (got another value)")
    if version == 1:  # 0.2.0 wrote episodes in order, without indices and tasks
        episodes = [{**episode, "episode_index": i} for i, episode in enumerate(episodes)]
        if len(tasks) > 1:  # each episode has its label as task, since `task` was left out
            episodes = [{**e, "task": label_to_task(e.get("label"))} for e in episodes]
    numbers = [episode.get("episode_index") for episode in episodes]
    is_complete = len(numbers) == num_episodes and all(type(n) is int and n >= 0 for n in numbers)
    if not is_complete or len({*numbers}) < len(numbers):
        raise ValueError(
            f"'{path}' must hold each of {num_episodes} episodes once (got {len(numbers)}: "
            f"{printable(numbers)[:80]}): {_REMOVE_ADVICE}"
        )
    by_number = dict(zip(numbers, episodes, strict=True))
    extra = _read_extra_signals(path, content.get("extra", {}))
    if version == 1:
        return TactileContent(path, episodes=by_number, extra=extra)
    feature, shape = content.get("feature", TACTILE), _read_shape(path, content)
    need(
        isinstance(feature, str),
        f"'{path}' must name in 'feature' the feature of the readings",
        printable(feature)[:40],
    )
    return TactileContent(
        path, feature, _read_columns(path, content, math.prod(shape)), shape, by_number, extra
    )


def _read_columns(path: Path, content: dict[str, Any], size: int) -> tuple[int, int] | None:
    columns = content.get("columns")
    if columns is None:
        return None
    is_pair = isinstance(columns, list) and len(columns) == 2
    if not is_pair or not all(type(n) is int and 0 <= n < 2**31 for n in columns):
        raise ValueError(
            f"'{path}' must hold in 'columns' the first column of the readings and the column "
            f"after the last (got {printable(columns)[:40]})"
        )
    if columns[1] - columns[0] != size:
        raise ValueError(
            f"'{path}' must hold in 'columns' {size} columns, as many as its 'shape' (got "
            f"{printable(columns)[:40]})"
        )
    return (columns[0], columns[1])


def _read_extra_signals(path: Path, content: Any) -> dict[str, ExtraSignal]:
    signals = content.items() if isinstance(content, dict) else [("", None)]
    extra = {}
    for name, signal in signals:
        shape = signal.get("shape") if isinstance(signal, dict) else None
        dtype = signal.get("dtype") if isinstance(signal, dict) else None
        if (
            not isinstance(shape, list)
            or len(shape) > _MAX_DIMS
            or not all(type(n) is int and 0 < n < 2**31 for n in shape)
            or dtype not in _DTYPES
        ):
            raise ValueError(
                f"'{path}' must hold in 'extra' a shape and a type for each further signal (got "
                f"{printable(signal)[:80]} for '{printable(name)[:40]}')"
            )
        extra[name] = ExtraSignal(tuple(shape), str(dtype))
    return extra


def _read_shape(path: Path, content: dict[str, Any]) -> tuple[int, int]:
    shape = content.get("shape")
    if isinstance(shape, list) and len(shape) == 2 and all(type(n) is int and n > 0 for n in shape):
        return (shape[0], shape[1])
    raise ValueError(
        f"'{path}' must hold 'shape', the numbers of taxels and channels "
        f"(got {printable(shape)[:40]})"
    )


def label_to_task(label: str | int | None) -> str:
    r"""Returns the task of a recording with this label, if no task is given."""
    return "touch" if label is None else str(label)


def read_object(path: Path) -> dict[str, Any]:
    r"""Reads a JSON file, which must hold an object."""
    try:
        content = read_json(path)
    except ValueError as error:
        raise ValueError(f"'{path}' cannot be read as JSON: {error}") from error
    if not isinstance(content, dict):
        raise ValueError(f"'{path}' must hold a JSON object (got {type(content).__name__})")
    return content


def read_info(root: Path) -> dict[str, Any]:
    r"""Reads and checks :obj:`meta/info.json` of a data set."""
    path = existing_file(root / "meta" / "info.json", "give the folder of a LeRobot data set")
    info = read_object(path)
    version = info.get("codebase_version")
    if not isinstance(version, str) or not version.startswith("v3."):
        raise ValueError(
            f"'{root}' must be a LeRobot data set of version 3 (got {printable(version)}): convert "
            "it with lerobot's conversion script"
        )
    for key, kind in {
        "features": dict,
        "fps": int | float,
        "total_episodes": int,
        "total_frames": int,
    }.items():
        if not isinstance(info.get(key), kind) or isinstance(info[key], bool):
            raise ValueError(f"'{path}' must hold '{key}' (got {printable(info.get(key))[:40]})")
    if not 0 < info["fps"] < MAX_FPS:
        raise ValueError(f"'{path}' must hold a positive 'fps' (got {info['fps']})")
    return info


def data_files(root: Path, info: dict[str, Any]) -> list[Path]:
    r"""Returns the files with the frames of a data set, and checks their number of frames."""
    paths = sorted(root.glob("data/*/*.parquet"))
    if not paths:
        raise FileNotFoundError(f"'{root}' must hold 'data/chunk-.../file-....parquet' (got none)")
    total = sum(map(num_rows, paths))
    if total != info["total_frames"]:
        raise ValueError(
            f"'{root}' must hold {info['total_frames']} frames, as declared in its info.json (got "
            f"{total})"
        )
    return paths


def split_episodes(path: Path, table: Any) -> Iterator[tuple[int, Any]]:
    r"""Yields the index and the rows of each episode in a table."""
    numbers = integer_column(path, table, "episode_index")
    bounds = np.flatnonzero(np.diff(numbers)) + 1
    for start, stop in pairwise([0, *bounds.tolist(), len(numbers)]):
        if stop > start:
            yield int(numbers[start]), table.slice(start, stop - start)


def sort_episodes(
    root: Path, info: dict[str, Any], indexed_items: list[tuple[int, _Item]]
) -> dict[int, _Item]:
    r"""Returns the items by the indices of their episodes, in order. Indices of deleted episodes
    may be missing.

    Args:
        root (Path): The folder, for messages.
        info (dict): The content of ``info.json``.
        indexed_items (list of tuple): Pairs of the index of an episode and its item.

    Raises:
        ValueError: If an episode is missing or repeated.
    """
    numbers = sorted(number for number, _ in indexed_items)
    if len(numbers) != info["total_episodes"] or len({*numbers}) < len(numbers):
        raise ValueError(
            f"'{root}' must hold each of {info['total_episodes']} episodes once, as declared in "
            f"its info.json (got {printable(numbers)[:80]})"
        )
    by_number = dict(indexed_items)
    return {number: by_number[number] for number in numbers}


def integer_column(path: Path, table: Any, name: str) -> np.ndarray:
    r"""Returns a column, which must hold integers."""
    return _number_column(path, table, name, "iu", "integers")


def step_times(path: Path, table: Any, fps: float) -> np.ndarray:
    r"""Returns the times of the steps of an episode in seconds.

    Raises:
        ValueError: If steps are missing, in another order, or not :obj:`1 / fps` seconds apart.
    """
    index = integer_column(path, table, "frame_index")
    invalid = np.flatnonzero(index != np.arange(len(index)))
    if len(invalid):
        raise ValueError(
            f"'{path}' must hold all steps of an episode in order: 'frame_index' must be "
            f"{invalid[0]} (got {index[invalid[0]]})"
        )
    time = _number_column(path, table, "timestamp", "iuf", "numbers").astype(np.float64)
    steps = index / fps
    if np.allclose(time, steps, rtol=1e-6, atol=1e-6):  # the steps of the clock, rounded to float32
        return steps
    tolerance = _TIME_TOLERANCE + np.spacing(np.abs(time).astype(np.float32))
    invalid = np.flatnonzero(~(np.abs(np.diff(time) - 1 / fps) <= tolerance[1:]))
    if len(invalid):
        step = int(invalid[0]) + 1
        raise ValueError(
            f"'{path}' must hold {fps:g} steps per second, as declared in info.json: 'timestamp' "
            f"must advance by {1 / fps:.4g} s (got {time[step]:.9g} s in step {step} after "
            f"{time[step - 1]:.9g} s): resample the episode, or write the steps of a gap as NaN"
        )
    return time


def _number_column(path: Path, table: Any, name: str, kinds: str, noun: str) -> np.ndarray:
    column = table.column(name)
    if is_list(column.type):  # lists of one value
        return row_values(path, table, name, (1,))[:, 0]
    values = column.combine_chunks().to_numpy(zero_copy_only=False)
    if values.dtype.kind not in kinds or column.null_count:
        raise ValueError(f"'{path}' must hold {noun} in '{name}' (got {column.type})")
    return np.asarray(values)


def row_values(
    path: Path, table: Any, name: str, shape: tuple[int, ...], dtype: str = "float32"
) -> np.ndarray:
    r"""Returns a column of numbers in a floating-point type, with NaN for missing numbers.

    Shapes:
        - **output:** values :math:`(T, *)`
    """
    pa = require_pyarrow()
    column = table.column(name).combine_chunks()
    if isinstance(column, pa.ChunkedArray):
        column = pa.concat_arrays(column.chunks)
    if isinstance(column.type, pa.BaseExtensionType):
        column = column.storage
    for size in (
        shape if shape != (1,) or is_list(column.type) else ()
    ):  # one value is stored without list
        if not is_list(column.type) or column.null_count:
            raise ValueError(f"'{path}' must hold lists in '{name}' (got {column.type})")
        if pa.types.is_fixed_size_list(column.type):
            has_size = column.type.list_size == size
        else:
            lengths = pa.compute.list_value_length(column).to_numpy(zero_copy_only=False)
            has_size = bool((lengths == size).all())
        if not has_size:
            raise ValueError(f"'{path}' must hold lists of {size} in '{name}' (got another length)")
        column = column.flatten()
    if not (pa.types.is_floating(column.type) or pa.types.is_integer(column.type)):
        raise ValueError(f"'{path}' must hold numbers in '{name}' (got {column.type})")
    values = column.to_numpy(zero_copy_only=False)  # null is NaN
    numbers = np.asarray(values, dtype=dtype)
    if dtype == "float32":
        warn_of_rounding(name, values, numbers)
    return numbers.reshape(len(table), *shape)


def read_tasks(root: Path) -> dict[int, str]:
    r"""Reads the names of the tasks of a data set by their indices."""
    path = existing_file(root / "meta" / "tasks.parquet", "a LeRobot data set must have its tasks")
    if num_rows(path) > LEROBOT_TASKS:
        raise ValueError(f"'{path}' must hold at most {LEROBOT_TASKS} tasks (got {num_rows(path)})")
    table = read_texts(path, "task_index", ("task", "__index_level_0__"))
    numbers = integer_column(path, table, "task_index").tolist()
    if len(set(numbers)) < len(numbers) or table.column("text").null_count:
        raise ValueError(
            f"'{path}' must hold each 'task_index' once, with a name (got duplicate indices or "
            "missing names)"
        )
    texts = (text for chunk in table.column("text").chunks for text in _decode_dictionary(chunk))
    return dict(zip(numbers, texts, strict=True))


def _decode_dictionary(chunk: Any) -> Iterator[str]:
    dictionary = chunk.dictionary.to_pylist()
    return (dictionary[number] for number in chunk.indices.to_pylist())
