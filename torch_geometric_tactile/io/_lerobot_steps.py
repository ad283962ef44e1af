r"""What LeRobot data sets hold of touch: features, their values at the steps of a regular clock,
and their statistics without the readings that are missing.
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

TACTILE, STATE = "observation.tactile", "observation.state"
EXTRA = "observation.extra."  # and the name of a further signal
TACTILE_FRAMES, STATE_FRAMES = f"{TACTILE}_frames", f"{STATE}_frames"
FRAME_TIMES = f"{TACTILE_FRAMES}_time"
INDICES = ("frame_index", "episode_index", "index", "task_index")
# A step that lies on a frame but for rounding, as of times since 1970, is that frame's.
_SLACK = 1e-3
_logger = logging.getLogger(__name__)
QUANTILES = {"q01": 0.01, "q10": 0.10, "q50": 0.50, "q90": 0.90, "q99": 0.99}

Stats = dict[str, np.ndarray]


def shape_of_names(names: Any) -> tuple[int, int] | None:
    r"""Returns the numbers of taxels and channels if the names are those of wide CSV.

    Examples:
        >>> shape_of_names(["taxel_0_x", "taxel_0_y", "taxel_1_x", "taxel_1_y"])
        (2, 2)
    """
    if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
        return None
    num_channels = sum(name.startswith("taxel_0_") for name in names)
    if not num_channels or len(names) % num_channels:
        return None
    shape = (len(names) // num_channels, num_channels)
    return shape if names == [*signal_names(*shape)] else None


def value_names(name: str, shape: tuple[int, ...]) -> list[str]:
    r"""Returns the names of the values of a signal of several dimensions.

    Examples:
        >>> value_names("pac", (1, 3))
        ['pac_0_0', 'pac_0_1', 'pac_0_2']
    """
    return ["_".join([name, *map(str, index)]) for index in np.ndindex(shape)]


def shape_of_values(name: str, names: Any, size: int) -> tuple[int, ...]:
    r"""Returns the shape of a signal whose values have the names of :func:`value_names`, or that of
    a list.

    Examples:
        >>> shape_of_values("pac", ["pac_0_0", "pac_0_1", "pac_0_2"], 3)
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
        r"""The type of the feature, a floating-point one, which has NaN where a value is missing
        and holds all values of the signal.
        """
        return "float32" if np.can_cast(self.dtype, np.float32) else "float64"


def extra_signals(recordings: Sequence[Recording]) -> dict[str, ExtraSignal]:
    r"""Returns the further signals that can be features: numbers of one shape in all recordings,
    which float64 holds.
    """
    out = {}
    for name in recordings[0].extra:
        values = [recording.extra[name] for recording in recordings if name in recording.extra]
        shapes = {value.shape[1:] for value in values}
        if (
            len(values) == len(recordings)
            and len(shapes) == 1
            and all(value.dtype.kind in "biuf" and _fits_float64(value) for value in values)
        ):
            out[name] = ExtraSignal(shapes.pop(), np.result_type(*values).name)
    return out


def warn_of_lost(path: Any, recordings: Sequence[Recording], extra: Mapping[str, Any]) -> None:
    r"""Logs a warning that names what a data set cannot hold of recordings."""
    names = [name for recording in recordings for name in recording.privileged]
    lost = {f"privileged {name!r}" for name in names}
    names = [name for recording in recordings for name in recording.extra]
    lost |= {f"extra {name!r}" for name in names if name not in extra}
    if lost:
        _logger.warning(
            "'%s' is a LeRobot data set and cannot hold %s (signals that are not numbers of one "
            "shape in all recordings, or only known in simulation)",
            path,
            ", ".join(sorted(lost)),
        )


def _fits_float64(values: np.ndarray) -> bool:
    if values.dtype.kind not in "iu" or values.dtype.itemsize < 8:
        return True
    return not values.size or max(-int(values.min()), int(values.max())) <= 2**53


def feature(size: int, names: list[str] | None = None, dtype: str = "float32") -> dict[str, Any]:
    r"""Returns the description of a feature of one dimension."""
    return {"dtype": dtype, "shape": [size], "names": names}


