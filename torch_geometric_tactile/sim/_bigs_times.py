r"""The order and the rates of simulated BiGS grasps."""

from typing import Literal

BigsShape = Literal["cylinder", "box", "ball"]

#: The objects, in the proportions of the BiGS set: two cylinders to one box and one ball.
BIGS_ORDER: tuple[BigsShape, ...] = ("cylinder", "box", "cylinder", "ball")
NUM_SESSIONS = 16
CONTROL_RATE = 300  # steps of the physics, controller ticks and robot samples a second
FRAME_RATE = 100  # frames of a recording a second
INPUT_END = 2.0  # s after pick-up begins, where the input of P3 ends
DIRECTIONS = 5  # of the shake: x, y, z, roll, pitch
