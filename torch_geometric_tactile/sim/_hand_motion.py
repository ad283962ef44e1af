r"""How palm and fingers of the simulated hand move: smooth paths, postures, tremor."""

from collections.abc import Sequence

import numpy as np

from torch_geometric_tactile.sim.hand_model import STAND
from torch_geometric_tactile.sim.spread import GraspSpread

_PALM = 0.016  # height of the palm's skin above the origin of the palm, m
_HOVER, _ABOVE, _PRESS = 0.10, 0.030, 0.001  # palm above the object while hovering and reached, m
_THUMB = -0.030  # where the thumb is behind the palm's origin, m
_OPEN = (0.0, 0.30, 0.15, 0.10) * 3 + (1.30, 0.80, 0.00, 0.00)
_CLOSED = (0.0, 1.25, 1.10, 0.90) * 3 + (1.35, 0.80, 0.75, 0.80)
JOINT_TREMOR = 0.008  # rad


def timed_phases(
    schedule: Sequence[tuple[float, float]],
    full_length: float,
    rng: np.random.Generator,
    duration: float,
    step: float,
) -> tuple[np.ndarray, np.ndarray, list[np.ndarray], float]:
    r"""Returns the times of all targets :math:`(K,)`, the phase of each, the progress of each phase
    but the last from 0 to 1, and when that begins.

    Shapes:
        - **schedule:** Shortest and longest duration of each phase but the last, in seconds of a
          trial of :obj:`full_length`.
    """
    if not 0 < step <= duration:
        raise ValueError(f"'step' must be positive and below 'duration' (got {step}, {duration})")
    lengths = [rng.uniform(*span) * duration / full_length for span in schedule]
    ticks = np.arange(round(duration / step)) * step
    ends = np.cumsum(lengths)
    progress = [
        smooth((ticks - end + length) / length) for end, length in zip(ends, lengths, strict=True)
    ]
    return ticks, np.searchsorted(ends, ticks, side="right"), progress, ends[-1]


def palm_path(
    size: tuple[float, float, float],
    rng: np.random.Generator,
    spread: GraspSpread,
    step: float,
    reach: np.ndarray,
    close: np.ndarray,
    rise: np.ndarray,
) -> np.ndarray:
    r"""Returns x, y, z and yaw of a palm that comes down on an object :math:`(K, 4)`.

    Shapes:
        - **reach:** From 0, hovering, to 1, just above the object :math:`(K,)`.
        - **close:** From 0 to 1, on the object :math:`(K,)`.
        - **rise:** What the palm rises after that, in metres :math:`(K,)`.
    """
    width, _, height = size
    top = STAND[2] + height + _PALM
    gantry = np.empty((len(reach), 4))
    gantry[:, 0] = -(_THUMB + width / 2 + 0.012) + rng.normal(0.0, spread.forward)
    gantry[:, 1] = rng.normal(0.0, spread.lateral)
    descent = (_HOVER - _ABOVE) * reach + (_ABOVE + _PRESS) * close
    gantry[:, 2] = top + _HOVER - descent + rise
    gantry[:, 3] = rng.normal(0.0, spread.yaw)
    gantry[:, :3] += tremor(rng, step, (len(reach), 3), sd=0.0008)
    return gantry


def postures(rng: np.random.Generator, spread: GraspSpread) -> tuple[np.ndarray, np.ndarray]:
    r"""Returns the joint angles of the open and of the closed hand in radians, each
    :math:`(16,)`.
    """
    start = np.array(_OPEN) + rng.normal(0.0, spread.open_posture, 16)
    return start, np.array(_CLOSED) + rng.normal(0.0, spread.posture, 16)


def smooth(progress: np.ndarray) -> np.ndarray:
    r"""Returns a step from 0 to 1 with the least jerk."""
    s = progress.clip(0.0, 1.0)
    return s**3 * (10 - 15 * s + 6 * s**2)


def tremor(rng: np.random.Generator, step: float, shape: tuple[int, int], sd: float) -> np.ndarray:
    r"""Returns what an operator's hand, which is never still, does beside what it shall: noise with
    a correlation time of a fifth of a second.
    """
    keep = np.exp(-step / 0.2)
    noise = rng.normal(0.0, sd, shape)
    noise[1:] *= np.sqrt(1 - keep**2)
    for i in range(1, len(noise)):
        noise[i] += keep * noise[i - 1]
    return noise