def touch_features(
    recording: Recording, rows: int, extra: Mapping[str, ExtraSignal]
) -> dict[str, Any]:
    r"""Returns the features of the readings and further signals."""
    shape = (recording.num_taxels, recording.num_channels)
    out = {TACTILE: feature(shape[0] * shape[1], [*signal_names(*shape)])}
    if rows:
        out[TACTILE_FRAMES] = feature(rows * shape[0] * shape[1])
        out[FRAME_TIMES] = feature(rows)
    for name, signal in extra.items():
        size = math.prod(signal.shape)
        names = value_names(name, signal.shape) if len(signal.shape) > 1 else None
        out[EXTRA + name] = feature(size, names, dtype=signal.stored_dtype)
        if rows:
            out[f"{EXTRA}{name}_frames"] = feature(rows * size, dtype=signal.stored_dtype)
    return out


def regular_steps(time: np.ndarray, fps: float, whole: bool = False) -> np.ndarray:
    r"""Returns the times of a regular clock that starts with the first frame, in seconds
    since it.
    """
    steps = (time[-1] - time[0]) * fps
    count = math.ceil(steps - _SLACK) if whole else math.floor(steps + _SLACK)
    return np.arange(count + 1) / fps


def frames_of_steps(
    time: np.ndarray, steps: np.ndarray, fps: float, nearest: bool = False
) -> np.ndarray:
    r"""Returns which frame stands for each step, or -1 for steps before the first frame."""
    last = np.searchsorted(time, steps + _SLACK / fps, side="right") - 1
    if not nearest:
        return last
    after = np.minimum(last + 1, len(time) - 1)
    return np.where(time[after] - steps < steps - time[last], after, last)


def largest_gap(time: np.ndarray, fps: float, max_gap: float | None) -> float:
    r"""Returns how far in seconds a frame may be from a step that it stands for.

    Args:
        time (numpy.ndarray): Time of each frame in seconds :math:`(T,)`.
        fps (float): Steps per second; a frame since the last step is never too far.
        max_gap (float, optional): The longest time in seconds that is no gap; if left out, five
            frames at the usual distance.
    """
    if max_gap is None:
        max_gap = measure_rate(time).max_gap if len(time) > 1 else 0.0
    return max(max_gap, 1 / fps) + _SLACK / fps


def frames_near_steps(
    time: np.ndarray, steps: np.ndarray, fps: float, nearest: bool, max_gap: float | None
) -> np.ndarray:
    r"""Returns which frame stands for each step, or -1 for steps in a gap or before the first
    frame.

    Shapes:
        - **output:** indices :math:`(S,)`
    """
    frames = frames_of_steps(time, steps, fps, nearest)
    is_far = np.abs(steps - time[frames]) > largest_gap(time, fps, max_gap)
    return np.where(is_far, -1, frames)


def check_gaps(
    number: int,
    time: np.ndarray,
    steps: np.ndarray,
    fps: float,
    nearest: bool,
    gaps: Literal["nan", "error"],
    max_gap: float | None,
) -> None:
    r"""Logs how many steps of a recording have no reading since they are in a gap, or raises an
    error.
    """
    missing = np.flatnonzero(frames_near_steps(time, steps, fps, nearest, max_gap) < 0)
    if not len(missing):
        return
    first, last = steps[missing[[0, -1]]].tolist()
    text = (
        f"recording {number} has no frame within {largest_gap(time, fps, max_gap):.4g} s of "
        f"{len(missing)} of {len(steps)} steps, from {first:.4g} to {last:.4g} s after its start"
    )
    if gaps == "error":
        raise ValueError(
            f"{text}: cut it there with Recording.select, give a larger max_gap, or gaps='nan' to "
            "write NaN there"
        )
    _logger.warning("%s, where readings are NaN", text)


def check_gap_options(gaps: str, max_gap: float | None) -> None:
    r"""Raises an error unless the options of gaps are possible."""
    if gaps not in ("nan", "error"):
        raise ValueError(f"'gaps' must be 'nan' or 'error' (got {gaps!r})")
    if max_gap is not None and not max_gap > 0:
        raise ValueError(f"'max_gap' must be a positive number of seconds (got {max_gap!r})")


