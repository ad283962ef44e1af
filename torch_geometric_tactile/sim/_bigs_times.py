r"""The order of the objects, and the rates and times of simulated BiGS grasps."""

from typing import Literal

BigsShape = Literal["cylinder", "box", "ball"]

#: The objects, in the proportions of the BiGS set: two cylinders to one box and one ball.
BIGS_ORDER: tuple[BigsShape, ...] = ("cylinder", "box", "cylinder", "ball")
NUM_SESSIONS = 16
CONTROL_RATE = 300  # steps of the physics, controller ticks and robot samples per second
FRAME_RATE = 100  # frames of a recording per second
INPUT_END = 2.0  # s from the start of pick-up to the end of the input of P3
NUM_SHAKE_DIRECTIONS = 5  # x, y, z, roll, pitch
