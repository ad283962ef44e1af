r"""Objects that the simulated gripper lifts."""

from dataclasses import dataclass

import numpy as np

from torch_geometric_tactile._checks import need

_MASS = (0.05, 0.4)  # kg, drawn on a logarithmic scale
_FRICTION = (0.3, 1.0)
_MAX_OFFSET = 0.012  # m, of the centre of mass
_TRAINING_WIDTHS = (0.030, 0.040, 0.060)  # m
_HELD_OUT_WIDTHS = (0.035, 0.050)  # m
_CORNER = 0.3  # part of both ranges that belongs to a corner
_BREADTH, _NARROW_BREADTH = 0.040, 0.010  # m
# A narrow object is in the middle of the pads or at one side, with a shift of up to 1 mm. Its edges
# are then between the columns of the default pads, and it hardly touches further taxels when it
# turns.
_SIDE, _MAX_SHIFT = 0.005, 0.001  # m


@dataclass(frozen=True)
class LiftObject:
    r"""A box with hidden properties that stands between the pads of :class:`GripperLift`. Sideways
    means horizontally along the pads.

    Args:
        mass (float): Mass in kilograms.
        friction (float): Coefficient of friction against the pads.
        offset (float): Sideways distance of the centre of mass from the middle of the pads in
            metres. It is the lever by which the weight turns the object.
        width (float): Extent between the pads in metres.
        breadth (float): Extent sideways in metres.
        place (float): Sideways distance of the middle of the box from the middle of the pads in
            metres.

    Raises:
        ValueError: If mass, friction, width or breadth is not positive, or if a number is infinite.

    Examples:
        >>> LiftObject(mass=0.2, friction=0.5).width
        0.04
    """

    mass: float
    friction: float
    offset: float = 0.0
    width: float = 0.04
    breadth: float = _BREADTH
    place: float = 0.0

    def __post_init__(self) -> None:
        for key in ("mass", "friction", "width", "breadth"):
            value = getattr(self, key)
            need(0 < value < float("inf"), f"'{key}' must be a positive number", value)
        for key in ("offset", "place"):
            value = getattr(self, key)
            need(abs(value) < float("inf"), f"'{key}' must be a finite distance in metres", value)


def draw_lift_object(seed: int, held_out: bool = False, narrow: bool = False) -> LiftObject:
    r"""Returns a random object for :class:`GripperLift`. The mass is from 0.05 to 0.4 kg on a
    logarithmic scale, friction is from 0.3 to 1, and the centre of mass is up to 12 mm beside the
    middle of the box.

    Training and test objects differ in two ways. In the plane of mass and friction, the four
    corners where both are within the outer 30 % of their ranges are held out. Training objects are
    30, 40 or 60 mm wide, and test objects 35 or 50 mm.

    Args:
        seed (int): Seed, which must not be negative. Equal seeds give equal objects.
        held_out (bool): If :obj:`True`, returns an object from a corner and with a held-out width.
        narrow (bool): If :obj:`True`, the object has a breadth of 10 mm, which is half the breadth
            of the default pads. It is within 1 mm of their middle, or of a place 5 mm beside it.

    Raises:
        ValueError: If the seed is negative.

    Examples:
        >>> draw_lift_object(0) == draw_lift_object(0)
        True
        >>> draw_lift_object(0, held_out=True).width in (0.035, 0.050)
        True
    """
    need(seed >= 0, "'seed' must not be negative", seed)
    rng = np.random.default_rng([seed, 0])
    level = rng.uniform(size=2)
    while _in_corner(level) != held_out:
        level = rng.uniform(size=2)
    side = float(rng.uniform(-1, 1))  # always drawn, so that narrow objects have the same mass etc.
    place = _SIDE * round(side) + 2 * _MAX_SHIFT * (side - round(side)) if narrow else 0.0
    return LiftObject(
        mass=float(_MASS[0] * (_MASS[1] / _MASS[0]) ** level[0]),
        friction=float(_FRICTION[0] + (_FRICTION[1] - _FRICTION[0]) * level[1]),
        offset=place + float(rng.uniform(-_MAX_OFFSET, _MAX_OFFSET)),
        width=float(rng.choice(_HELD_OUT_WIDTHS if held_out else _TRAINING_WIDTHS)),
        breadth=_NARROW_BREADTH if narrow else _BREADTH,
        place=place,
    )


def _in_corner(level: np.ndarray) -> bool:
    return bool((np.abs(level - 0.5) > 0.5 - _CORNER).all())
