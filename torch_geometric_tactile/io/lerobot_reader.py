r"""Reader of the episodes of a LeRobot data set."""

import logging
import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

import numpy as np

from torch_geometric_tactile._checks import Argument, ArgumentError, need, need_argument
from torch_geometric_tactile._texts import printable, short_list
from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile.data import Recording
from torch_geometric_tactile.io._lerobot_content import (
    TactileContent,
    data_files,
    integer_column,
    read_info,
    read_tactile_content,
    read_tasks,
    row_values,
    sort_episodes,
    split_episodes,
    step_times,
)
from torch_geometric_tactile.io._lerobot_steps import (
    ACTION,
    EXTRA,
    STATE,
    TACTILE,
    ExtraSignal,
    feature_value_names,
    has_frame,
    names_to_shape,
    steps_to_frames,
    value_names_to_shape,
)
from torch_geometric_tactile.io._lerobot_tables import read_numbers, require_pyarrow

# Channels of a taxel. A two-dimensional feature with a larger last dimension is a grid of taxels.
_MAX_CHANNELS = 6
_TAXELS_FIRST, _CHANNELS_FIRST = ("taxels", "channels"), ("channels", "taxels")
_AXIS_OF_NAME = {"taxel": "taxels", "taxels": "taxels", "axis": "channels", "axes": "channels"}
_AXIS_OF_NAME |= {"channel": "channels", "channels": "channels"}
_logger = logging.getLogger(__name__)
_INDICES = ("frame_index", "episode_index", "task_index")


