r"""Rows of LeRobot data sets of anyone, checked: episodes, times, values and tasks."""

from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from torch_geometric_tactile._limits import LEROBOT_TASKS
from torch_geometric_tactile._texts import printable
from torch_geometric_tactile.io._lerobot_features import require_pyarrow
from torch_geometric_tactile.io._lerobot_files import is_list, num_rows, read_texts
from torch_geometric_tactile.io._lerobot_own import read_object

_Any = TypeVar("_Any")


def read_info(root: Path) -> dict[str, Any]:
    r"""Reads :obj:`meta/info.json` of a data set."""
    path = root / "meta" / "info.json"
    if not path.is_file():
        raise FileNotFoundError(f"'{path}' does not exist; give the folder of a LeRobot data set")
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
    found = np.median(np.diff(time)) if len(time) > 1 else 1 / fps
    if not 2 / 3 < found * fps < 3 / 2:
        raise ValueError(
            f"'{path}' must hold {fps:g} steps per second, as info.json says: 'timestamp' must "
            f"advance by {1 / fps:.4g} s (got {found:.4g})"
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


def row_values(path: Path, table: Any, name: str, shape: tuple[int, ...]) -> np.ndarray:
    r"""Returns a column of numbers in float32, with NaN where one is missing.

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
    return np.asarray(values, dtype=np.float32).reshape(len(table), *shape)


def read_tasks(root: Path) -> dict[int, str]:
    r"""Reads the tasks of a data set."""
    path = root / "meta" / "tasks.parquet"
    if not path.is_file():
        raise FileNotFoundError(f"'{path}' does not exist; a LeRobot data set must have its tasks")
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
