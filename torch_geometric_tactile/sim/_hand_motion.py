r"""The motion of the palm and fingers of the simulated hand: smooth paths, postures, tremor."""

from collections.abc import Sequence

import numpy as np

from torch_geometric_tactile.sim.hand_model import STAND
from torch_geometric_tactile.sim.spread import GraspSpread

_PALM_SKIN_HEIGHT = 0.016  # m; height of the palm's skin above the origin of the palm
_HOVER_HEIGHT = 0.10  # m; height of the palm above the object before the reach
_REACH_HEIGHT = 0.030  # m; height of the palm above the object after the reach
_PRESS_DEPTH = 0.001  # m; the palm presses this far into the object after closing
_THUMB_POSITION = -0.030  # m; position of the thumb along the fingers, from the palm's origin
_OPEN = (0.0, 0.30, 0.15, 0.10) * 3 + (1.30, 0.80, 0.00, 0.00)
_CLOSED = (0.0, 1.25, 1.10, 0.90) * 3 + (1.35, 0.80, 0.75, 0.80)
JOINT_TREMOR = 0.008  # rad


def draw_phases(
    schedule: Sequence[tuple[float, float]],
    full_length: float,
    rng: np.random.Generator,
    duration: float,
    step: float,
) -> tuple[np.ndarray, np.ndarray, list[np.ndarray], float]:
    r"""Returns random phases of a trial.

    Args:
        schedule (sequence of tuple): Shortest and longest duration of each phase except the last,
            in seconds, for a trial of :obj:`full_length`.
        full_length (float): Duration of the trial in the schedule, in seconds.
        rng (numpy.random.Generator): The random number generator.
        duration (float): Duration of the trial in seconds.
        step (float): Time between targets in seconds.

    Returns:
        The times of all targets in seconds :math:`(K,)`, their phases :math:`(K,)`, the progress
        from 0 to 1 of each phase except the last, each :math:`(K,)`, and the start of the last
        phase in seconds.

    Raises:
        ValueError: If the step is not positive or is longer than the trial.
    """
    if not 0 < step <= duration:
        raise ValueError(f"'step' must be positive and below 'duration' (got {step}, {duration})")
    lengths = [rng.uniform(*span) * duration / full_length for span in schedule]
    ticks = np.arange(round(duration / step)) * step
    ends = np.cumsum(lengths)
    progress = [
        minimum_jerk_step((ticks - end + length) / length)
        for end, length in zip(ends, lengths, strict=True)
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
    r"""Returns the path of a palm that descends on an object: x, y and z in metres and yaw in
    radians :math:`(K, 4)`.

    Shapes:
        - **reach:** progress from 0 (hovering) to 1 (just above the object) :math:`(K,)`
        - **close:** progress from 0 (just above the object) to 1 (on the object) :math:`(K,)`
        - **rise:** height in metres by which the palm is lifted afterwards :math:`(K,)`
    """
    width, _, height = size
    top = STAND[2] + height + _PALM_SKIN_HEIGHT
    gantry = np.empty((len(reach), 4))
    gantry[:, 0] = -(_THUMB_POSITION + width / 2 + 0.012) + rng.normal(0.0, spread.forward)
    gantry[:, 1] = rng.normal(0.0, spread.lateral)
    descent = (_HOVER_HEIGHT - _REACH_HEIGHT) * reach + (_REACH_HEIGHT + _PRESS_DEPTH) * close
    gantry[:, 2] = top + _HOVER_HEIGHT - descent + rise
    gantry[:, 3] = rng.normal(0.0, spread.yaw)
    gantry[:, :3] += tremor(rng, step, (len(reach), 3), sd=0.0008)
    return gantry


def draw_postures(rng: np.random.Generator, spread: GraspSpread) -> tuple[np.ndarray, np.ndarray]:
    r"""Returns random joint angles of the open and the closed hand in radians, each
    :math:`(16,)`.
    """
    open_hand = np.array(_OPEN) + rng.normal(0.0, spread.open_posture, 16)
    return open_hand, np.array(_CLOSED) + rng.normal(0.0, spread.posture, 16)


def minimum_jerk_step(progress: np.ndarray) -> np.ndarray:
    r"""Returns a minimum-jerk step from 0 to 1 while :obj:`progress` goes from 0 to 1."""
    s = progress.clip(0.0, 1.0)
    return s**3 * (10 - 15 * s + 6 * s**2)


def tremor(rng: np.random.Generator, step: float, shape: tuple[int, int], sd: float) -> np.ndarray:
    r"""Returns the tremor of an operator's hand: noise with standard deviation :obj:`sd` and a
    correlation time of a fifth of a second.
    """
    decay = np.exp(-step / 0.2)
    noise = rng.normal(0.0, sd, shape)
    noise[1:] *= np.sqrt(1 - decay**2)  # keeps the standard deviation constant over time
    for i in range(1, len(noise)):
        noise[i] += decay * noise[i - 1]
    return noise
