r"""Recordings from the episodes of a LeRobot data set."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from torch_geometric_tactile.data import Recording
from torch_geometric_tactile.io.lerobot_features import (
    STATE,
    TACTILE,
    require_pyarrow,
    shape_of_names,
)
from torch_geometric_tactile.io.lerobot_files import is_list, num_rows, read_numbers, read_texts
from torch_geometric_tactile.io.lerobot_own import OwnContent, read_object, read_own
from torch_geometric_tactile.texts import printable
from torch_geometric_tactile.typing import PathLike

_MOST_TASKS = 1_000_000
_INDICES = ("frame_index", "episode_index", "task_index")


def read_lerobot(
    root: PathLike,
    *,
    tactile: str = TACTILE,
    state: str = STATE,
    every_frame: bool = False,
    allow_large: bool = False,
) -> list[Recording]:
    r"""Reads the episodes of a LeRobot data set, of :func:`write_lerobot` or of others.

    The time is that of the data set, from 0, and the label is the task; sets of
    :func:`write_lerobot` have their own labels and metadata. Other features are left out.

    Args:
        root (str or PathLike): The folder.
        tactile (str): The feature of the readings, float :math:`(N \cdot C,)` with the names
            :obj:`taxel_0_x`, ..., :math:`(N, C)`, or :math:`(N,)`.
        state (str): The feature of the joint angles in radians, if there is one.
        every_frame (bool): Whether to read all frames at their own times instead of one each step,
            from a data set that was written with them.
        allow_large (bool): Whether to read files whose tables take more than 1 GiB and more than
            200 times their own size.

    Raises:
        FileNotFoundError: If it is no such folder.
        ImportError: If the extra :obj:`lerobot` is missing.
        OSError: If a file cannot be read.
        ValueError: If the version is not 3, the features are missing or no numbers, or the files do
            not fit together. The message names the folder or file.

    Examples:
        >>> import tempfile
        >>> import numpy as np
        >>> from torch_geometric_tactile.io import write_lerobot
        >>> recording = Recording(time=np.arange(20) / 100, tactile=np.ones((20, 4, 3)))
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     write_lerobot([recording, recording], f"{folder}/cups", fps=50, task="pick")
        ...     episodes = read_lerobot(f"{folder}/cups")
        >>> len(episodes), episodes[0].num_frames
        (2, 10)
    """
    require_pyarrow()
    root = Path(root)
    info = read_info(root)
    tasks = read_tasks(root)
    own = read_own(root, info["total_episodes"], [*tasks.values()])
    paths = data_files(root, info)
    features = info["features"]
    shape = _shape(root, features, tactile, own.shape)
    columns = {tactile: _Column(_sizes(root, features, tactile, 2), shape)}
    if state in features:
        sizes = _sizes(root, features, state, 1)
        columns[state] = _Column(sizes, sizes)
    if every_frame:
        times = f"{tactile}_frames_time"
        (rows,) = _sizes(root, features, times, 1)
        wide = {times: _Column((rows,), (rows,))}
        for name, one in columns.items():
            if name == tactile or f"{name}_frames" in features:
                wide[f"{name}_frames"] = _Column((rows * math.prod(one.shape),), (rows, *one.shape))
        columns = wide
    dataset = _Dataset(columns, tactile, state, info["fps"], tasks, own)
    found: dict[int, Recording] = {}
    for path in paths:
        for number, recording in dataset.recordings(path, allow_large):
            if number in found or not 0 <= number < info["total_episodes"]:
                raise ValueError(
                    f"'{path}' must hold each of {info['total_episodes']} episodes once "
                    f"(got episode {number})"
                )
            found[number] = recording
    if len(found) != info["total_episodes"]:
        raise ValueError(
            f"'{root}' must hold {info['total_episodes']} episodes, as its info.json says "
            f"(got {len(found)})"
        )
    return [found[number] for number in range(len(found))]


@dataclass
class _Column:
    # The shape of a row: as it is written, in lists, and as it is meant.
    written: tuple[int, ...]
    shape: tuple[int, ...]


@dataclass
class _Dataset:
    # What is known before the frames are read.
    columns: dict[str, _Column]
    tactile: str
    state: str
    fps: float
    tasks: dict[int, str]
    own: OwnContent

    def recordings(self, path: Path, allow_large: bool) -> Iterator[tuple[int, Recording]]:
        sizes = {name: math.prod(one.written) for name, one in self.columns.items()}
        single = dict.fromkeys(("timestamp", *_INDICES), 1)
        table = read_numbers(path, {**sizes, **single}, allow_large)
        episodes = integers(path, table, "episode_index")
        bounds = np.flatnonzero(np.diff(episodes)) + 1
        for start, stop in pairwise([0, *bounds.tolist(), len(episodes)]):
            if stop > start:
                number = int(episodes[start])
                yield number, self._recording(path, table.slice(start, stop - start), number)

    def _recording(self, path: Path, rows: Any, number: int) -> Recording:
        time = step_times(path, rows, self.fps)
        own = self.own.of(number, len(rows), self._task(path, rows))
        values = {
            name: _array(path, rows, name, one.written).reshape(len(rows), *one.shape)
            for name, one in self.columns.items()
        }
        meta = {**own["meta"], "rate": self.fps}
        if self.tactile not in values:  # all frames since the last step, with their times
            after = values[f"{self.tactile}_frames_time"]
            known = ~np.isnan(after)
            time = (time[:, None] + after)[known]
            values = {name.removesuffix("_frames"): value[known] for name, value in values.items()}
            meta = own["meta"]
        tactile = values[self.tactile]
        try:
            return Recording(
                time=time,
                tactile=tactile if tactile.ndim == 3 else tactile[:, :, None],
                joint=values.get(self.state),
                label=own.get("label"),
                meta=meta,
            )
        except ValueError as error:
            raise ValueError(f"'{path}' holds no consistent recording: {error}") from error

    def _task(self, path: Path, rows: Any) -> str:
        number = int(integers(path, rows, "task_index")[0])
        if number not in self.tasks:
            raise ValueError(f"'{path}' must hold tasks of 'meta/tasks.parquet' (got {number})")
        return self.tasks[number]


def read_info(root: Path) -> dict[str, Any]:
    r"""Reads :obj:`meta/info.json` of a data set.

    Args:
        root (pathlib.Path): The folder of the data set.

    Raises:
        FileNotFoundError: If there is none.
        ValueError: If the version is not 3, or something is missing.
    """
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
    r"""Returns the files of a data set with the frames.

    Args:
        root (pathlib.Path): The folder of the data set.
        info (dict): What :func:`read_info` returns.

    Raises:
        FileNotFoundError: If there are none.
        ValueError: If they declare another number of frames than the data set.
    """
    paths = sorted(root.glob("data/*/*.parquet"))
    if not paths:
        raise FileNotFoundError(f"'{root}' must hold 'data/chunk-.../file-....parquet' (got none)")
    total = sum(map(num_rows, paths))
    if total != info["total_frames"]:
        raise ValueError(
            f"'{root}' must hold {info['total_frames']} frames, as its info.json says (got {total})"
        )
    return paths


def _shape(
    root: Path, features: dict[str, Any], tactile: str, own: tuple[int, int] | None
) -> tuple[int, ...]:
    sizes = _sizes(root, features, tactile, 2)
    if tactile != TACTILE or len(sizes) == 2:
        own = None
    if own is not None and math.prod(own) != sizes[0]:
        raise ValueError(
            f"'{tactile}' of '{root}' must have {math.prod(own)} values, as its tactile.json says "
            f"(got {sizes[0]})"
        )
    named = shape_of_names(features[tactile].get("names")) if len(sizes) == 1 else None
    if named is not None and (math.prod(named) != sizes[0] or own not in (None, named)):
        raise ValueError(
            f"'{tactile}' of '{root}' must have the shape of its names, {named} "
            f"(got {own or sizes[0]})"
        )
    return own or named or sizes


def _sizes(root: Path, features: dict[str, Any], name: str, most: int) -> tuple[int, ...]:
    feature = features.get(name)
    if not isinstance(feature, dict):
        names = ", ".join(printable(name) for name in list(features)[:20])
        raise ValueError(f"'{root}' must have the feature '{name}' (got {names or 'none'})")
    shape = feature.get("shape")
    whole = isinstance(shape, list) and all(type(n) is int and 0 < n < 2**31 for n in shape)
    if not whole or not 1 <= len(shape or ()) <= most:
        words = "one dimension" if most == 1 else "one or two dimensions"
        raise ValueError(f"'{name}' of '{root}' must have {words} (got {printable(shape)[:40]})")
    assert isinstance(shape, list)
    return tuple(shape)


def integers(path: Path, table: Any, name: str) -> np.ndarray:
    r"""Returns a column of integers.

    Args:
        path (pathlib.Path): The file.
        table (pyarrow.Table): Rows of it.
        name (str): Name of the column.

    Raises:
        ValueError: If it has other values.
    """
    return _numbers(path, table, name, "iu", "integers")


def step_times(path: Path, table: Any, fps: float) -> np.ndarray:
    r"""Returns the times of the steps of an episode in seconds.

    Args:
        path (pathlib.Path): The file.
        table (pyarrow.Table): The rows of the episode.
        fps (float): Steps per second.

    Raises:
        ValueError: If they are not the steps from 0 on, or come at another rate.
    """
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
        return _array(path, table, name, (1,))[:, 0]
    values = column.combine_chunks().to_numpy(zero_copy_only=False)
    if values.dtype.kind not in kinds or column.null_count:
        raise ValueError(f"'{path}' must hold {words} in '{name}' (got {column.type})")
    return np.asarray(values)


def _array(path: Path, table: Any, name: str, shape: tuple[int, ...]) -> np.ndarray:
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
    r"""Reads the tasks of a data set.

    Args:
        root (pathlib.Path): The folder of the data set.

    Raises:
        FileNotFoundError: If there is no file of them.
        ValueError: If it holds no names, or a number twice.
    """
    path = root / "meta" / "tasks.parquet"
    if not path.is_file():
        raise FileNotFoundError(f"'{path}' does not exist; a LeRobot data set must have its tasks")
    if num_rows(path) > _MOST_TASKS:
        raise ValueError(f"'{path}' must hold at most {_MOST_TASKS} tasks (got {num_rows(path)})")
    table = read_texts(path, "task_index", ("task", "__index_level_0__"))
    numbers = integers(path, table, "task_index").tolist()
    if len(set(numbers)) < len(numbers) or table.column("text").null_count:
        raise ValueError(f"'{path}' must hold each 'task_index' once, with a name (got others)")
    texts = (text for chunk in table.column("text").chunks for text in _texts(chunk))
    return dict(zip(numbers, texts, strict=True))


def _texts(chunk: Any) -> Iterator[str]:
    known = chunk.dictionary.to_pylist()
    return (known[number] for number in chunk.indices.to_pylist())
