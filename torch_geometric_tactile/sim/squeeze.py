r"""A hand that squeezes an object again and again, and does not lift it."""

import numpy as np

from torch_geometric_tactile.sensors import TaxelLayout
from torch_geometric_tactile.sim._hand_motion import (
    JOINT_TREMOR,
    palm_path,
    postures,
    smooth,
    timed_phases,
    tremor,
)
from torch_geometric_tactile.sim.grasp import GraspPlan
from torch_geometric_tactile.sim.spread import GraspSpread

#: The phases of a simulated squeeze, in order.
SQUEEZE_PHASES = ("hover", "reach", "close", "squeeze")

# Shortest and longest duration of each phase but the last, in seconds of a trial of 10 s: what is
# left to squeeze is at least 250 steps at 30 Hz.
_SCHEDULE = ((0.3, 0.5), (0.4, 0.6), (0.35, 0.55))
_FULL_LENGTH = 10.0
_FEWEST, _MOST = 3, 5  # squeezes
_RELEASE, _PEAK = (0.65, 0.92), (0.95, 1.2)  # how far the hand is closed; beyond 1 it presses
_LATE = 0.06  # of a squeeze, by which a finger is early or late (standard deviation)
_DEPTH = 0.06  # by how much a finger closes more or less than the others (standard deviation)
_FALLEN, _LEFT = 0.02, 0.06  # how far down and sideways an object may move, m
_TOUCH = 0.05  # pressure that counts, N


class SqueezePlan(GraspPlan):
    r"""Planned squeezes without a lift: the target pose of palm and fingers every :obj:`step`
    seconds.

    As :class:`GraspPlan`, with :obj:`phase` in :obj:`SQUEEZE_PHASES`.

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
        r"""Whether the object fell off its stand, or left the hand.

        Args:
            tick (int): Which of the steps.
            moved (numpy.ndarray): How far the object is from where it was, in metres :math:`(3,)`.
        """
        return bool(moved[2] < -_FALLEN or np.hypot(*moved[:2]) > _LEFT)

    def is_done(self, phase: np.ndarray, force: np.ndarray, layout: TaxelLayout) -> bool:
        r"""Whether at least two digits press at once while the hand squeezes.

        Args:
            phase (numpy.ndarray): The phases of the frames :math:`(T,)`.
            force (numpy.ndarray): The forces on the taxels in newtons :math:`(T, N, 3)`.
            layout (TaxelLayout): The taxels.

        Raises:
            ValueError: If the layout does not tell which digit a taxel is of.
        """
        pressed = force[phase == len(SQUEEZE_PHASES) - 1, :, 2] > _TOUCH
        digit = layout.segments("digit").numpy()
        on_palm = [layout.digit_names.index("palm")] if "palm" in layout.digit_names else []
        digits = [i for i in range(len(layout.digit_names)) if i not in on_palm]
        touching = sum(pressed[:, digit == i].any(axis=1).astype(int) for i in digits)
        return bool(np.any(touching >= 2))


def plan_squeeze(
    size: tuple[float, float, float],
    rng: np.random.Generator,
    duration: float = _FULL_LENGTH,
    step: float = 0.01,
    spread: GraspSpread | None = None,
) -> SqueezePlan:
    r"""Plans three to five squeezes of an object on its stand, which the hand reaches from above
    and does not lift, after the "Morphology-Specific Convolutional Neural Networks for Tactile
    Object Recognition with a Multi-Fingered Hand" paper: "a repeated squeezing motion of an object
    in an unknown pose within the hand". How long and how deep a squeeze is, how far the hand opens
    after it, and by how much each finger is early or late and closes more or less, is drawn.

    Args:
        size (tuple of float): Full extent of the object in metres.
        rng (numpy.random.Generator): Draws all that.
        duration (float): Length of the trial in seconds; the phases are scaled with it. Of 10 s at
            least 8.35 s, 250 steps at 30 Hz, are squeezes.
        step (float): Time between targets in seconds.
        spread (GraspSpread, optional): How much the grasps differ.

    Raises:
        ValueError: If the step is not positive, or longer than the trial.

    Examples:
        >>> plan = plan_squeeze((0.07, 0.1, 0.06), np.random.default_rng(0))
        >>> plan.joint.shape, plan.phase_names[plan.phase[-1]]
        ((1000, 16), 'squeeze')
    """
    spread = spread or GraspSpread()
    ticks, phase, progress, begin = timed_phases(_SCHEDULE, _FULL_LENGTH, rng, duration, step)
    _, reach, close = progress
    gantry = palm_path(size, rng, spread, step, reach, close, np.zeros(len(ticks)))
    start, end = postures(rng, spread)
    closing = spread.close_less(end - start, rng)
    times, levels = _squeezes(rng, begin, duration)
    longest = np.diff(times[::2]).max()
    joint = np.empty((len(ticks), 16))
    for finger in range(4):
        late, depth = rng.normal(0.0, _LATE * longest), 1.0 + rng.normal(0.0, _DEPTH)
        level = depth * _through(ticks - late * close, times, levels)
        level = close * level
        part = slice(4 * finger, 4 * finger + 4)
        joint[:, part] = start[part] + level[:, None] * closing[part]
    joint += tremor(rng, step, (len(ticks), 16), sd=JOINT_TREMOR)
    return SqueezePlan(gantry, joint, phase, step)


def _squeezes(rng: np.random.Generator, begin: float, end: float) -> tuple[np.ndarray, np.ndarray]:
    # When the hand is closed how far: released, squeezed, released, ...
    count = int(rng.integers(_FEWEST, _MOST + 1))
    times, levels = np.empty(2 * count + 1), np.empty(2 * count + 1)
    bounds = begin + (end - begin) * np.cumsum([0.0, *rng.dirichlet(np.full(count, 8.0))])
    times[::2] = bounds
    times[1::2] = bounds[:-1] + rng.uniform(0.35, 0.65, count) * np.diff(bounds)
    levels[::2] = rng.uniform(*_RELEASE, count + 1)
    levels[1::2] = rng.uniform(*_PEAK, count)
    return times, levels


def _through(ticks: np.ndarray, times: np.ndarray, levels: np.ndarray) -> np.ndarray:
    piece = np.searchsorted(times, ticks, side="right").clip(1, len(times) - 1) - 1
    done = smooth((ticks - times[piece]) / np.diff(times)[piece])
    return levels[piece] + done * np.diff(levels)[piece]
