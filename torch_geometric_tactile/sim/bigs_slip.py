r"""When the slip began that lost an object."""

import numpy as np

from torch_geometric_tactile.sim._bigs_times import CONTROL_RATE
from torch_geometric_tactile.sim.bigs_physics import BigsPhysics

_FAR = 0.003  # m
_FAST = 0.005  # m/s


def slip_onset(physics: BigsPhysics) -> int | None:
    r"""Returns the tick at which the object began to slip out of the hand, or :obj:`None` if it was
    held.

    In a grasp that loses the object, the onset is the beginning of the first slide that takes the
    object further than 3 mm, at two fingertips or more, from where they held it when pick-up began:
    the tick from which on it slides there faster than 5 mm/s without rest. Sliding is the relative
    velocity of object and fingertip in the plane of contact, summed while they touch, so that
    neither the elastic give of the skin nor what settles in the squeeze counts. If no slide was as
    long, the onset is the loss. A grasp that holds has none, although the object may slide in it.

    Args:
        physics (BigsPhysics): The grasp.

    Examples:
        >>> from torch_geometric_tactile.sim import BigsPhysics
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
    way = _second(np.linalg.norm(np.cumsum(slide, axis=0) / CONTROL_RATE, axis=-1))
    speed = _second(np.linalg.norm(slide, axis=-1))
    far = np.flatnonzero(way > _FAR)
    if len(far) == 0:
        return physics.loss
    rests = np.flatnonzero(speed[: far[0]] <= _FAST)
    return physics.pickup + (int(rests[-1]) + 1 if len(rests) else 0)


def _second(values: np.ndarray) -> np.ndarray:
    return np.sort(values, axis=1)[:, 1]
