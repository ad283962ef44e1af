r"""Recordings from the episodes of a LeRobot data set."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from torch_geometric_tactile._checks import need
from torch_geometric_tactile._texts import printable, short_list
from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile.data import Recording
from torch_geometric_tactile.io._lerobot_content import (
    OwnContent,
    data_files,
    episodes_of,
    in_order,
    integers,
    read_info,
    read_own,
    read_tasks,
    row_values,
    step_times,
)
from torch_geometric_tactile.io._lerobot_steps import STATE, TACTILE, shape_of_names
from torch_geometric_tactile.io._lerobot_tables import read_numbers, require_pyarrow

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
    found = [one for path in paths for one in dataset.recordings(path, allow_large)]
    return in_order(root, info, found)


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
        for number, rows in episodes_of(path, table):
            yield number, self._recording(path, rows, number)

    def _recording(self, path: Path, rows: Any, number: int) -> Recording:
        time = step_times(path, rows, self.fps)
        own = self.own.of(number, len(rows), self._task(path, rows))
        values = {
            name: row_values(path, rows, name, one.written).reshape(len(rows), *one.shape)
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
        need(number in self.tasks, f"'{path}' must hold tasks of 'meta/tasks.parquet'", number)
        return self.tasks[number]


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
        names = short_list([*features], 20, printable, rest="")
        raise ValueError(f"'{root}' must have the feature '{name}' (got {names})")
    shape = feature.get("shape")
    whole = isinstance(shape, list) and all(type(n) is int and 0 < n < 2**31 for n in shape)
    if not whole or not 1 <= len(shape or ()) <= most:
        words = "one dimension" if most == 1 else "one or two dimensions"
        raise ValueError(f"'{name}' of '{root}' must have {words} (got {printable(shape)[:40]})")
    assert isinstance(shape, list)
    return tuple(shape)
