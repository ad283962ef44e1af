r"""Random parameters of the grasps of the simulated BiGS set: object, pose, grip and timing."""

from typing import NamedTuple

import numpy as np

from torch_geometric_tactile._checks import need
from torch_geometric_tactile.sim._bigs_times import INPUT_END, NUM_SHAKE_DIRECTIONS, BigsShape

# All values are plausible, not measured. Grips are calibrated so that the same share of grasps
# holds as in the BiGS set.
_HALF_WIDTH = {"cylinder": (0.036, 0.042), "box": (0.033, 0.039), "ball": (0.036, 0.043)}  # m
_HALF_HEIGHT = {"cylinder": (0.060, 0.075), "box": (0.033, 0.039), "ball": (0.0, 0.0)}  # m
_MASS = {"cylinder": (0.32, 0.44), "box": (0.27, 0.37), "ball": (0.24, 0.34)}  # kg
# Height in metres of the fingertips above the centre of the object.
_GRASP_HEIGHT = {"cylinder": (-0.025, 0.025), "box": (-0.005, 0.027), "ball": (-0.008, 0.008)}
_MEDIAN_FRICTION = {"cylinder": 0.60, "box": 0.50, "ball": 0.62}
_FRICTION_SPREAD = 0.07  # standard deviation of the logarithm
_MEDIAN_GRIP = {"cylinder": 4.33, "box": 2.60, "ball": 3.28}  # N
_GRIP_SPREAD = 0.50  # standard deviation of the logarithm
_GRIP_LIMITS = (1.0, 14.0)  # N


class BigsGrasp(NamedTuple):
    r"""The parameters of a simulated grasp: the object, and the pose, grip and timing of the hand.

    Args:
        shape (str): :obj:`"cylinder"` (upright), :obj:`"box"` or :obj:`"ball"`.
        half_width (float): Half width, or radius, in metres.
        half_height (float): Half height in metres.
        mass (float): Mass in kilograms.
        friction (float): Friction coefficient between object and fingertips.
        grip (float): Target normal force of the left and right fingers in newtons.
        balance (float): Grip of the left finger, relative to the mean of left and right.
        height (float): Height of the fingertips above the centre of the object in metres.
        offset (tuple of float): Horizontal offset x, y of the hand from the object in metres.
        turn (tuple of float): Roll, pitch and yaw of the hand in radians.
        spread (float): Angle in radians between the left and right fingers and the line through the
            middle finger.
        bend (tuple of float): Inward bend of the left, middle and right fingertips in radians.
        twist (tuple of float): Rotation of the tips about the axes of the fingers in radians.
        delay (tuple of float): Time at which each finger starts to close, in seconds.
        speed (float): Closing speed of the fingers in radians per second.
        hold (float): Time from the first contact until pick-up begins, in seconds.
        rise (float): Height by which the hand is lifted, in metres.
        lift (float): Duration of the lift in seconds.
        pause (float): Time from pick-up until the shake begins, in seconds.
        shake (float): Amplitude of the shake, in metres.
        shake_time (float): Duration of the shake in one direction, in seconds.

    Examples:
        >>> import numpy as np
        >>> grasp = draw_grasp("box", np.random.default_rng(0))
        >>> grasp.shape, 0.27 <= grasp.mass <= 0.37
        ('box', True)
        >>> grasp._replace(mass=0.5).mass
        0.5
    """

    shape: BigsShape
    half_width: float
    half_height: float
    mass: float
    friction: float
    grip: float
    balance: float
    height: float
    offset: tuple[float, float]
    turn: tuple[float, float, float]
    spread: float
    bend: tuple[float, float, float]
    twist: tuple[float, float, float]
    delay: tuple[float, float, float]
    speed: float
    hold: float
    rise: float
    lift: float
    pause: float
    shake: float
    shake_time: float

    @property
    def span(self) -> float:
        r"""The time from pick-up to the end of the shake in seconds."""
        return self.pause + NUM_SHAKE_DIRECTIONS * self.shake_time


def draw_grasp(shape: BigsShape, rng: np.random.Generator) -> BigsGrasp:
    r"""Returns random parameters of a grasp.

    Args:
        shape (str): The object.
        rng (numpy.random.Generator): The random number generator.

    Raises:
        ValueError: If the shape is unknown.

    Examples:
        >>> draw_grasp("ball", np.random.default_rng(0)).shape
        'ball'
    """
    need(shape in _HALF_WIDTH, f"'shape' must be one of {list(_HALF_WIDTH)} (got {shape!r})")
    half_width = rng.uniform(*_HALF_WIDTH[shape])
    half_height = half_width if shape == "ball" else rng.uniform(*_HALF_HEIGHT[shape])
    yaw = 0.06 if shape == "box" else 0.3  # the hand is aligned with the sides of a box
    spread = rng.normal(0.0, 0.05) if shape == "box" else rng.uniform(0.35, 0.65)
    grip = _MEDIAN_GRIP[shape] * np.exp(rng.normal(0.0, _GRIP_SPREAD))
    return BigsGrasp(
        shape=shape,
        half_width=half_width,
        half_height=half_height,
        mass=rng.uniform(*_MASS[shape]),
        friction=_MEDIAN_FRICTION[shape] * float(np.exp(rng.normal(0.0, _FRICTION_SPREAD))),
        grip=float(np.clip(grip, *_GRIP_LIMITS)),
        balance=float(np.clip(rng.normal(1.0, 0.22), 0.55, 1.45)),
        height=rng.uniform(*_GRASP_HEIGHT[shape]),
        offset=(rng.normal(0.0, 0.003), rng.normal(0.0, 0.004)),
        turn=(rng.normal(0.0, 0.07), rng.normal(0.0, 0.07), rng.normal(0.0, yaw)),
        spread=float(spread),
        bend=tuple(rng.normal(0.05, 0.10, 3).tolist()),
        twist=tuple(rng.normal(0.0, 0.15, 3).tolist()),
        delay=tuple(rng.uniform(0.0, 0.15, 3).tolist()),
        speed=rng.uniform(0.55, 0.75),
        hold=rng.uniform(0.9, 1.3),
        rise=rng.uniform(0.12, 0.18),
        lift=rng.uniform(1.0, 1.4),
        pause=INPUT_END + rng.uniform(0.05, 0.25),
        shake=0.032 * rng.uniform(0.92, 1.08),
        shake_time=rng.uniform(0.48, 0.54),
    )
