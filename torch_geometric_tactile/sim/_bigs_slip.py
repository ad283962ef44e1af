r"""The onset of slip in grasps that lose the object."""

import numpy as np

from torch_geometric_tactile.sim._bigs_physics import BigsPhysics
from torch_geometric_tactile.sim._bigs_times import CONTROL_RATE

_MIN_SLIDE_DISTANCE = 0.003  # m
_MIN_SLIDE_SPEED = 0.005  # m/s


def slip_onset(physics: BigsPhysics) -> int | None:
    r"""Returns the tick at which the object began to slip out of the hand, or :obj:`None` if it was
    held.

    In a grasp that loses the object, the onset is the start of the first slide that moves the
    object by more than 3 mm, at two or more fingertips, from its position at the start of pick-up.
    A slide starts when the speed begins to stay above 5 mm/s. Sliding is the relative velocity of
    the object and the fingertip in the plane of contact, summed while they touch. The elasticity of
    the skin and motion during the squeeze do not count. If no slide is long enough, the onset is
    the loss. A successful grasp has no onset, even if the object slides.

    Args:
        physics (BigsPhysics): The grasp.

    Examples:
        >>> slide = np.zeros((300, 3, 3))
        >>> slide[100:, :, 0] = 0.1  # from tick 100 on the object slides at 0.1 m/s
        >>> unused = [slide] * 4
        >>> physics = BigsPhysics(*unused, slide, slide, *unused, pickup=50, loss=200)
        >>> slip_onset(physics)
        100
    """
    if physics.loss is None:
        return None
    slide = physics.slide[physics.pickup : physics.loss + 1]
    distance = _median_finger(np.linalg.norm(np.cumsum(slide, axis=0) / CONTROL_RATE, axis=-1))
    speed = _median_finger(np.linalg.norm(slide, axis=-1))
    far_ticks = np.flatnonzero(distance > _MIN_SLIDE_DISTANCE)
    if len(far_ticks) == 0:
        return physics.loss
    slow_ticks = np.flatnonzero(speed[: far_ticks[0]] <= _MIN_SLIDE_SPEED)
    return physics.pickup + (int(slow_ticks[-1]) + 1 if len(slow_ticks) else 0)


def _median_finger(values: np.ndarray) -> np.ndarray:
    # At least two of three fingers exceed a threshold if and only if the median exceeds it.
    return np.sort(values, axis=1)[:, 1]