def read_lerobot(
    root: PathLike,
    *,
    tactile: str | Sequence[str] | None = None,
    state: str = STATE,
    num_channels: int | None = None,
    every_frame: bool = False,
    allow_large: bool = False,
    action: str = ACTION,
) -> list[Recording]:
    r"""Reads the episodes of a LeRobot data set that any program wrote.

    Times start at 0, as in the data set, and the label is the task. Data sets written by
    :func:`write_lerobot` also have labels, metadata, annotations and further signals. Numbers that
    :obj:`fill` wrote for missing readings are returned as readings. Other features are left out.

    Args:
        root (str or PathLike): The folder.
        tactile (str or sequence of str, optional): The feature of the readings, float
            :math:`(N \cdot C,)` with the names :obj:`taxel_0_x`, ..., :math:`(N, C)`, or
            :math:`(N,)`. A feature of two dimensions is a grid of taxels with one channel, row by
            row, if the last dimension is above 6. The taxels of several features are joined in this
            order, and :obj:`meta["tactile_features"]` has the number of taxels of each. In a name,
            :obj:`*` matches any characters: :obj:`"observation.tactile.*"` selects all such
            features in the order of :obj:`info.json`. Defaults to the feature in
            :obj:`meta/tactile.json`, or :obj:`observation.tactile`.
        state (str): The feature of the joint angles in radians. It may be missing. If it also holds
            the readings, these are the columns that :obj:`meta/tactile.json` declares, or the
            columns at its end that are named after taxels.
        num_channels (int, optional): Number of channels of a taxel :math:`C`, if neither
            :obj:`meta/tactile.json` nor the names give it. The values of a step are then the
            channels of the first taxel, of the second taxel, and so on.
        every_frame (bool): Whether to read all frames at their times instead of one per step, from
            a data set that was written with :obj:`every_frame`.
        allow_large (bool): Whether to read files whose tables take more than 1 GiB and more than
            200 times the size of the file.
        action (str): The feature of the actions :math:`(A,)`. It may be missing. With
            :obj:`every_frame`, a frame has the action of the last step at or before it.

    Raises:
        FileNotFoundError: If there is no such data set.
        ImportError: If the extra :obj:`lerobot` is missing.
        OSError: If a file cannot be read.
        ValueError: If the version is not 3, the features are missing or not numbers, their size
            does not match the number of channels, several features have different numbers of
            channels, consecutive times are not one step apart, or the files contradict each other.
            The message names the folder or file.

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
    content = read_tactile_content(root, info["total_episodes"], [*tasks.values()])
    paths = data_files(root, info)
    features = info["features"]
    if num_channels is not None and num_channels < 1:
        raise ValueError(f"'num_channels' must be at least 1 (got {num_channels})")
    names = _tactile_features(
        root, features, content.feature if tactile is None else tactile, state, every_frame
    )
    touch = _touch_in_state(root, features, state, content) if names == [state] else None
    if touch is None:
        columns = _separate_columns(root, features, names, state, content, num_channels)
    else:
        columns = _joined_columns(root, features, state, touch, content, num_channels)
        names = [TACTILE]
    extra = _extra_columns(root, features, content.extra, {*names, state})
    columns |= extra
    if every_frame:
        columns = _frame_columns(root, features, names[0], columns)
    action_column, action_names = _action_column(root, features, action)
    if action_column is not None:
        need(
            action not in {*names, state, *columns},
            "'action' must not be the feature of readings, state or further signals",
            action,
        )
        columns[action] = action_column
    dataset = _Dataset(
        columns,
        names,
        state,
        extra,
        info["fps"],
        tasks,
        content,
        action=action,
        action_names=action_names,
    )
    episodes = [episode for path in paths for episode in dataset.recordings(path, allow_large)]
    return [*sort_episodes(root, info, episodes).values()]


@dataclass
class _Column:
    # The shape of a row in the file (lists), and in the recording.
    stored: tuple[int, ...]
    shape: tuple[int, ...]
    dtype: str = "float32"  # in the recording
    is_swapped: bool = False  # stored with the channels before the taxels
    source: str | None = None  # the feature, if it holds other values too
    part: slice | None = None  # the values in it
    is_outside: bool = False  # whether to select the values outside of this part instead

    @property
    def num_channels(self) -> int:
        # Of a taxel. A list of taxels has one channel.
        return self.shape[1] if len(self.shape) > 1 else 1

    def values(self, path: Path, rows: Any, name: str) -> np.ndarray:
        dtype = "float32" if self.dtype == "float32" else "float64"
        values = row_values(path, rows, self.source or name, self.stored, dtype)
        if self.part is not None:
            is_inside = np.zeros(values.shape[1], dtype=bool)
            is_inside[self.part] = True
            values = values[:, is_inside ^ self.is_outside]
        if self.is_swapped:
            values = values.reshape(len(rows), *self.stored).swapaxes(1, 2)
        return values.reshape(len(rows), *self.shape)


@dataclass
class _Dataset:
    # The columns to read, and the descriptions from the other files.
    columns: dict[str, _Column]
    tactile: list[str]
    state: str
    extra: dict[str, _Column]
    fps: float
    tasks: dict[int, str]
    content: TactileContent
    action: str
    action_names: list[str] | None

    def recordings(self, path: Path, allow_large: bool) -> Iterator[tuple[int, Recording]]:
        sizes = {c.source or name: math.prod(c.stored) for name, c in self.columns.items()}
        single = dict.fromkeys(("timestamp", *_INDICES), 1)
        table = read_numbers(path, {**sizes, **single}, allow_large)
        for number, rows in split_episodes(path, table):
            yield number, self._recording(path, rows, number)

    def _recording(self, path: Path, rows: Any, number: int) -> Recording:
        time = step_times(path, rows, self.fps)
        episode = self.content.episode(number, len(rows), self._find_task(path, rows))
        values = {name: column.values(path, rows, name) for name, column in self.columns.items()}
        meta = {**episode["meta"], "rate": self.fps}
        action = values.pop(self.action, None)
        if len(self.tactile) > 1:
            meta["tactile_features"] = {n: self.columns[n].shape[0] for n in self.tactile}
        if self.tactile[0] not in values:  # all frames since the previous step, with their times
            frame_times = values[f"{self.tactile[0]}_frames_time"]
            is_stored = has_frame(frame_times, self.fps)
            steps, time = time, (time[:, None] + frame_times)[is_stored]
            values = {
                name.removesuffix("_frames"): value[is_stored] for name, value in values.items()
            }
            meta = dict(episode["meta"])
            if action is not None:
                last = steps_to_frames(steps, time, self.fps)
                action = np.where(last[:, None] < 0, np.float32(np.nan), action[last])
        if self.action_names is not None:
            meta.setdefault("action_names", self.action_names)
        tactile = [values[name] for name in self.tactile]
        try:
            return Recording(
                time=time,
                tactile=np.concatenate([v if v.ndim == 3 else v[:, :, None] for v in tactile], 1),
                joint=values.get(self.state),
                label=episode.get("label"),
                meta=meta,
                extra={
                    name.removeprefix(EXTRA): _restore_dtype(values[name], column.dtype)
                    for name, column in self.extra.items()
                    if name in values
                },
                annotations=episode.get("annotations", ()),
                action=action,
            )
        except ValueError as error:
            raise ValueError(f"'{path}' does not hold a consistent recording: {error}") from error

    def _find_task(self, path: Path, rows: Any) -> str:
        number = int(integer_column(path, rows, "task_index")[0])
        need(number in self.tasks, f"'{path}' must refer to tasks in 'meta/tasks.parquet'", number)
        return self.tasks[number]


def _tactile_features(
    root: Path,
    features: dict[str, Any],
    tactile: str | Sequence[str],
    state: str,
    every_frame: bool,
) -> list[str]:
    # The names of the features of the readings, without wildcards.
    patterns = [tactile] if isinstance(tactile, str) else [*tactile]
    need_argument(patterns, "tactile", "must name at least one feature", "none")
    names: list[str] = []
    for pattern in patterns:
        if pattern in features or "*" not in pattern:
            names.append(pattern)
            continue
        # With `every_frame`, the frames of a feature and their times are stored beside it.
        stored_frames = {f"{name}{end}" for name in features for end in ("_frames", "_frames_time")}
        matches = [n for n in features if fnmatchcase(n, pattern) and n not in stored_frames]
        if not matches:
            raise _missing_feature(root, features, pattern)
        names += matches
    repeated = next((name for name in names if names.count(name) > 1), None)
    need_argument(repeated is None, "tactile", "must name each feature once", repeated)
    if len(names) > 1:
        message = "must not include the joint angles"
        need_argument(state not in names, "tactile", message, state)
        need_argument(
            not every_frame, "tactile", "must be one feature with every_frame", len(names)
        )
    return names


def _taxel_shape(
    root: Path,
    features: dict[str, Any],
    tactile: str,
    stated_shape: tuple[int, int] | None,
    num_channels: int | None,
) -> tuple[int, ...]:
    sizes = _feature_sizes(root, features, tactile, 2)
    if len(sizes) == 2:
        stated_shape = None
    if stated_shape is not None and math.prod(stated_shape) != sizes[0]:
        raise ValueError(
            f"'{tactile}' of '{root}' must have {math.prod(stated_shape)} values, as declared in "
            f"its tactile.json (got {sizes[0]})"
        )
    named_shape = names_to_shape(features[tactile].get("names")) if len(sizes) == 1 else None
    if named_shape is not None and (
        math.prod(named_shape) != sizes[0] or stated_shape not in (None, named_shape)
    ):
        raise ValueError(
            f"'{tactile}' of '{root}' must have the shape of its names, {named_shape} "
            f"(got {stated_shape or sizes[0]})"
        )
    axis_order = _axis_order(root, features, tactile) if len(sizes) == 2 else None
    if axis_order is not None:
        named_shape = (sizes[0], sizes[1]) if axis_order == _TAXELS_FIRST else (sizes[1], sizes[0])
    shape = stated_shape or named_shape
    total = math.prod(sizes)
    if num_channels is None:
        if shape is None and len(sizes) == 2 and sizes[1] > _MAX_CHANNELS:
            return (total,)  # a grid
        return shape or sizes
    if total % num_channels or (shape is not None and shape[1] != num_channels):
        raise ValueError(
            f"'num_channels' must match '{tactile}' of '{root}', which has shape "
            f"{list(shape or sizes)} (got {num_channels})"
        )
    return (total // num_channels, num_channels)


def _separate_columns(
    root: Path,
    features: dict[str, Any],
    tactile: Sequence[str],
    state: str,
    content: TactileContent,
    num_channels: int | None,
) -> dict[str, _Column]:
    columns = {}
    for name in tactile:
        stated_shape = content.shape if name == content.feature else None
        shape = _taxel_shape(root, features, name, stated_shape, num_channels)
        sizes = _feature_sizes(root, features, name, 2)
        is_swapped = len(sizes) == 2 and _axis_order(root, features, name) == _CHANNELS_FIRST
        columns[name] = _Column(sizes, shape, is_swapped=is_swapped)
    first, first_channels = tactile[0], columns[tactile[0]].num_channels
    for name, column in columns.items():
        if column.num_channels != first_channels:
            raise ArgumentError(
                f"'{first}' and '{name}' of '{root}' must have the same number of channels to be "
                f"one recording (got {first_channels} and {column.num_channels}): name one of them "
                "in ",
                *(Argument("tactile"), ", or give ", Argument("num_channels"), " if it is wrong"),
            )
    if state in features:
        sizes = _feature_sizes(root, features, state, 1)
        columns[state] = _Column(sizes, sizes)
    return columns


def _frame_columns(
    root: Path, features: dict[str, Any], tactile: str, columns: dict[str, _Column]
) -> dict[str, _Column]:
    # The columns of all frames since the previous step, and of their times.
    times_name = f"{tactile}_frames_time"
    (rows,) = _feature_sizes(root, features, times_name, 1)
    frame_columns = {times_name: _Column((rows,), (rows,))}
    for name, column in columns.items():
        if name == tactile or f"{name}_frames" in features:
            size = rows * math.prod(column.shape)
            frame_columns[f"{name}_frames"] = _Column((size,), (rows, *column.shape), column.dtype)
    return frame_columns


def _joined_columns(
    root: Path,
    features: dict[str, Any],
    state: str,
    touch: slice,
    content: TactileContent,
    num_channels: int | None,
) -> dict[str, _Column]:
    # Readings and joint angles that are one feature.
    described = {
        "shape": [touch.stop - touch.start],
        "names": _value_names(root, features, state)[touch],
    }
    stated_shape = content.shape if state == content.feature else None
    shape = _taxel_shape(root, {state: described}, state, stated_shape, num_channels)
    sizes = _feature_sizes(root, features, state, 1)
    columns = {TACTILE: _Column(sizes, shape, source=state, part=touch)}
    num_joints = sizes[0] - math.prod(shape)
    if num_joints:
        columns[state] = _Column(sizes, (num_joints,), source=state, part=touch, is_outside=True)
    return columns


def _touch_in_state(
    root: Path, features: dict[str, Any], state: str, content: TactileContent
) -> slice | None:
    # The readings in the feature of the state, from tactile.json or from the names of taxels.
    if state not in features:
        return None
    (size,) = _feature_sizes(root, features, state, 1)
    if content.feature == state and content.columns is not None:
        first, end = content.columns
        if end > size:
            raise ValueError(
                f"'{state}' of '{root}' must have {end} values, as declared in its tactile.json "
                f"(got {size})"
            )
        return slice(first, end)
    names = _value_names(root, features, state)
    first = next((i for i, name in enumerate(names) if name.startswith("taxel_0_")), size)
    return slice(first, size) if names_to_shape(names[first:]) is not None else None


def _value_names(root: Path, features: dict[str, Any], name: str) -> list[str]:
    (size,) = _feature_sizes(root, features, name, 1)
    return feature_value_names(features[name].get("names"), size) or []


def _action_column(
    root: Path, features: dict[str, Any], action: str
) -> tuple[_Column | None, list[str] | None]:
    # The column of the actions, and their names unless they are only numbered.
    feature = features.get(action)
    if not isinstance(feature, dict):
        return None, None
    shape, dtype = feature.get("shape"), feature.get("dtype")
    is_flat = isinstance(shape, list) and len(shape) == 1
    if not is_flat or not re.fullmatch(r"float(32|64)|u?int(8|16|32|64)", str(dtype)):
        _logger.warning(
            "'%s': left out '%s', which is not a list of numbers (%s %s)",
            root,
            printable(action),
            printable(dtype)[:40],
            printable(shape)[:40],
        )
        return None, None
    sizes = _feature_sizes(root, features, action, 1)
    names = feature_value_names(feature.get("names"), sizes[0])
    is_numbered = names == [f"{ACTION}_{i}" for i in range(len(names or ()))]
    return _Column(sizes, sizes), None if is_numbered else names


def _axis_order(root: Path, features: dict[str, Any], tactile: str) -> tuple[str, str] | None:
    # The order of taxels and channels from the names of two dimensions, or None for other names.
    names = features[tactile].get("names")
    if not isinstance(names, list) or len(names) != 2:
        return None
    axes = [_AXIS_OF_NAME.get(name.lower()) if isinstance(name, str) else None for name in names]
    if axes == [None, None]:
        return None
    axis_order = (axes[0] or "", axes[1] or "")
    if axis_order not in (_TAXELS_FIRST, _CHANNELS_FIRST):
        raise ValueError(
            f"the names of '{tactile}' of '{root}' must name taxels and channels, as in "
            f"['taxels', 'channels'] (got {printable(names)[:60]})"
        )
    return axis_order


def _extra_columns(
    root: Path,
    features: dict[str, Any],
    extra: dict[str, ExtraSignal],
    used: set[str],
) -> dict[str, _Column]:
    columns = {}
    for name, feature in features.items():
        dtype = feature.get("dtype") if isinstance(feature, dict) else None
        signal = extra.get(name.removeprefix(EXTRA))
        is_frames = name.endswith("_frames") and name.removesuffix("_frames") in features
        if not name.startswith(EXTRA) or name in used or (is_frames and signal is None):
            continue
        if signal is None and dtype not in ("float32", "float64"):
            continue  # of another program, not floating-point
        sizes = _feature_sizes(root, features, name, 2)
        if signal is None:
            shape = sizes
            if len(sizes) == 1:
                names = feature.get("names")
                shape = value_names_to_shape(name.removeprefix(EXTRA), names, sizes[0])
            signal = ExtraSignal(shape, str(dtype))
        if math.prod(signal.shape) != math.prod(sizes):
            raise ValueError(
                f"'{name}' of '{root}' must have {math.prod(signal.shape)} values, as declared in "
                f"its tactile.json (got {list(sizes)})"
            )
        columns[name] = _Column(sizes, signal.shape, signal.dtype)
    return columns


def _restore_dtype(values: np.ndarray, dtype: str) -> np.ndarray:
    # Integers and truth values stay floating-point numbers if one of them is missing.
    is_complete = np.dtype(dtype).kind == "f" or not np.isnan(values).any()
    return values.astype(dtype) if is_complete else values


def _feature_sizes(
    root: Path, features: dict[str, Any], name: str, max_dims: int
) -> tuple[int, ...]:
    feature = features.get(name)
    if not isinstance(feature, dict):
        raise _missing_feature(root, features, name)
    shape = feature.get("shape")
    is_shape = isinstance(shape, list) and all(type(n) is int and 0 < n < 2**31 for n in shape)
    if not is_shape or not 1 <= len(shape or ()) <= max_dims:
        expected = "one dimension" if max_dims == 1 else "one or two dimensions"
        raise ValueError(f"'{name}' of '{root}' must have {expected} (got {printable(shape)[:40]})")
    assert isinstance(shape, list)
    return tuple(shape)


def _missing_feature(root: Path, features: dict[str, Any], name: str) -> ValueError:
    names = short_list([*features], 20, printable, ending="")
    message = f"'{root}' must have the feature '{name}' (got {names})"
    if not any(feature.startswith(f"{name}.") for feature in features):
        return ValueError(message)
    return ArgumentError(f"{message}: for all of '{name}.*', pass this as ", Argument("tactile"))