def frames_since(time: np.ndarray, steps: np.ndarray, fps: float) -> list[np.ndarray]:
    r"""Returns the frames since the last step, for each step."""
    last = frames_of_steps(time, np.append(steps[0] - 1 / fps, steps), fps)
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
) -> dict[str, np.ndarray]:
    r"""Returns the readings, joint angles if there are, and further signals at each of :math:`S`
    steps, NaN in gaps.

    Shapes:
        - **steps:** Times of the steps by its clock, increasing :math:`(S,)`.
        - **rows:** If not 0, the frames since the last step come as well, in so many rows
          :math:`R`: the oldest first, and rows that are missing before it.
        - **output:** by feature: readings :math:`(S, N \cdot C)`, angles :math:`(S, J)`, and with
          rows :math:`(S, R, N \cdot C)`, :math:`(S, R, J)` and the times :math:`(S, R)` of the
          frames in seconds after the step, 0 or below
    """
    time = recording.time
    frames = frames_near_steps(time, steps, fps, nearest, max_gap)
    signals = {TACTILE: recording.tactile.reshape(len(time), -1)}
    if recording.joint is not None:
        signals[STATE] = recording.joint
    for name, signal in extra.items():
        values = recording.extra[name].reshape(len(time), -1)
        signals[EXTRA + name] = values.astype(signal.stored_dtype)
    out = {name: _taken(value, frames) for name, value in signals.items()}
    if not rows:
        return out
    between = np.full((len(steps), rows), -1)
    for row, found in zip(between, frames_since(time, steps, fps), strict=True):
        row[rows - len(found) :] = found
    for name, values in signals.items():
        out[f"{name}_frames"] = _taken(values, between)
    times = time[between] - steps[:, None]
    return {**out, FRAME_TIMES: np.where(between < 0, np.nan, times).astype(np.float32)}


def _taken(values: np.ndarray, frames: np.ndarray) -> np.ndarray:
    out = values[frames]
    out[frames < 0] = np.nan
    return out


def feature_stats(values: np.ndarray) -> Stats:
    r"""Returns the statistics of one feature in one episode.

    Each value of a step has its own. Those of frames since the last step are pooled over their
    rows. A value without any reading has zeros.

    Shapes:
        - **values:** The values :math:`(T,)`, :math:`(T, D)` or :math:`(T, R, D)`.
    """
    rows = values.reshape(len(values), -1) if values.ndim == 1 else values
    rows = rows.reshape(-1, rows.shape[-1]).astype(np.float64)
    with warnings.catch_warnings(), np.errstate(invalid="ignore"):
        warnings.simplefilter("ignore", RuntimeWarning)  # of a channel without readings
        out = {
            "min": np.nanmin(rows, axis=0),
            "max": np.nanmax(rows, axis=0),
            "mean": np.nanmean(rows, axis=0),
            "std": np.nanstd(rows, axis=0),
        }
        quantiles = np.nanquantile(rows, [*QUANTILES.values()], axis=0)
    out |= dict(zip(QUANTILES, quantiles, strict=True))
    times = values[0].size // rows.shape[1]
    out = {name: np.tile(np.nan_to_num(value, nan=0.0), times) for name, value in out.items()}
    return {**out, "count": np.array([len(values)])}


def joined_stats(episodes: Sequence[Mapping[str, Stats]]) -> dict[str, Stats]:
    r"""Returns the statistics of a data set from those of its episodes, as LeRobot joins them: by
    the numbers of frames; quantiles are averages.
    """
    out = {}
    for name in episodes[0]:
        parts = [episode[name] for episode in episodes]
        counts = np.array([float(part["count"][0]) for part in parts])
        share = (counts / counts.sum())[:, None]
        mean = (share * [part["mean"] for part in parts]).sum(axis=0)
        spread = [part["std"] ** 2 + (part["mean"] - mean) ** 2 for part in parts]
        out[name] = {
            "min": np.min([part["min"] for part in parts], axis=0),
            "max": np.max([part["max"] for part in parts], axis=0),
            "mean": mean,
            "std": np.sqrt((share * spread).sum(axis=0)),
            **{q: (share * [part[q] for part in parts]).sum(axis=0) for q in QUANTILES},
            "count": np.array([int(counts.sum())]),
        }
    return out


def stats_lists(stats: Mapping[str, Stats]) -> dict[str, dict[str, Any]]:
    r"""Returns statistics as LeRobot's :obj:`meta/stats.json` holds them."""
    return {name: {key: v.tolist() for key, v in part.items()} for name, part in stats.items()}
