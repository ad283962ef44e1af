r"""How much the operator of the simulated hand errs."""

from dataclasses import dataclass, fields
from typing import Self

import numpy as np

from torch_geometric_tactile._checks import need

_THIRD = 0.4307272992954576  # two thirds of a normal variable lie beyond this many deviations
_OPEN = 0.625  # how much of the spread of the closed hand the open hand has
_LAZIEST = 0.6  # the most that a lazy finger closes


@dataclass(frozen=True)
class GraspSpread:
    r"""The variation between grasps of the simulated hand: standard deviations of the operator's
    errors, drawn anew for each attempt.

    :obj:`GraspSpread()` is an operator who takes care, :meth:`wide` one who does not.

    Args:
        yaw (float): Of the turn of the palm about the vertical, in radians.
        lateral (float): Of the place of the palm across the fingers, in metres.
        forward (float): Of the place of the palm along the fingers, in metres.
        posture (float): Of each joint of the closed hand in radians; the open hand has 0.625 of it.
        lazy_finger (float): Probability that the index, middle or ring finger closes by 0 to 60 %
            only. At most one of them does, and never the thumb.

    Raises:
        ValueError: If a number is negative or not finite, or :obj:`lazy_finger` is above 1.

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
                raise ValueError(f"'{field.name}' must be a number from 0 on (got {value!r})")
            object.__setattr__(self, field.name, float(value))
        need(self.lazy_finger <= 1, "'lazy_finger' must be a probability", self.lazy_finger)

    @classmethod
    def wide(cls) -> Self:
        r"""Returns one and a half to two times the spread, and a lazy finger in three of ten
        attempts.
        """
        return cls(yaw=0.35, lateral=0.02, forward=0.012, posture=0.12, lazy_finger=0.3)

    @property
    def open_posture(self) -> float:
        r"""The standard deviation of each joint of the open hand in radians."""
        return _OPEN * self.posture

    def close_less(self, closing: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        r"""Returns by how much the joints close, after a finger was lazy or not.

        Nothing is drawn if no finger is ever lazy.

        Args:
            closing (numpy.ndarray): By how much they shall close, in radians :math:`(16,)`.
            rng (numpy.random.Generator): Draws whether, which finger, and how much it closes.
        """
        if self.lazy_finger == 0:
            return closing
        is_lazy = rng.random() < self.lazy_finger
        finger, part = int(rng.integers(3)), rng.uniform(0.0, _LAZIEST)
        if not is_lazy:
            return closing
        out = closing.copy()
        out[4 * finger : 4 * finger + 4] *= part
        return out

    def placement(self, lateral: float, yaw: float) -> int:
        r"""Returns which of nine placements of the palm an attempt has: three times the third of
        :obj:`lateral`, from the smallest up, plus the third of :obj:`yaw`. Each third is drawn
        equally often.

        Args:
            lateral (float): Place of the palm across the fingers, in metres.
            yaw (float): Its turn about the vertical, in radians.
        """
        return 3 * _third(lateral, self.lateral) + _third(yaw, self.yaw)


def _third(value: float, deviation: float) -> int:
    if deviation == 0:
        return 1
    return int(value > -_THIRD * deviation) + int(value > _THIRD * deviation)


#: The spreads by name.
SPREADS = {"careful": GraspSpread(), "wide": GraspSpread.wide()}
