r"""Policies for the simulated gripper, and recordings of their episodes."""

from collections.abc import Callable

import numpy as np

from torch_geometric_tactile._checks import need
from torch_geometric_tactile.data import Recording
from torch_geometric_tactile.sim.gripper_lift import (
    CONTROL_RATE,
    MAX_LIFT_SPEED,
    MAX_LOG_CHANGE,
    MIN_SQUEEZE,
    GripperLift,
    LiftOutcome,
)
from torch_geometric_tactile.sim.lift_need import GRAVITY

_EXPERT_RATIO = 1.3  # squeeze of the expert relative to the need
_LEAD = 0.15  # part of the weight by which the expert squeezes ahead of the load
_LOADING_SPEED, _SPEED_CHANGE = 0.003, 0.01  # m/s until the object is carried; m/s in a step
_CARRIED = 0.97  # part of the weight from which on the object counts as lifted
_READY_RATIO = 0.97  # of the squeeze that the load asks for, below which the expert does not lift


def lift_expert(env: GripperLift) -> np.ndarray:
    r"""Returns the action of an expert that knows the object :math:`(2,)`.

    As a person does, it squeezes in proportion to the load: the needed squeeze times the part of
    the weight that the pads carry, plus 30 %. It lifts slowly until they carry all of it, and
    waits for the squeeze meanwhile.

    Args:
        env (GripperLift): The running episode.

    Examples:
        >>> env = GripperLift()
        >>> _ = env.reset(seed=0)
        >>> lift_expert(env).shape
        (2,)
    """
    squeeze, speed = env.command
    if not env.is_touching:
        return np.zeros(2)
    carried = env.load / (env.item.mass * GRAVITY)
    target = max(_EXPERT_RATIO * env.need * min(1.0, carried + _LEAD), MIN_SQUEEZE)
    change = np.clip(np.log(target / squeeze), -MAX_LOG_CHANGE, MAX_LOG_CHANGE)
    if squeeze * np.exp(change) < _READY_RATIO * target:
        return np.array([change, 0.0])
    if carried < _CARRIED:
        return np.array([change, _LOADING_SPEED])
    return np.array([change, min(speed + _SPEED_CHANGE, MAX_LIFT_SPEED)])


def constant_squeeze(squeeze: float) -> Callable[[GripperLift], np.ndarray]:
    r"""Returns a policy that squeezes every object with the same force, and then lifts it.

    Args:
        squeeze (float): Squeeze in newtons.

    Raises:
        ValueError: If the squeeze is not positive.

    Examples:
        >>> policy = constant_squeeze(4.0)
        >>> env = GripperLift()
        >>> _ = env.reset(seed=0)
        >>> policy(env).tolist()  # no contact yet
        [0.0, 0.0]
    """
    need(squeeze > 0, "'squeeze' must be positive", squeeze)

    def policy(env: GripperLift) -> np.ndarray:
        if not env.is_touching:
            return np.zeros(2)
        current, speed = env.command
        change = np.log(max(squeeze, MIN_SQUEEZE) / current)
        if abs(change) > MAX_LOG_CHANGE:
            return np.array([np.clip(change, -MAX_LOG_CHANGE, MAX_LOG_CHANGE), 0.0])
        return np.array([change, min(speed + _SPEED_CHANGE, MAX_LIFT_SPEED)])

    return policy
