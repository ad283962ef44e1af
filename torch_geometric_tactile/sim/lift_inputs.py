r"""Inputs of policies for the simulated gripper, with different amounts of touch."""

import numpy as np

from torch_geometric_tactile._checks import need
from torch_geometric_tactile.sensors import TaxelLayout
from torch_geometric_tactile.sim._gripper_scene import default_pad, pad_positions
from torch_geometric_tactile.sim.gripper_lift import LiftObservation

#: The inputs of :func:`lift_inputs`, from no touch to all readings.
LIFT_INPUTS = ("none", "normal", "total", "wrench", "taxels")


def lift_inputs(
    observation: LiftObservation, name: str, pad: TaxelLayout | None = None
) -> np.ndarray:
    r"""Returns the inputs of a policy with one kind of touch :math:`(D,)`: positions, velocities,
    commands and forces of the motors, followed by

    * :obj:`"none"`: nothing more :math:`(D = 8)`,
    * :obj:`"normal"`: the pressure on each taxel in newtons :math:`(D = 8 + N)`,
    * :obj:`"total"`: the sums of shear and pressure of each pad in newtons :math:`(D = 14)`,
    * :obj:`"wrench"`: force in newtons and torque in newton metres on each pad, about its middle
      and in its frame, as measured by a six-axis sensor behind the pad :math:`(D = 20)`,
    * :obj:`"taxels"`: all readings in newtons :math:`(D = 8 + 3 N)`.

    Args:
        observation (LiftObservation): The measurements of one step.
        name (str): One of :obj:`LIFT_INPUTS`.
        pad (TaxelLayout, optional): The taxels of each pad (default: 4 x 4, 5 mm apart).

    Raises:
        ValueError: If the name is unknown, or if the taxels of the observation are not the taxels
            of the pads.

    Examples:
        >>> observation = LiftObservation(np.zeros((32, 3)), *np.zeros((4, 2)))
        >>> [len(lift_inputs(observation, name)) for name in LIFT_INPUTS]
        [8, 40, 14, 20, 104]
    """
    need(name in LIFT_INPUTS, f"'name' must be one of {LIFT_INPUTS}", name)
    position = pad_positions(default_pad() if pad is None else pad)
    shape = (2 * len(position), 3)
    readings, *motors = observation
    need(readings.shape == shape, f"'observation' must have readings {shape}", readings.shape)
    pads = readings.reshape(2, -1, 3)
    touch = {
        "none": lambda: readings[:0],
        "normal": lambda: readings[:, 2],
        "total": lambda: pads.sum(axis=1),
        "wrench": lambda: _wrench(pads, position),
        "taxels": lambda: readings,
    }[name]()
    return np.concatenate([*motors, touch.reshape(-1)]).astype(np.float32)


def _wrench(pads: np.ndarray, position: np.ndarray) -> np.ndarray:
    # The force and torque on each pad (2, 6). Pressure points into the pad, against z.
    force = pads * np.array([1.0, 1.0, -1.0])
    lever = np.column_stack([position, np.zeros(len(position))])
    torque = np.cross(lever, force).sum(axis=1)
    return np.concatenate([force.sum(axis=1), torque], axis=1)
