r"""Features of touch in LeRobot data sets, their values at the steps of a regular clock, and their
statistics without missing readings.
"""

import logging
import math
import re
import warnings
from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any, Literal, NamedTuple

import numpy as np

from torch_geometric_tactile.data import Recording, measure_rate
from torch_geometric_tactile.io._csv_frames import signal_names

TACTILE, STATE, ACTION = "observation.tactile", "observation.state", "action"
EXTRA = "observation.extra."  # followed by the name of a further signal
STATE_FRAMES = f"{STATE}_frames"
# The time of unused rows of frames with `fill`, in steps: before all frames of a step, which are at
# most one step old.
_UNUSED_ROW_STEPS = -2.0
INDICES = ("frame_index", "episode_index", "index", "task_index")
# Steps. A step that differs from a frame only by rounding (as in times since 1970) gets that frame.
_STEP_TOLERANCE = 1e-3
_MAX_FLOAT32 = float(np.finfo(np.float32).max)
_logger = logging.getLogger(__name__)
QUANTILES = {"q01": 0.01, "q10": 0.10, "q50": 0.50, "q90": 0.90, "q99": 0.99}

Stats = dict[str, np.ndarray]


def frames_feature(key: str) -> str:
    r"""Returns the name of the feature with all frames since the previous step, for a feature of
    the readings. Frames have a separate feature if the readings are joined to the state.

    Examples:
        >>> frames_feature("observation.skin"), frames_feature("observation.state")
        ('observation.skin_frames', 'observation.tactile_frames')
    """
    return f"{TACTILE if key == STATE else key}_frames"


def frame_times_feature(key: str) -> str:
    r"""Returns the name of the feature with the times of these frames."""
    return f"{frames_feature(key)}_time"


def has_frame(times: np.ndarray, fps: float) -> np.ndarray:
    r"""Returns whether a row of frames holds a frame, from its time in seconds after the step.

    Examples:
        >>> has_frame(np.array([np.nan, -0.2, -0.1, 0.0]), fps=10).tolist()
        [False, False, True, True]
    """
    # Halfway between the oldest frame of a step and an unused row. NaN is not above it either.
    return np.asarray(times * fps > (_UNUSED_ROW_STEPS - 1) / 2)


def check_key_and_fill(key: Any, fill: Any) -> None:
    r"""Raises an error if the feature of the readings or the fill value is invalid."""
    if (
        not isinstance(key, str)
        or not re.fullmatch(r"observation\.[^/\s]+", key)
        or key.startswith(EXTRA)
        or key.endswith(("_frames", "_frames_time"))
    ):
        raise ValueError(
            "'key' must be 'observation.tactile', 'observation.environment_state', "
            "'observation.state' or another name after 'observation.', without '/', not after "
            f"'observation.extra.' and without '_frames' at its end (got {key!r:.80})"
        )
    is_number = isinstance(fill, int | float) and not isinstance(fill, bool)
    if fill is not None and not (is_number and abs(fill) <= _MAX_FLOAT32):
        raise ValueError(f"'fill' must be a finite number, or None for NaN (got {fill!r:.80})")


