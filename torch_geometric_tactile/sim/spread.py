r"""Alignment errors of the operator of the simulated hand."""

from dataclasses import dataclass, fields
from typing import Self

import numpy as np

from torch_geometric_tactile._checks import need

# A third of a normal distribution lies within this number of standard deviations from the mean.
_TERCILE = 0.4307272992954576
_OPEN_HAND_RATIO = 0.625  # spread of the open hand relative to the closed hand
_MAX_LAZY_CLOSING = 0.6  # relative to the motion of a finger that closes completely


@dataclass(frozen=True)
class GraspSpread:
    r"""The variation between grasps of the simulated hand: standard deviations of the operator's
    errors, which are drawn for each attempt.

    :obj:`GraspSpread()` is a careful operator; :meth:`wide` returns a careless operator.

    Args:
        yaw (float): Standard deviation of the rotation of the palm about the vertical, in radians.
        lateral (float): Standard deviation of the position of the palm across the fingers, in
            metres.
        forward (float): Standard deviation of the position of the palm along the fingers, in
            metres.
        posture (float): Standard deviation of each joint of the closed hand in radians. For the
            open hand, it is 0.625 times as large.
        lazy_finger (float): Probability that the index, middle or ring finger closes by only 0 to
            60 %. This affects at most one finger per grasp, and never the thumb.

    Raises:
        ValueError: If a number is negative or not finite, or if :obj:`lazy_finger` is above 1.

    Examples:
        >>> GraspSpread(yaw=0.3)
        GraspSpread(yaw=0.3, lateral=0.014, forward=0.008, posture=0.08, lazy_finger=0.0)
        >>> GraspSpread(yaw=0.3).placement(lateral=0.0, yaw=-0.2)
        3
    """

    yaw: float = 0.16
    lateral: float = 0.014
    forward: float = 0.008
    posture: float = 0.08
    lazy_finger: float = 0.0

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            is_number = isinstance(value, int | float) and not isinstance(value, bool)
            if not is_number or not 0 <= value < float("inf"):
                raise ValueError(f"'{field.name}' must be a number of at least 0 (got {value!r})")
            object.__setattr__(self, field.name, float(value))
        need(self.lazy_finger <= 1, "'lazy_finger' must be a probability", self.lazy_finger)

    @classmethod
    def wide(cls) -> Self:
        r"""Returns a spread that is about one and a half to two times as large, with a lazy finger
        in three of ten attempts.
        """
        return cls(yaw=0.35, lateral=0.02, forward=0.012, posture=0.12, lazy_finger=0.3)

    @property
    def open_posture(self) -> float:
        r"""The standard deviation of each joint of the open hand in radians."""
        return _OPEN_HAND_RATIO * self.posture

    def close_less(self, closing: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        r"""Returns the closing motion, reduced for a lazy finger if the attempt has one. No random
        numbers are drawn if :obj:`lazy_finger` is zero.

        Args:
            closing (numpy.ndarray): Planned motion of the joints in radians :math:`(16,)`.
            rng (numpy.random.Generator): The random number generator.
        """
        if self.lazy_finger == 0:
            return closing
        is_lazy = rng.random() < self.lazy_finger
        # Drawn for every attempt, so that later random numbers do not depend on a lazy finger.
        finger, fraction = int(rng.integers(3)), rng.uniform(0.0, _MAX_LAZY_CLOSING)
        if not is_lazy:
            return closing
        reduced = closing.copy()
        reduced[4 * finger : 4 * finger + 4] *= fraction
        return reduced

    def placement(self, lateral: float, yaw: float) -> int:
        r"""Returns the index of the placement of the palm, from 0 to 8: three times the tercile of
        :obj:`lateral` plus the tercile of :obj:`yaw`, each counted from the smallest. All
        placements are equally likely.

        Args:
            lateral (float): Position of the palm across the fingers, in metres.
            yaw (float): Rotation of the palm about the vertical, in radians.
        """
        return 3 * _tercile(lateral, self.lateral) + _tercile(yaw, self.yaw)


def _tercile(value: float, deviation: float) -> int:
    if deviation == 0:
        return 1
    return int(value > -_TERCILE * deviation) + int(value > _TERCILE * deviation)


#: The stock spreads by name.
SPREADS = {"careful": GraspSpread(), "wide": GraspSpread.wide()}
