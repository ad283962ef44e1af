r"""Repeated squeezes of an object with the simulated hand, without a lift."""

import numpy as np

from torch_geometric_tactile.sensors import TaxelLayout
from torch_geometric_tactile.sim._grasp import GraspPlan
from torch_geometric_tactile.sim._hand_motion import (
    JOINT_TREMOR,
    draw_phases,
    draw_postures,
    minimum_jerk_step,
    palm_path,
    tremor,
)
from torch_geometric_tactile.sim.spread import GraspSpread

#: The phases of a simulated squeeze, in order.
SQUEEZE_PHASES = ("hover", "reach", "close", "squeeze")

# Shortest and longest duration of each phase except the last, in seconds of a trial of 10 s. At
# least 250 steps at 30 Hz remain for the squeezes.
_SCHEDULE = ((0.3, 0.5), (0.4, 0.6), (0.35, 0.55))
_FULL_LENGTH = 10.0  # s
_MIN_SQUEEZES, _MAX_SQUEEZES = 3, 5
_RELEASE_LEVELS, _PEAK_LEVELS = (0.65, 0.92), (0.95, 1.2)  # 1 is the closed posture
_DELAY_SPREAD = 0.06  # standard deviation of the delay of a finger, relative to a squeeze
_DEPTH_SPREAD = 0.06  # standard deviation of the relative depth of a finger
_MAX_FALL, _MAX_SHIFT = 0.02, 0.06  # m; limits for an object that is still in the hand
_MIN_PRESSURE = 0.05  # N; a digit with a larger force presses


class SqueezePlan(GraspPlan):
    r"""A plan of squeezes without a lift: the target pose of the palm and the fingers every
    :obj:`step` seconds.

    The fields are the same as in :class:`GraspPlan`, but :obj:`phase` contains indices into
    :obj:`SQUEEZE_PHASES`.

    Examples:
        >>> plan = plan_squeeze((0.07, 0.1, 0.06), np.random.default_rng(0))
        >>> plan.phase_names
        ('hover', 'reach', 'close', 'squeeze')
    """

    __slots__ = ()

    @property
    def phase_names(self) -> tuple[str, ...]:
        r"""The names of the phases."""
        return SQUEEZE_PHASES

    def gives_up(self, tick: int, moved: np.ndarray) -> bool:
        r"""Returns whether the object has fallen off its stand or left the hand.

        Args:
            tick (int): Index of the step.
            moved (numpy.ndarray): Displacement of the object from its initial position in metres
                :math:`(3,)`.
        """
        return bool(moved[2] < -_MAX_FALL or np.hypot(*moved[:2]) > _MAX_SHIFT)

    def is_done(self, phase: np.ndarray, force: np.ndarray, layout: TaxelLayout) -> bool:
        r"""Returns whether at least two digits press at the same time in a frame of the squeezes.

        Args:
            phase (numpy.ndarray): The phases of the frames :math:`(T,)`.
            force (numpy.ndarray): The forces on the taxels in newtons :math:`(T, N, 3)`.
            layout (TaxelLayout): The taxels.

        Raises:
            ValueError: If the layout has no digits.
        """
        is_pressed = force[phase == len(SQUEEZE_PHASES) - 1, :, 2] > _MIN_PRESSURE
        digit = layout.segments("digit").numpy()
        palm = [layout.digit_names.index("palm")] if "palm" in layout.digit_names else []
        digits = [i for i in range(len(layout.digit_names)) if i not in palm]
        num_pressing = sum(is_pressed[:, digit == i].any(axis=1).astype(int) for i in digits)
        return bool(np.any(num_pressing >= 2))


def plan_squeeze(
    size: tuple[float, float, float],
    rng: np.random.Generator,
    duration: float = _FULL_LENGTH,
    step: float = 0.01,
    spread: GraspSpread | None = None,
) -> SqueezePlan:
    r"""Returns a plan of three to five squeezes of an object on its stand. The hand reaches the
    object from above and does not lift it. The motion follows the "Morphology-Specific
    Convolutional Neural Networks for Tactile Object Recognition with a Multi-Fingered Hand" paper:
    "a repeated squeezing motion of an object in an unknown pose within the hand". The duration and
    depth of each squeeze, the opening after it, and the delay and relative depth of each finger are
    random.

    Args:
        size (tuple of float): Full extent of the object in metres.
        rng (numpy.random.Generator): The random number generator.
        duration (float): Duration of the trial in seconds. The phases are scaled accordingly. In a
            trial of 10 s, the squeezes take at least 8.35 s, or 250 steps at 30 Hz.
        step (float): Time between targets in seconds.
        spread (GraspSpread, optional): Variation between grasps.

    Raises:
        ValueError: If the step is not positive, or longer than the trial.

    Examples:
        >>> plan = plan_squeeze((0.07, 0.1, 0.06), np.random.default_rng(0))
        >>> plan.joint.shape, plan.phase_names[plan.phase[-1]]
        ((1000, 16), 'squeeze')
    """
    spread = spread or GraspSpread()
    ticks, phase, progress, start = draw_phases(_SCHEDULE, _FULL_LENGTH, rng, duration, step)
    _, reach, close = progress
    gantry = palm_path(size, rng, spread, step, reach, close, np.zeros(len(ticks)))
    open_hand, closed_hand = draw_postures(rng, spread)
    closing = spread.close_less(closed_hand - open_hand, rng)
    times, levels = _draw_squeezes(rng, start, duration)
    longest = np.diff(times[::2]).max()
    joint = np.empty((len(ticks), 16))
    for finger in range(4):
        delay = rng.normal(0.0, _DELAY_SPREAD * longest)
        depth = 1.0 + rng.normal(0.0, _DEPTH_SPREAD)
        level = depth * _interpolate_levels(ticks - delay * close, times, levels)
        level = close * level
        joints = slice(4 * finger, 4 * finger + 4)
        joint[:, joints] = open_hand[joints] + level[:, None] * closing[joints]
    joint += tremor(rng, step, (len(ticks), 16), sd=JOINT_TREMOR)
    return SqueezePlan(gantry, joint, phase, step)


def _draw_squeezes(
    rng: np.random.Generator, start: float, end: float
) -> tuple[np.ndarray, np.ndarray]:
    # Returns the times and levels at which the hand alternately releases and squeezes.
    num_squeezes = int(rng.integers(_MIN_SQUEEZES, _MAX_SQUEEZES + 1))
    times, levels = np.empty(2 * num_squeezes + 1), np.empty(2 * num_squeezes + 1)
    durations = rng.dirichlet(np.full(num_squeezes, 8.0))
    bounds = start + (end - start) * np.cumsum([0.0, *durations])
    times[::2] = bounds
    times[1::2] = bounds[:-1] + rng.uniform(0.35, 0.65, num_squeezes) * np.diff(bounds)
    levels[::2] = rng.uniform(*_RELEASE_LEVELS, num_squeezes + 1)
    levels[1::2] = rng.uniform(*_PEAK_LEVELS, num_squeezes)
    return times, levels


def _interpolate_levels(ticks: np.ndarray, times: np.ndarray, levels: np.ndarray) -> np.ndarray:
    interval = np.searchsorted(times, ticks, side="right").clip(1, len(times) - 1) - 1
    progress = minimum_jerk_step((ticks - times[interval]) / np.diff(times)[interval])
    return levels[interval] + progress * np.diff(levels)[interval]