def names_to_shape(names: Any) -> tuple[int, int] | None:
    r"""Returns the numbers of taxels and channels from column names of a wide CSV file, or
    :obj:`None` for other names.

    Examples:
        >>> names_to_shape(["taxel_0_x", "taxel_0_y", "taxel_1_x", "taxel_1_y"])
        (2, 2)
    """
    if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
        return None
    num_channels = sum(name.startswith("taxel_0_") for name in names)
    if not num_channels or len(names) % num_channels:
        return None
    shape = (len(names) // num_channels, num_channels)
    return shape if names == [*signal_names(*shape)] else None


def feature_value_names(names: Any, size: int) -> list[str] | None:
    r"""Returns the names in the description of a one-dimensional feature, or :obj:`None` unless
    there is a name for each value. Earlier versions of LeRobot store them in an object.

    Examples:
        >>> feature_value_names({"motors": ["wrist", "gripper"]}, 2)
        ['wrist', 'gripper']
    """
    if isinstance(names, dict) and len(names) == 1:
        (names,) = names.values()
    is_list = isinstance(names, list) and all(isinstance(name, str) for name in names)
    return [*names] if is_list and len(names) == size else None


def value_names(name: str, shape: tuple[int, ...]) -> list[str]:
    r"""Returns the names of the values of a multi-dimensional signal.

    Examples:
        >>> value_names("pac", (1, 3))
        ['pac_0_0', 'pac_0_1', 'pac_0_2']
    """
    return ["_".join([name, *map(str, index)]) for index in np.ndindex(shape)]


def value_names_to_shape(name: str, names: Any, size: int) -> tuple[int, ...]:
    r"""Returns the shape of a signal from the names of its values (see :func:`value_names`), or the
    shape of a list for other names.

    Examples:
        >>> value_names_to_shape("pac", ["pac_0_0", "pac_0_1", "pac_0_2"], 3)
        (1, 3)
    """
    if isinstance(names, list) and len(names) == size:
        match = re.fullmatch(r"((?:_[0-9]{1,9}){2,8})", str(names[-1]).removeprefix(name))
        shape = tuple(int(n) + 1 for n in match[1].split("_")[1:]) if match else ()
        if math.prod(shape) == size and names == value_names(name, shape):
            return shape
    return (size,) if size > 1 else ()


class ExtraSignal(NamedTuple):
    r"""A further signal: the shape of its values in a frame, and their type in the recordings."""

    shape: tuple[int, ...]
    dtype: str

    @property
    def stored_dtype(self) -> str:
        r"""The floating-point type of the feature. It represents all values of the signal, and NaN
        for missing values.
        """
        return "float32" if np.can_cast(self.dtype, np.float32) else "float64"


def extra_signals(recordings: Sequence[Recording]) -> dict[str, ExtraSignal]:
    r"""Returns the further signals that can be features: numbers that float64 represents exactly,
    with the same shape in all recordings.
    """
    signals = {}
    for name in recordings[0].extra:
        values = [recording.extra[name] for recording in recordings if name in recording.extra]
        shapes = {value.shape[1:] for value in values}
        if (
            len(values) == len(recordings)
            and len(shapes) == 1
            and all(value.dtype.kind in "biuf" and _fits_float64(value) for value in values)
        ):
            signals[name] = ExtraSignal(shapes.pop(), np.result_type(*values).name)
    return signals


def warn_of_unsupported_signals(
    path: Any, recordings: Sequence[Recording], extra: Mapping[str, Any]
) -> None:
    r"""Logs a warning with the signals of recordings that a data set cannot store."""
    names = [name for recording in recordings for name in recording.privileged]
    unsupported = {f"privileged {name!r}" for name in names}
    names = [name for recording in recordings for name in recording.extra]
    unsupported |= {f"extra {name!r}" for name in names if name not in extra}
    if unsupported:
        _logger.warning(
            "'%s' is a LeRobot data set and cannot store %s (signals that are not numbers of the "
            "same shape in all recordings, or known only in simulation)",
            path,
            ", ".join(sorted(unsupported)),
        )


def _fits_float64(values: np.ndarray) -> bool:
    if values.dtype.kind not in "iu" or values.dtype.itemsize < 8:
        return True
    return not values.size or max(-int(values.min()), int(values.max())) <= 2**53


def describe_feature(
    size: int, names: list[str] | None = None, dtype: str = "float32"
) -> dict[str, Any]:
    r"""Returns the description of a feature of one dimension for ``info.json``."""
    return {"dtype": dtype, "shape": [size], "names": names}


def touch_features(
    recording: Recording,
    rows: int,
    extra: Mapping[str, ExtraSignal],
    key: str = TACTILE,
    state_names: Sequence[str] = (),
) -> dict[str, Any]:
    r"""Returns the descriptions of the features of readings and further signals. The readings
    follow the values named :obj:`state_names`.
    """
    shape = (recording.num_taxels, recording.num_channels)
    touch_names = [*state_names, *signal_names(*shape)]
    features = {key: describe_feature(len(touch_names), touch_names)}
    if rows:
        features[frames_feature(key)] = describe_feature(rows * shape[0] * shape[1])
        features[frame_times_feature(key)] = describe_feature(rows)
    for name, signal in extra.items():
        size = math.prod(signal.shape)
        names = value_names(name, signal.shape) if len(signal.shape) > 1 else None
        features[EXTRA + name] = describe_feature(size, names, dtype=signal.stored_dtype)
        if rows:
            features[f"{EXTRA}{name}_frames"] = describe_feature(
                rows * size, dtype=signal.stored_dtype
            )
    return features


def regular_steps(time: np.ndarray, fps: float, cover_last: bool = False) -> np.ndarray:
    r"""Returns the times of a regular clock in seconds after the first frame. With
    :obj:`cover_last`, the last step is at or after the last frame.
    """
    steps = (time[-1] - time[0]) * fps
    num_intervals = (
        math.ceil(steps - _STEP_TOLERANCE) if cover_last else math.floor(steps + _STEP_TOLERANCE)
    )
    return np.arange(num_intervals + 1) / fps


def steps_to_frames(
    time: np.ndarray, steps: np.ndarray, fps: float, nearest: bool = False
) -> np.ndarray:
    r"""Returns the index of the frame of each step, or -1 for steps before the first frame."""
    last = np.searchsorted(time, steps + _STEP_TOLERANCE / fps, side="right") - 1
    if not nearest:
        return last
    after = np.minimum(last + 1, len(time) - 1)
    return np.where(time[after] - steps < steps - time[last], after, last)


def max_step_distance(time: np.ndarray, fps: float, max_gap: float | None) -> float:
    r"""Returns the largest allowed time between a step and its frame in seconds.

    Args:
        time (numpy.ndarray): Time of each frame in seconds :math:`(T,)`.
        fps (float): Steps per second. A time of one step is always allowed.
        max_gap (float, optional): The longest time in seconds that is not a gap. Defaults to five
            times the median time between frames.
    """
    if max_gap is None:
        max_gap = measure_rate(time).max_gap if len(time) > 1 else 0.0
    return max(max_gap, 1 / fps) + _STEP_TOLERANCE / fps


def frames_near_steps(
    time: np.ndarray, steps: np.ndarray, fps: float, nearest: bool, max_gap: float | None
) -> np.ndarray:
    r"""Returns the index of the frame of each step, or -1 for steps in a gap or before the first
    frame.

    Shapes:
        - **output:** indices :math:`(S,)`
    """
    frames = steps_to_frames(time, steps, fps, nearest)
    is_far = np.abs(steps - time[frames]) > max_step_distance(time, fps, max_gap)
    return np.where(is_far, -1, frames)


def check_gaps(
    number: int,
    time: np.ndarray,
    steps: np.ndarray,
    fps: float,
    nearest: bool,
    gaps: Literal["nan", "error"],
    max_gap: float | None,
    fill: float | None = None,
) -> None:
    r"""Logs a warning if steps of a recording are in a gap and have no reading. With
    :obj:`gaps="error"`, raises an error instead.
    """
    missing = np.flatnonzero(frames_near_steps(time, steps, fps, nearest, max_gap) < 0)
    if not len(missing):
        return
    first, last = steps[missing[[0, -1]]].tolist()
    message = (
        f"recording {number} has no frame within {max_step_distance(time, fps, max_gap):.4g} s of "
        f"{len(missing)} of {len(steps)} steps, from {first:.4g} to {last:.4g} s after its start"
    )
    if gaps == "error":
        raise ValueError(
            f"{message}: cut the recording there with Recording.select, use a larger max_gap, or "
            "write NaN there with gaps='nan'"
        )
    _logger.warning("%s, where readings are %s", message, "NaN" if fill is None else fill)


def check_complete(
    number: int,
    recording: Recording,
    steps: np.ndarray,
    fps: float,
    nearest: bool,
    max_gap: float | None,
    every_frame: bool,
) -> None:
    r"""Raises an error if a recording lacks joint angles or actions, which :obj:`fill` does not
    replace: zero would be an angle or a command that never existed.
    """
    time = recording.time - recording.time[0]
    for name, values in (("joint", recording.joint), ("action", recording.action)):
        if values is None:
            continue
        is_nearest = nearest and name == "joint"
        frames = frames_near_steps(time, steps, fps, is_nearest, max_gap)
        is_missing = np.isnan(values).any(axis=1)
        times = steps[(frames < 0) | is_missing[frames]]
        if every_frame and name == "joint":
            times = np.append(times, time[is_missing])
        if len(times):
            raise ValueError(
                f"recording {number} must have '{name}' at all steps with 'fill', which replaces "
                f"readings only (got none {times[0]:.4g} s after its start): cut the recording "
                "there with Recording.select"
            )


def check_gap_options(gaps: str, max_gap: float | None) -> None:
    r"""Raises an error for invalid options of gaps."""
    if gaps not in ("nan", "error"):
        raise ValueError(f"'gaps' must be 'nan' or 'error' (got {gaps!r})")
    if max_gap is not None and not max_gap > 0:
        raise ValueError(f"'max_gap' must be a positive number of seconds (got {max_gap!r})")


def frames_since(time: np.ndarray, steps: np.ndarray, fps: float) -> list[np.ndarray]:
    r"""Returns for each step the indices of the frames since the previous step."""
    last = steps_to_frames(time, np.append(steps[0] - 1 / fps, steps), fps)
    return [np.arange(a + 1, b + 1) for a, b in pairwise(last.tolist())]


def touch_columns(
    recording: Recording,
    steps: np.ndarray,
    fps: float,
    rows: int = 0,
    nearest: bool = False,
    *,
    extra: Mapping[str, ExtraSignal],
    max_gap: float | None = None,
    key: str = TACTILE,
    fill: float | None = None,
) -> dict[str, np.ndarray]:
    r"""Returns readings, joint angles (if any), actions (if any) and further signals at each of
    :math:`S` steps, with NaN in gaps.

    The action of a step is the last command at or before it, even with :obj:`nearest`.

    Shapes:
        - **steps:** Increasing times of the steps on the clock of the recording :math:`(S,)`.
        - **rows:** If not 0, the number of rows :math:`R` for all frames since the previous step:
          the newest frame is in the last row, and unused first rows are NaN.
        - **output:** by feature: readings :math:`(S, N \cdot C)`, angles :math:`(S, J)`, and with
          rows :math:`(S, R, N \cdot C)`, :math:`(S, R, J)` and the times :math:`(S, R)` of the
          frames in seconds after the step, at most 0. With the key :obj:`"observation.state"`,
          angles and readings are joined :math:`(S, J + N \cdot C)`
    """
    time = recording.time
    frames = frames_near_steps(time, steps, fps, nearest, max_gap)
    signals = {TACTILE if key == STATE else key: recording.tactile.reshape(len(time), -1)}
    if recording.joint is not None:
        signals[STATE] = recording.joint
    for name, signal in extra.items():
        values = recording.extra[name].reshape(len(time), -1)
        signals[EXTRA + name] = values.astype(signal.stored_dtype)
    columns = {name: _take_frames(value, frames) for name, value in signals.items()}
    if key == STATE:
        joined = [columns.get(STATE, np.zeros((len(steps), 0), np.float32)), columns.pop(TACTILE)]
        columns[STATE] = np.concatenate(joined, axis=1)
    if recording.action is not None:
        last = frames_near_steps(time, steps, fps, False, max_gap)
        columns[ACTION] = _take_frames(recording.action, last)
    if rows:
        columns |= _frame_columns(time, steps, fps, rows, signals, frame_times_feature(key))
    if fill is None:
        return columns
    numbers = {frame_times_feature(key): _UNUSED_ROW_STEPS / fps}
    return {
        name: np.where(np.isnan(values), values.dtype.type(numbers.get(name, fill)), values)
        for name, values in columns.items()
    }


def _frame_columns(
    time: np.ndarray,
    steps: np.ndarray,
    fps: float,
    rows: int,
    signals: Mapping[str, np.ndarray],
    times_name: str,
) -> dict[str, np.ndarray]:
    # All frames since the previous step, and their times.
    frame_rows = np.full((len(steps), rows), -1)
    for row, indices in zip(frame_rows, frames_since(time, steps, fps), strict=True):
        row[rows - len(indices) :] = indices
    times = time[frame_rows] - steps[:, None]
    return {
        **{f"{name}_frames": _take_frames(values, frame_rows) for name, values in signals.items()},
        times_name: np.where(frame_rows < 0, np.nan, times).astype(np.float32),
    }


def _take_frames(values: np.ndarray, frames: np.ndarray) -> np.ndarray:
    frame_values = values[frames]
    frame_values[frames < 0] = np.nan
    return frame_values


def feature_stats(values: np.ndarray) -> Stats:
    r"""Returns the statistics of one feature in one episode.

    Each value of a step has separate statistics. Frames since the previous step are pooled over
    their rows. The statistics of a value without any reading are zeros.

    Shapes:
        - **values:** The values :math:`(T,)`, :math:`(T, D)` or :math:`(T, R, D)`.
    """
    rows = values.reshape(len(values), -1) if values.ndim == 1 else values
    rows = rows.reshape(-1, rows.shape[-1]).astype(np.float64)
    with warnings.catch_warnings(), np.errstate(invalid="ignore"):
        warnings.simplefilter("ignore", RuntimeWarning)  # NumPy warns of a channel without readings
        stats = {
            "min": np.nanmin(rows, axis=0),
            "max": np.nanmax(rows, axis=0),
            "mean": np.nanmean(rows, axis=0),
            "std": np.nanstd(rows, axis=0),
        }
        quantiles = np.nanquantile(rows, [*QUANTILES.values()], axis=0)
    stats |= dict(zip(QUANTILES, quantiles, strict=True))
    num_repeats = values[0].size // rows.shape[1]
    stats = {
        name: np.tile(np.nan_to_num(value, nan=0.0), num_repeats) for name, value in stats.items()
    }
    return {**stats, "count": np.array([len(values)])}


def pool_stats(episodes: Sequence[Mapping[str, Stats]]) -> dict[str, Stats]:
    r"""Returns the statistics of a data set from the statistics of its episodes, as LeRobot does:
    weighted by the numbers of frames, with averaged quantiles.
    """
    pooled = {}
    for name in episodes[0]:
        parts = [episode[name] for episode in episodes]
        counts = np.array([float(part["count"][0]) for part in parts])
        weights = (counts / counts.sum())[:, None]
        mean = (weights * [part["mean"] for part in parts]).sum(axis=0)
        second_moments = [part["std"] ** 2 + (part["mean"] - mean) ** 2 for part in parts]
        pooled[name] = {
            "min": np.min([part["min"] for part in parts], axis=0),
            "max": np.max([part["max"] for part in parts], axis=0),
            "mean": mean,
            "std": np.sqrt((weights * second_moments).sum(axis=0)),
            **{q: (weights * [part[q] for part in parts]).sum(axis=0) for q in QUANTILES},
            "count": np.array([int(counts.sum())]),
        }
    return pooled


def stats_to_lists(stats: Mapping[str, Stats]) -> dict[str, dict[str, Any]]:
    r"""Converts statistics to the lists of LeRobot's :obj:`meta/stats.json`."""
    return {name: {key: v.tolist() for key, v in part.items()} for name, part in stats.items()}
