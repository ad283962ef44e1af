r"""The order, the rates and the hand's motion of simulated BiGS grasps."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

import numpy as np

if TYPE_CHECKING:
    from torch_geometric_tactile.sim.bigs_plan import BigsGrasp

BigsShape = Literal["cylinder", "box", "ball"]

#: The objects, in the proportions of the BiGS set: two cylinders to one box and one ball.
BIGS_ORDER: tuple[BigsShape, ...] = ("cylinder", "box", "cylinder", "ball")
NUM_SESSIONS = 16
CONTROL_RATE = 300  # steps of the physics, controller ticks and robot samples a second
FRAME_RATE = 100  # frames of a recording a second
INPUT_END = 2.0  # s after pick-up begins, where the input of P3 ends
DIRECTIONS = 5  # of the shake: x, y, z, roll, pitch

_CYCLES = 2  # of the shake in each direction
_TURN = 0.28  # rad, of the shake about x and y


def hand_motion(grasp: BigsGrasp) -> np.ndarray:
    r"""Returns by how much the hand is moved, from pick-up to the end of the shake, in steps of the
    physics: x, y, z in metres, roll, pitch and yaw in radians :math:`(K, 6)`.

    It rises, waits, and is shaken along x, y, z and about x and y, two cycles each that swell and
    fade. That begins later than the input of P3 ends.
    """
    time = np.arange(round(grasp.span * CONTROL_RATE)) / CONTROL_RATE
    out = np.zeros((len(time), 6))
    s = (time / grasp.lift).clip(0.0, 1.0)
    out[:, 2] = grasp.rise * s**3 * (10 - 15 * s + 6 * s**2)
    for i in range(DIRECTIONS):
        part = ((time - grasp.pause) / grasp.shake_time - i).clip(0.0, 1.0)
        swing = np.sin(np.pi * part) ** 2 * np.sin(2 * np.pi * _CYCLES * part)
        out[:, i] += swing * (grasp.shake if i < 3 else _TURN)
    return out
