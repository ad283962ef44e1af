r"""What LeRobot data sets hold of touch: features, their values at the steps of a regular clock,
and their statistics without the readings that are missing.
"""

import math
import warnings
from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any

import numpy as np

from torch_geometric_tactile.data import Recording
from torch_geometric_tactile.io._csv_frames import signal_names

TACTILE, STATE = "observation.tactile", "observation.state"
TACTILE_FRAMES, STATE_FRAMES = f"{TACTILE}_frames", f"{STATE}_frames"
FRAME_TIMES = f"{TACTILE_FRAMES}_time"
INDICES = ("frame_index", "episode_index", "index", "task_index")
# A step that lies on a frame but for rounding, as of times since 1970, is that frame's.
_SLACK = 1e-3
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


def feature(size: int, names: list[str] | None = None, dtype: str = "float32") -> dict[str, Any]:
    r"""Returns the description of a feature of one dimension."""
    return {"dtype": dtype, "shape": [size], "names": names}


def touch_features(recording: Recording, rows: int) -> dict[str, Any]:
    r"""Returns the features of the readings."""
    shape = (recording.num_taxels, recording.num_channels)
    out = {TACTILE: feature(shape[0] * shape[1], [*signal_names(*shape)])}
    if rows:
        out[TACTILE_FRAMES] = feature(rows * shape[0] * shape[1])
        out[FRAME_TIMES] = feature(rows)
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


def frames_since(time: np.ndarray, steps: np.ndarray, fps: float) -> list[np.ndarray]:
    r"""Returns the frames since the last step, for each step."""
    last = frames_of_steps(time, np.append(steps[0] - 1 / fps, steps), fps)
    return [np.arange(a + 1, b + 1) for a, b in pairwise(last.tolist())]


def touch_columns(
    recording: Recording, steps: np.ndarray, fps: float, rows: int = 0, nearest: bool = False
) -> dict[str, np.ndarray]:
    r"""Returns the readings, and joint angles if there are, at each of :math:`S` steps.

    Shapes:
        - **steps:** Times of the steps by its clock, increasing :math:`(S,)`.
        - **rows:** If not 0, the frames since the last step come as well, in so many rows
          :math:`R`: the oldest first, and rows that are missing before it.
        - **output:** by feature: readings :math:`(S, N \cdot C)`, angles :math:`(S, J)`, and with
          rows :math:`(S, R, N \cdot C)`, :math:`(S, R, J)` and the times :math:`(S, R)` of the
          frames in seconds after the step, 0 or below
    """
    time = recording.time
    frames = frames_of_steps(time, steps, fps, nearest)
    signals = {TACTILE: recording.tactile.reshape(len(time), -1)}
    if recording.joint is not None:
        signals[STATE] = recording.joint
    out = {name: _taken(value, frames) for name, value in signals.items()}
    if not rows:
        return out
    between = np.full((len(steps), rows), -1)
    for row, found in zip(between, frames_since(time, steps, fps), strict=True):
        row[rows - len(found) :] = found
    for name, wide in {TACTILE: TACTILE_FRAMES, STATE: STATE_FRAMES}.items():
        if name in signals:
            out[wide] = _taken(signals[name], between)
    times = time[between] - steps[:, None]
    return {**out, FRAME_TIMES: np.where(between < 0, np.nan, times).astype(np.float32)}


def _taken(values: np.ndarray, frames: np.ndarray) -> np.ndarray:
    out = values[frames].astype(np.float32)
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
