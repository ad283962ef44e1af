r"""Folders of LeRobot data sets, of anyone and checked: descriptions, tasks, episodes, values; and
``meta/tactile.json``, with what LeRobot has no place for.
"""

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from torch_geometric_tactile._checks import need
from torch_geometric_tactile._files import atomic_path, existing_file
from torch_geometric_tactile._limits import LEROBOT_TASKS
from torch_geometric_tactile._texts import printable, read_json
from torch_geometric_tactile.data import Recording
from torch_geometric_tactile.data._recording_arrays import warn_of_rounding
from torch_geometric_tactile.io._lerobot_steps import (
    EXTRA,
    FRAME_TIMES,
    TACTILE,
    TACTILE_FRAMES,
    ExtraSignal,
)
from torch_geometric_tactile.io._lerobot_tables import (
    is_list,
    num_rows,
    read_texts,
    require_pyarrow,
)

# Without it, `datasets` takes the files of `meta` for data.
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
_ADVICE = "remove it if another program changed the data set"
_MAX_DIMS = 8  # of the values of a further signal in a frame
# Between two steps, as lerobot's `tolerance_s`, beyond what float32 rounds.
_TIME_TOLERANCE = 1e-4  # seconds
_DTYPES = ("bool", *(f"{sign}int{n}" for sign in ("", "u") for n in (8, 16, 32, 64)))
_DTYPES += ("float16", "float32", "float64")
_Any = TypeVar("_Any")


def check_new_folder(root: Path) -> None:
    r"""Raises an error unless a folder is missing or empty."""
    if root.exists() and (not root.is_dir() or any(root.iterdir())):
        raise FileExistsError(f"'{root}' must be a new or empty folder (got one that is not)")


def check_alike(recordings: Sequence[Recording]) -> None:
    r"""Raises an error unless there are recordings with frames, of the same shapes and unit."""
    need(recordings, "'recordings' must hold at least one recording (got none)")
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


def write_json(path: Path, content: Any, **settings: Any) -> None:
    r"""Writes a JSON file."""
    _write_text(path, json.dumps(content, indent=4, **settings))


def write_description(root: Path, own: dict[str, Any], info: dict[str, Any]) -> None:
    r"""Writes what a data set holds. A folder without the last file is no data set."""
    write_json(root / _TACTILE_JSON, own, ensure_ascii=False)
    if not (root / "README.md").exists():
        _write_text(root / "README.md", _README)
    write_json(root / "meta/info.json", info, ensure_ascii=False)


def _write_text(path: Path, text: str) -> None:
    with atomic_path(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


@dataclass
class OwnContent:
    r"""The contents of a file."""

    path: Path
    shape: tuple[int, int] | None = None
    episodes: dict[int, dict[str, Any]] = field(default_factory=dict)
    extra: dict[str, ExtraSignal] = field(default_factory=dict)

    def of(self, number: int, length: int, task: str) -> dict[str, Any]:
        r"""Returns the label, metadata and annotations of an episode."""
        known = self.episodes.get(number)
        if known is None:
            return {"label": task, "meta": {"episode": number}}
        for key, value in {"length": length, "task": task}.items():
            if known.get(key) not in (None, value):
                raise ValueError(
                    f"'{self.path}' must have the {key} {printable(value)[:40]} of episode {number}"
                    f" (got {printable(known[key])[:40]}): {_ADVICE}"
                )
        return known


def own_content(
    recordings: Sequence[Recording],
    starts: Sequence[float],
    lengths: Sequence[int],
    tasks: Sequence[str],
    rows: int,
    extra: Mapping[str, ExtraSignal],
) -> dict[str, Any]:
    r"""Returns the contents of a new file, of recordings whose episodes start at some times by the
    clocks of the recordings.
    """
    shape = [recordings[0].num_taxels, recordings[0].num_channels]
    out: dict[str, Any] = {"version": 2, "feature": TACTILE, "shape": shape}
    if rows:
        frames = {"feature": TACTILE_FRAMES, "shape": [rows, *shape]}
        out["every_frame"] = {**frames, "time": FRAME_TIMES, "missing": "NaN, before the others"}
    if extra:
        out["extra"] = {
            name: {"feature": EXTRA + name, "shape": [*signal.shape], "dtype": signal.dtype}
            for name, signal in extra.items()
        }
    out["episodes"] = [
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
        for index, (recording, start, length, task) in enumerate(
            zip(recordings, starts, lengths, tasks, strict=True)
        )
    ]
    return out


def read_own(root: Path, num_episodes: int, tasks: Sequence[str]) -> OwnContent:
    r"""Reads the file of a data set, or nothing if there is none."""
    path = root / _TACTILE_JSON
    if not path.is_file():
        return OwnContent(path)
    content = read_object(path)
    version, episodes = content.get("version"), content.get("episodes")
    if version not in (1, 2):
        raise ValueError(f"'{path}' must have version 1 or 2 (got {printable(version)[:40]})")
    if not isinstance(episodes, list) or not all(
        isinstance(e, dict) and isinstance(e.get("meta"), dict) for e in episodes
    ):
        raise ValueError(f"'{path}' must hold 'episodes', each with 'meta' (got something else)")
    if version == 1:  # 0.2.0 wrote them by position, without tasks
        episodes = [{**episode, "episode_index": i} for i, episode in enumerate(episodes)]
        if len(tasks) > 1:  # not one task that was given for all
            episodes = [{**e, "task": task_of_label(e.get("label"))} for e in episodes]
    numbers = [episode.get("episode_index") for episode in episodes]
    whole = all(type(number) is int for number in numbers)
    if len(numbers) != num_episodes or not whole or sorted(numbers) != [*range(len(numbers))]:
        raise ValueError(
            f"'{path}' must hold each of {num_episodes} episodes once (got {len(numbers)}: "
            f"{printable(numbers)[:80]}): {_ADVICE}"
        )
    by_number = dict(zip(numbers, episodes, strict=True))
    shape = None if version == 1 else _shape(path, content)
    return OwnContent(path, shape, by_number, _extra(path, content.get("extra", {})))


def _extra(path: Path, content: Any) -> dict[str, ExtraSignal]:
    signals = content.items() if isinstance(content, dict) else [("", None)]
    out = {}
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
                f"'{path}' must hold in 'extra' a shape and a type of each further signal (got "
                f"{printable(signal)[:80]} for '{printable(name)[:40]}')"
            )
        out[name] = ExtraSignal(tuple(shape), str(dtype))
    return out


