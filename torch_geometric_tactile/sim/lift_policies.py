r"""Policies for the simulated gripper, and recordings of their episodes."""

from collections.abc import Callable
from dataclasses import asdict

import numpy as np

from torch_geometric_tactile._checks import need
from torch_geometric_tactile.data import Recording
from torch_geometric_tactile.sim._gripper_scene import GRAVITY
from torch_geometric_tactile.sim._lift_actions import (
    CONTROL_RATE,
    MAX_LIFT_SPEED,
    MAX_LOG_CHANGE,
    MIN_SQUEEZE,
)
from torch_geometric_tactile.sim.gripper_lift import GripperLift, LiftObservation
from torch_geometric_tactile.sim.lift_object import LiftObject

_Policy = Callable[[GripperLift], np.ndarray]
_EXPERT_RATIO = 1.3  # squeeze of the expert relative to the needed squeeze
_LEAD = 0.05  # part of the weight by which the expert squeezes ahead of the load
_LOADING_SPEED, _SPEED_CHANGE = 0.003, 0.01  # m/s until the object is carried; m/s in a step
_CARRIED = 0.97  # with this part of the weight on the pads, the object counts as lifted
_READY_RATIO = 0.97  # the expert does not lift below this part of the squeeze that the load needs
_DISTURBANCE = np.array([MAX_LOG_CHANGE, MAX_LIFT_SPEED / 4])  # of squeeze and lift at noise 1
_KEPT = 0.9  # part of a disturbance that remains after a step


def lift_expert(env: GripperLift) -> np.ndarray:
    r"""Returns the action :math:`(2,)` of an expert that knows the object.

    Like a person, the expert squeezes in proportion to the load: the needed squeeze times the part
    of the weight that the pads carry, plus 30 %. It lifts slowly until the pads carry the full
    weight, and waits whenever the squeeze is too small.

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


def constant_squeeze(squeeze: float) -> _Policy:
    r"""Returns a policy that waits for contact, squeezes every object with the same force, and
    lifts the object.

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


def record_lift(
    env: GripperLift,
    seed: int,
    item: LiftObject | None = None,
    *,
    policy: _Policy = lift_expert,
    noise: float = 0.0,
) -> Recording:
    r"""Runs an episode and returns its recording, which can be used as a demonstration.

    The recording has one frame per step, before the action of the step. Its label is the label of
    the outcome. It contains:

    * :obj:`joint`: the positions of the motors in metres
    * :obj:`action`: the actions of the policy
    * :obj:`extra`: the motors' :obj:`"velocity"`, :obj:`"command"` and :obj:`"motor_force"`
    * :obj:`privileged`: :obj:`"force"` on the taxels, :obj:`"squeeze"` and :obj:`"load"` in
      newtons, :obj:`"slide"` in metres and :obj:`"tilt"` in radians

    Args:
        env (GripperLift): The task.
        seed (int): Seed of the episode.
        item (LiftObject, optional): The object (default: :func:`draw_lift_object` with the seed).
        policy (callable): Function that maps the running episode to an action.
        noise (float): Standard deviation of the disturbance of the executed actions, relative to
            the largest change of the squeeze and to a quarter of the largest lift speed. A
            disturbance decays with a half-life of 0.35 seconds, so that the squeeze stays too high
            or too low for a while. The recorded actions are the undisturbed actions of the policy,
            which show how to correct the disturbance.

    Raises:
        ValueError: If the noise is negative.

    Examples:
        >>> recording = record_lift(GripperLift(), seed=0)
        >>> recording.label, recording.num_taxels, recording.num_actions
        ('success', 32, 2)
    """
    need(noise >= 0, "'noise' must not be negative", noise)
    rng = np.random.default_rng([seed, 2])
    scale = noise * _DISTURBANCE
    observation, finished = env.reset(seed, item), False
    rows, disturbance = [], scale * rng.normal(size=2)
    while not finished:
        action = policy(env)
        state = (env.taxel_force, env.squeeze, env.load, env.slide, env.tilt)
        rows.append((*observation, action, *state))
        observation, finished = env.step(action + disturbance)
        fresh = np.sqrt(1 - _KEPT**2) * scale * rng.normal(size=2)
        disturbance = _KEPT * disturbance + fresh
    columns = [np.asarray(column, dtype=np.float32) for column in zip(*rows, strict=True)]
    readings, position, velocity, command, motor_force, actions, *states = columns
    outcome = env.outcome
    return Recording(
        time=np.arange(len(rows)) / CONTROL_RATE,
        tactile=readings,
        joint=position,
        action=actions,
        label=outcome.label,
        meta={
            "unit": "newton",
            "rate": float(CONTROL_RATE),
            "synthetic": True,
            "seed": seed,
            "joint_names": ["opening", "height"],
            "action_names": ["log_squeeze_change", "lift_speed"],
            "object_properties": asdict(env.item),
            "sensor_properties": asdict(env.sensor),
            "need": outcome.need,
            "peak": outcome.peak,
        },
        extra={"velocity": velocity, "command": command, "motor_force": motor_force},
        privileged=dict(zip(("force", "squeeze", "load", "slide", "tilt"), states, strict=True)),
    )


def lift_observations(recording: Recording) -> list[LiftObservation]:
    r"""Returns the observations in a recording from :func:`record_lift`, one per step.

    Args:
        recording (Recording): The episode.

    Raises:
        ValueError: If the recording lacks measurements of the motors.

    Examples:
        >>> recording = record_lift(GripperLift(), seed=0)
        >>> len(lift_observations(recording)) == recording.num_frames
        True
    """
    joint, extra = recording.joint, recording.extra
    if joint is None or not {"velocity", "command", "motor_force"} <= set(extra):
        raise ValueError(f"'recording' must come from 'record_lift' (got {recording})")
    columns = (recording.tactile, joint, extra["velocity"], extra["command"], extra["motor_force"])
    return [LiftObservation(*row) for row in zip(*columns, strict=True)]
