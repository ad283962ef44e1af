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
from torch_geometric_tactile.io._lerobot_steps import (
    EXTRA,
    STATE,
    TACTILE,
    ExtraSignal,
    shape_of_names,
    shape_of_values,
)
from torch_geometric_tactile.io._lerobot_tables import read_numbers, require_pyarrow

# Above so many channels of a taxel a feature of two dimensions is a grid: no sensor has more.
_MAX_CHANNELS = 6
_TAXELS_FIRST, _SWAPPED = ("taxels", "channels"), ("channels", "taxels")
_AXES = {"taxel": "taxels", "taxels": "taxels", "axis": "channels", "axes": "channels"}
_AXES |= {"channel": "channels", "channels": "channels"}
_INDICES = ("frame_index", "episode_index", "task_index")


def read_lerobot(
    root: PathLike,
    *,
    tactile: str = TACTILE,
    state: str = STATE,
    num_channels: int | None = None,
    every_frame: bool = False,
    allow_large: bool = False,
) -> list[Recording]:
    r"""Reads the episodes of a LeRobot data set, of :func:`write_lerobot` or of others.

    The time is that of the data set, from 0, and the label is the task; sets of
    :func:`write_lerobot` have their own labels, metadata, annotations and further signals. Other
    features are left out.

    Args:
        root (str or PathLike): The folder.
        tactile (str): The feature of the readings, float :math:`(N \cdot C,)` with the names
            :obj:`taxel_0_x`, ..., :math:`(N, C)`, or :math:`(N,)`. Two dimensions of which the last
            is larger than 6 are a grid of rows and columns of taxels, row by row, with one channel.
        state (str): The feature of the joint angles in radians, if there is one.
        num_channels (int, optional): Number of channels of a taxel :math:`C`, if neither
            :obj:`meta/tactile.json` nor the names say it; the values of a step are then taxel by
            taxel, each with its channels.
        every_frame (bool): Whether to read all frames at their own times instead of one each step,
            from a data set that was written with them.
        allow_large (bool): Whether to read files whose tables take more than 1 GiB and more than
            200 times their own size.

    Raises:
        FileNotFoundError: If it is no such folder.
        ImportError: If the extra :obj:`lerobot` is missing.
        OSError: If a file cannot be read.
        ValueError: If the version is not 3, the features are missing or no numbers, their number is
            no multiple of the channels or of other channels than the files say, the times of two
            steps are not a step apart, or the files do not fit together. The message names the
            folder or file.

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
    if num_channels is not None and num_channels < 1:
        raise ValueError(f"'num_channels' must be at least 1 (got {num_channels})")
    shape = _shape(root, features, tactile, own.shape, num_channels)
    sizes = _sizes(root, features, tactile, 2)
    is_swapped = len(sizes) == 2 and _order_of_names(root, features, tactile) == _SWAPPED
    columns = {tactile: _Column(sizes, shape, is_swapped=is_swapped)}
    if state in features:
        sizes = _sizes(root, features, state, 1)
        columns[state] = _Column(sizes, sizes)
    extra = _extra_columns(root, features, own.extra, {tactile, state})
    columns |= extra
    if every_frame:
        times = f"{tactile}_frames_time"
        (rows,) = _sizes(root, features, times, 1)
        wide = {times: _Column((rows,), (rows,))}
        for name, one in columns.items():
            if name == tactile or f"{name}_frames" in features:
                size = rows * math.prod(one.shape)
                wide[f"{name}_frames"] = _Column((size,), (rows, *one.shape), one.dtype)
        columns = wide
    dataset = _Dataset(columns, tactile, state, extra, info["fps"], tasks, own)
    found = [one for path in paths for one in dataset.recordings(path, allow_large)]
    return in_order(root, info, found)


@dataclass
class _Column:
    # The shape of a row: as it is written, in lists, and as it is meant.
    written: tuple[int, ...]
    shape: tuple[int, ...]
    dtype: str = "float32"  # in the recording
    is_swapped: bool = False  # written with the channels before the taxels

    def values(self, path: Path, rows: Any, name: str) -> np.ndarray:
        dtype = "float32" if self.dtype == "float32" else "float64"
        values = row_values(path, rows, name, self.written, dtype)
        if self.is_swapped:
            values = values.reshape(len(rows), *self.written).swapaxes(1, 2)
        return values.reshape(len(rows), *self.shape)


@dataclass
class _Dataset:
    # What is known before the frames are read.
    columns: dict[str, _Column]
    tactile: str
    state: str
    extra: dict[str, _Column]
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
        values = {name: one.values(path, rows, name) for name, one in self.columns.items()}
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
                extra={
                    name.removeprefix(EXTRA): _restored(values[name], one.dtype)
                    for name, one in self.extra.items()
                    if name in values
                },
                annotations=own.get("annotations", ()),
            )
        except ValueError as error:
            raise ValueError(f"'{path}' holds no consistent recording: {error}") from error

    def _task(self, path: Path, rows: Any) -> str:
        number = int(integers(path, rows, "task_index")[0])
        need(number in self.tasks, f"'{path}' must hold tasks of 'meta/tasks.parquet'", number)
        return self.tasks[number]


def _shape(
    root: Path,
    features: dict[str, Any],
    tactile: str,
    own: tuple[int, int] | None,
    num_channels: int | None,
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
    order = _order_of_names(root, features, tactile) if len(sizes) == 2 else None
    if order is not None:
        named = (sizes[0], sizes[1]) if order == _TAXELS_FIRST else (sizes[1], sizes[0])
    shape = own or named
    total = math.prod(sizes)
    if num_channels is None:
        if shape is None and len(sizes) == 2 and sizes[1] > _MAX_CHANNELS:
            return (total,)  # a grid
        return shape or sizes
    if total % num_channels or (shape is not None and shape[1] != num_channels):
        raise ValueError(
            f"'num_channels' must be that of '{tactile}' of '{root}', of shape "
            f"{list(shape or sizes)} (got {num_channels})"
        )
    return (total // num_channels, num_channels)


def _order_of_names(root: Path, features: dict[str, Any], tactile: str) -> tuple[str, str] | None:
    # Which of two dimensions the names of a feature say are taxels and channels, if they do.
    names = features[tactile].get("names")
    if not isinstance(names, list) or len(names) != 2:
        return None
    order = [_AXES.get(name.lower()) if isinstance(name, str) else None for name in names]
    if order == [None, None]:
        return None
    pair = (order[0] or "", order[1] or "")
    if pair not in (_TAXELS_FIRST, _SWAPPED):
        raise ValueError(
            f"the names of '{tactile}' of '{root}' must be one of taxels and one of channels, as "
            f"['taxels', 'channels'] (got {printable(names)[:60]})"
        )
    return pair


def _extra_columns(
    root: Path,
    features: dict[str, Any],
    extra: dict[str, ExtraSignal],
    used: set[str],
) -> dict[str, _Column]:
    out = {}
    for name, feature in features.items():
        dtype = feature.get("dtype") if isinstance(feature, dict) else None
        signal = extra.get(name.removeprefix(EXTRA))
        is_frames = name.endswith("_frames") and name.removesuffix("_frames") in features
        if not name.startswith(EXTRA) or name in used or (is_frames and signal is None):
            continue
        if signal is None and dtype not in ("float32", "float64"):
            continue  # of another program
        sizes = _sizes(root, features, name, 2)
        if signal is None:
            shape = sizes
            if len(sizes) == 1:
                named = feature.get("names")
                shape = shape_of_values(name.removeprefix(EXTRA), named, sizes[0])
            signal = ExtraSignal(shape, str(dtype))
        if math.prod(signal.shape) != math.prod(sizes):
            raise ValueError(
                f"'{name}' of '{root}' must have {math.prod(signal.shape)} values, as its "
                f"tactile.json says (got {list(sizes)})"
            )
        out[name] = _Column(sizes, signal.shape, signal.dtype)
    return out


def _restored(values: np.ndarray, dtype: str) -> np.ndarray:
    # Integers and truth values stay floating-point numbers where one of them is missing.
    is_whole = np.dtype(dtype).kind == "f" or not np.isnan(values).any()
    return values.astype(dtype) if is_whole else values


def _sizes(root: Path, features: dict[str, Any], name: str, most: int) -> tuple[int, ...]:
    feature = features.get(name)
    if not isinstance(feature, dict):
        names = short_list([*features], 20, printable, ending="")
        raise ValueError(f"'{root}' must have the feature '{name}' (got {names})")
    shape = feature.get("shape")
    whole = isinstance(shape, list) and all(type(n) is int and 0 < n < 2**31 for n in shape)
    if not whole or not 1 <= len(shape or ()) <= most:
        words = "one dimension" if most == 1 else "one or two dimensions"
        raise ValueError(f"'{name}' of '{root}' must have {words} (got {printable(shape)[:40]})")
    assert isinstance(shape, list)
    return tuple(shape)