def _shape(path: Path, content: dict[str, Any]) -> tuple[int, int]:
    shape = content.get("shape")
    if isinstance(shape, list) and len(shape) == 2 and all(type(n) is int and n > 0 for n in shape):
        return (shape[0], shape[1])
    raise ValueError(
        f"'{path}' must hold 'shape', the numbers of taxels and channels "
        f"(got {printable(shape)[:40]})"
    )


def task_of_label(label: str | int | None) -> str:
    r"""Returns the task of a recording that is given none."""
    return "touch" if label is None else str(label)


def read_object(path: Path) -> dict[str, Any]:
    r"""Reads a JSON object."""
    try:
        content = read_json(path)
    except ValueError as error:
        raise ValueError(f"'{path}' cannot be read as JSON: {error}") from error
    if not isinstance(content, dict):
        raise ValueError(f"'{path}' must hold a JSON object (got {type(content).__name__})")
    return content


def read_info(root: Path) -> dict[str, Any]:
    r"""Reads :obj:`meta/info.json` of a data set."""
    path = existing_file(root / "meta" / "info.json", "give the folder of a LeRobot data set")
    info = read_object(path)
    version = info.get("codebase_version")
    if not isinstance(version, str) or not version.startswith("v3."):
        raise ValueError(
            f"'{root}' must be a LeRobot data set of version 3 (got {printable(version)}): convert "
            "it with lerobot's own script"
        )
    for key, kind in {
        "features": dict,
        "fps": int | float,
        "total_episodes": int,
        "total_frames": int,
    }.items():
        if not isinstance(info.get(key), kind) or isinstance(info[key], bool):
            raise ValueError(f"'{path}' must hold '{key}' (got {printable(info.get(key))[:40]})")
    if not 0 < info["fps"] < 1e6:
        raise ValueError(f"'{path}' must hold a positive 'fps' (got {info['fps']})")
    return info


def data_files(root: Path, info: dict[str, Any]) -> list[Path]:
    r"""Returns the files of a data set with the frames."""
    paths = sorted(root.glob("data/*/*.parquet"))
    if not paths:
        raise FileNotFoundError(f"'{root}' must hold 'data/chunk-.../file-....parquet' (got none)")
    total = sum(map(num_rows, paths))
    if total != info["total_frames"]:
        raise ValueError(
            f"'{root}' must hold {info['total_frames']} frames, as its info.json says (got {total})"
        )
    return paths


def episodes_of(path: Path, table: Any) -> Iterator[tuple[int, Any]]:
    r"""Yields the number and the rows of each episode."""
    numbers = integers(path, table, "episode_index")
    bounds = np.flatnonzero(np.diff(numbers)) + 1
    for start, stop in pairwise([0, *bounds.tolist(), len(numbers)]):
        if stop > start:
            yield int(numbers[start]), table.slice(start, stop - start)


