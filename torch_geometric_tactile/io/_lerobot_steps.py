r"""The frames of a recording at the steps of a regular clock."""

import math
from itertools import pairwise

import numpy as np

from torch_geometric_tactile.data import Recording
from torch_geometric_tactile.io._lerobot_features import (
    FRAME_TIMES,
    STATE,
    STATE_FRAMES,
    TACTILE,
    TACTILE_FRAMES,
)

# A step that lies on a frame but for rounding, as of times since 1970, is that frame's.
_SLACK = 1e-3


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