def in_order(root: Path, info: dict[str, Any], found: list[tuple[int, _Any]]) -> list[_Any]:
    r"""Returns what was found of each episode, by their numbers."""
    numbers = sorted(number for number, _ in found)
    if len(numbers) != info["total_episodes"] or numbers != [*range(len(numbers))]:
        raise ValueError(
            f"'{root}' must hold each of {info['total_episodes']} episodes once, as its info.json "
            f"says (got {printable(numbers)[:80]})"
        )
    by_number = dict(found)
    return [by_number[number] for number in numbers]


def integers(path: Path, table: Any, name: str) -> np.ndarray:
    r"""Returns a column of integers."""
    return _numbers(path, table, name, "iu", "integers")


def step_times(path: Path, table: Any, fps: float) -> np.ndarray:
    r"""Returns the times of the steps of an episode in seconds."""
    index = integers(path, table, "frame_index")
    wrong = np.flatnonzero(index != np.arange(len(index)))
    if len(wrong):
        raise ValueError(
            f"'{path}' must hold an episode whole and in order: 'frame_index' must be {wrong[0]} "
            f"(got {index[wrong[0]]})"
        )
    time = _numbers(path, table, "timestamp", "iuf", "numbers").astype(np.float64)
    steps = index / fps
    if np.allclose(time, steps, rtol=1e-6, atol=1e-6):  # float32 of a clock's steps
        return steps
    tolerance = _TIME_TOLERANCE + np.spacing(np.abs(time).astype(np.float32))
    wrong = np.flatnonzero(~(np.abs(np.diff(time) - 1 / fps) <= tolerance[1:]))
    if len(wrong):
        step = int(wrong[0]) + 1
        raise ValueError(
            f"'{path}' must hold {fps:g} steps per second, as info.json says: 'timestamp' must "
            f"advance by {1 / fps:.4g} s (got {time[step]:.9g} s in step {step} after "
            f"{time[step - 1]:.9g} s): resample the episode, or write the steps of a gap as NaN"
        )
    return time


def _numbers(path: Path, table: Any, name: str, kinds: str, words: str) -> np.ndarray:
    column = table.column(name)
    if is_list(column.type):  # of one value
        return row_values(path, table, name, (1,))[:, 0]
    values = column.combine_chunks().to_numpy(zero_copy_only=False)
    if values.dtype.kind not in kinds or column.null_count:
        raise ValueError(f"'{path}' must hold {words} in '{name}' (got {column.type})")
    return np.asarray(values)


def row_values(
    path: Path, table: Any, name: str, shape: tuple[int, ...], dtype: str = "float32"
) -> np.ndarray:
    r"""Returns a column of numbers in a floating-point type, with NaN where one is missing.

    Shapes:
        - **output:** values :math:`(T, *)`
    """
    pa = require_pyarrow()
    column = table.column(name).combine_chunks()
    if isinstance(column, pa.ChunkedArray):
        column = pa.concat_arrays(column.chunks)
    if isinstance(column.type, pa.BaseExtensionType):
        column = column.storage
    for size in shape if shape != (1,) or is_list(column.type) else ():  # one value is no list
        if not is_list(column.type) or column.null_count:
            raise ValueError(f"'{path}' must hold lists in '{name}' (got {column.type})")
        if pa.types.is_fixed_size_list(column.type):
            same = column.type.list_size == size
        else:
            lengths = pa.compute.list_value_length(column).to_numpy(zero_copy_only=False)
            same = bool((lengths == size).all())
        if not same:
            raise ValueError(f"'{path}' must hold lists of {size} in '{name}' (got others)")
        column = column.flatten()
    if not (pa.types.is_floating(column.type) or pa.types.is_integer(column.type)):
        raise ValueError(f"'{path}' must hold numbers in '{name}' (got {column.type})")
    values = column.to_numpy(zero_copy_only=False)  # null is NaN
    numbers = np.asarray(values, dtype=dtype)
    if dtype == "float32":
        warn_of_rounding(name, values, numbers)
    return numbers.reshape(len(table), *shape)


def read_tasks(root: Path) -> dict[int, str]:
    r"""Reads the tasks of a data set."""
    path = existing_file(root / "meta" / "tasks.parquet", "a LeRobot data set must have its tasks")
    if num_rows(path) > LEROBOT_TASKS:
        raise ValueError(f"'{path}' must hold at most {LEROBOT_TASKS} tasks (got {num_rows(path)})")
    table = read_texts(path, "task_index", ("task", "__index_level_0__"))
    numbers = integers(path, table, "task_index").tolist()
    if len(set(numbers)) < len(numbers) or table.column("text").null_count:
        raise ValueError(f"'{path}' must hold each 'task_index' once, with a name (got others)")
    texts = (text for chunk in table.column("text").chunks for text in _texts(chunk))
    return dict(zip(numbers, texts, strict=True))


def _texts(chunk: Any) -> Iterator[str]:
    known = chunk.dictionary.to_pylist()
    return (known[number] for number in chunk.indices.to_pylist())
