r"""A task that requires touch: squeeze an unknown object and lift it."""

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from torch_geometric_tactile._checks import need
from torch_geometric_tactile.sensors import TaxelLayout
from torch_geometric_tactile.sim._gripper_scene import (
    FINGERS,
    NORMAL_STIFFNESS,
    SHEAR_STIFFNESS,
    TIMESTEP,
    default_pad,
    gripper_mjcf,
    pad_positions,
)
from torch_geometric_tactile.sim._lift_actions import (
    CONTROL_RATE,
    MAX_LIFT_SPEED,
    MAX_LOG_CHANGE,
    MAX_SQUEEZE,
    MIN_SQUEEZE,
)
from torch_geometric_tactile.sim._mujoco import import_mujoco
from torch_geometric_tactile.sim.lift_need import needed_squeeze
from torch_geometric_tactile.sim.lift_object import LiftObject, draw_lift_object
from torch_geometric_tactile.sim.pad_sensor import PadSensor

_LIFT_HEIGHT = 0.03  # m
_TICKS = round(1 / (CONTROL_RATE * TIMESTEP))
_MAX_SPEED_CHANGE = 0.4 * TIMESTEP  # m/s in a tick: 4 % of gravity
_MAX_STEPS = 120  # 6 s
_HOLD_STEPS = 10  # steps at the target height until the episode ends
_TOUCH_FORCE = 0.05  # N on each pad; the object then counts as touched
_GAP = (0.004, 0.008)  # m between the pads and the object at the start
# Standard deviations of the motor measurements: squeeze, then lift.
_POSITION_NOISE, _VELOCITY_NOISE = np.array([5e-5, 5e-5]), np.array([1e-3, 1e-3])  # m, m/s
_FORCE_OFFSET, _FORCE_NOISE = np.array([0.1, 0.5]), np.array([0.05, 0.2])  # N


@dataclass(frozen=True)
class LiftLimits:
    r"""The limits within which a lift is a success.

    Args:
        slide (float): Largest slide of the object along the pads in metres.
        tilt (float): Largest rotation of the object in radians.
        squeeze_ratio (float): Largest squeeze relative to :func:`needed_squeeze`.
        squeeze_margin (float): Additional squeeze in newtons that is allowed.

    Raises:
        ValueError: If a limit is not positive.

    Examples:
        >>> LiftLimits().slide
        0.003
    """

    slide: float = 0.003
    tilt: float = float(np.deg2rad(10))
    squeeze_ratio: float = 1.6
    squeeze_margin: float = 0.5

    def __post_init__(self) -> None:
        for key in ("slide", "tilt", "squeeze_ratio", "squeeze_margin"):
            need(getattr(self, key) > 0, f"'{key}' must be positive", getattr(self, key))


class LiftObservation(NamedTuple):
    r"""The measurements of the gripper at one step. The motors are squeeze and lift, in this order.

    Shapes:
        - **readings:** readings of the taxels in newtons :math:`(N, 3)`: shear along the axes of
          the taxel, and pressure
        - **position:** distance between the pads, and height, in metres :math:`(2,)`
        - **velocity:** rates of change of the positions in metres per second :math:`(2,)`
        - **command:** squeeze in newtons and lift speed in metres per second :math:`(2,)`
        - **force:** forces of the motors in newtons :math:`(2,)`: on each finger, and on the lift

    Examples:
        >>> observation = LiftObservation(np.zeros((32, 3)), *np.zeros((4, 2)))
        >>> observation.readings.shape
        (32, 3)
    """

    readings: np.ndarray
    position: np.ndarray
    velocity: np.ndarray
    command: np.ndarray
    force: np.ndarray


class LiftOutcome(NamedTuple):
    r"""The outcome of an episode.

    * :obj:`label` is :obj:`"success"`, the limit that was exceeded first (:obj:`"crushed"`,
      :obj:`"slipped"` or :obj:`"turned"`), or :obj:`"unfinished"` if the object was not lifted in
      time.
    * :obj:`slide` is the largest slide in metres.
    * :obj:`tilt` is the largest rotation in radians.
    * :obj:`peak` is the largest squeeze in newtons, averaged over a step.
    * :obj:`need` is the needed squeeze in newtons.

    Examples:
        >>> LiftOutcome("success", slide=0.001, tilt=0.02, peak=2.4, need=2.0).success
        True
    """

    label: str
    slide: float
    tilt: float
    peak: float
    need: float

    @property
    def success(self) -> bool:
        r"""Whether the object was lifted within all limits."""
        return self.label == "success"


class GripperLift:
    r"""A simulated parallel gripper that squeezes and lifts an unknown object, in MuJoCo.

    The gripper has two crowned pads of elastic taxels, which measure force along three axes. The
    mass, friction and centre of mass of the object are unknown, and so are the gains and offsets of
    the sensor. With too little squeeze, the object slides or turns; with too much squeeze, it is
    crushed. An episode starts without contact. It ends when a limit is exceeded, half a second
    after a lift of 30 mm, or after six seconds.

    Actions are executed at 20 Hz and have two numbers: the change of the natural logarithm of the
    squeeze, from -0.3 to 0.3, and the lift speed in metres per second, from 0 to 0.05. Actions
    outside of these ranges are clipped. The squeeze is between 0.3 and 30 N, and starts at 0.3 N.

    :obj:`model` and :obj:`data` are the MuJoCo objects, for pictures and measurements.

    Seed and object determine an episode bit for bit; other releases of MuJoCo may differ in some
    bits. Stiffness, damping and noise are plausible, not measured.

    Args:
        pad (TaxelLayout, optional): The taxels of each pad, flat and with axes :math:`x, y, z`
            (default: 4 x 4 taxels, 5 mm apart). Columns are upright.
        sensor (PadSensor, optional): Gains, offsets and noise.
        limits (LiftLimits, optional): Limits within which a lift is a success.

    Raises:
        ImportError: If MuJoCo is missing.
        ValueError: If the pad is not flat or is too high for the object.

    Examples:
        >>> env = GripperLift()
        >>> observation, finished = env.reset(seed=0), False
        >>> while not finished:
        ...     observation, finished = env.step([0.0, 0.02])
        >>> env.outcome.label
        'slipped'
    """

    def __init__(
        self,
        pad: TaxelLayout | None = None,
        sensor: PadSensor | None = None,
        limits: LiftLimits | None = None,
    ) -> None:
        self._mujoco = import_mujoco()
        self.pad = default_pad() if pad is None else pad
        pad_positions(self.pad)  # checks the pad
        self.sensor = PadSensor() if sensor is None else sensor
        self.limits = LiftLimits() if limits is None else limits
        self.layout = TaxelLayout.join([self.pad] * 2, FINGERS, name="gripper_pads")
        self._label: str | None = ""  # None while an episode is running

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.layout}, {self.sensor})"

    def reset(self, seed: int, item: LiftObject | None = None) -> LiftObservation:
        r"""Starts an episode and returns its first observation.

        Args:
            seed (int): Seed of the object, the sensor and its noise. It must not be negative.
                Episodes with the same seed are equal for all policies.
            item (LiftObject, optional): The object (default: :func:`draw_lift_object` with the
                seed).

        Raises:
            ValueError: If the seed is negative, or if no taxel touches the object.
        """
        self.item = draw_lift_object(seed) if item is None else item
        self.need = needed_squeeze(self.item, self.pad)
        self._rng = np.random.default_rng([seed, 1])
        self._gap = self._rng.uniform(*_GAP)
        self._force_offset = _FORCE_OFFSET * self._rng.normal(size=2)
        self._device = self.sensor.device(self.layout.num_taxels, self._rng)
        self._build()
        self._command = np.array([MIN_SQUEEZE, 0.0])
        self._speed = 0.0
        self._start: np.ndarray | None = None
        self._steps = self._steps_at_height = 0
        self._slide = self._tilt = self._peak = 0.0
        self._label = None
        self._mujoco.mj_forward(self.model, self.data)
        self._observation = self._observe()
        return self._observation

    def step(self, action: Any) -> tuple[LiftObservation, bool]:
        r"""Runs one step of 50 ms. Returns the observation at the end of the step and whether the
        episode is finished.

        Args:
            action (array_like): Change of the logarithm of the squeeze, and lift speed in metres
                per second :math:`(2,)`.

        Raises:
            ValueError: If the action does not have two finite numbers.
            RuntimeError: If the episode is finished, or if :meth:`reset` has not been called.
        """
        if self._label is not None:
            raise RuntimeError("no episode is running; call 'reset' first")
        change = np.asarray(action, dtype=np.float64)
        if change.shape != (2,) or not np.isfinite(change).all():
            raise ValueError(f"'action' must have two finite numbers (got {action})")
        squeeze = self._command[0] * np.exp(change[0].clip(-MAX_LOG_CHANGE, MAX_LOG_CHANGE))
        squeeze = squeeze.clip(MIN_SQUEEZE, MAX_SQUEEZE)
        speed = change[1].clip(0.0, MAX_LIFT_SPEED)
        self._peak = max(self._peak, self._run_ticks(float(squeeze), float(speed)))
        self._command = np.array([squeeze, speed])
        self._steps += 1
        self._judge()
        self._observation = self._observe()
        return self._observation, self._label is not None

    @property
    def outcome(self) -> LiftOutcome:
        r"""The outcome of the finished episode.

        Raises:
            RuntimeError: If no episode is finished.
        """
        if not self._label:
            raise RuntimeError("no episode is finished; call 'reset', and 'step' until it is")
        return LiftOutcome(self._label, self._slide, self._tilt, self._peak, self.need)

    @property
    def observation(self) -> LiftObservation:
        r"""The last observation."""
        return self._observation

    @property
    def command(self) -> np.ndarray:
        r"""The squeeze in newtons and the lift speed in metres per second of the last action
        :math:`(2,)`.
        """
        return self._command.copy()

    @property
    def slide(self) -> float:
        r"""The largest slide of the object along the pads so far, in metres."""
        return self._slide

    @property
    def tilt(self) -> float:
        r"""The largest rotation of the object since its first contact, in radians."""
        return self._tilt

    @property
    def taxel_force(self) -> np.ndarray:
        r"""The forces on the taxels without gains, offsets and noise, in newtons
        :math:`(N, 3)`.
        """
        force: np.ndarray = self.data.qpos[self._taxels] * self._stiffness
        return force

    @property
    def squeeze(self) -> float:
        r"""The normal force of a pad in newtons, averaged over both pads."""
        return float(self.taxel_force[:, 2].sum()) / 2

    @property
    def load(self) -> float:
        r"""The part of the weight that the pads carry, in newtons."""
        return -float(self.taxel_force[:, 1].sum())

    @property
    def is_touching(self) -> bool:
        r"""Whether both pads touch the object."""
        normal = self.taxel_force[:, 2].reshape(2, -1).sum(axis=1)
        return bool((normal > _TOUCH_FORCE).all())

    def _build(self) -> None:
        mujoco = self._mujoco
        xml = gripper_mjcf(self.pad, self.item, self._gap)
        self.model = model = mujoco.MjModel.from_xml_string(xml)
        self.data = mujoco.MjData(model)
        names = [f"{finger}_{i}" for finger in FINGERS for i in range(self.pad.num_taxels)]
        # The joints of a taxel follow one another in the state.
        first = np.array([model.joint(f"{name}_x").qposadr[0] for name in names])
        self._taxels = first[:, None] + np.arange(3)
        self._stiffness = np.array([SHEAR_STIFFNESS, SHEAR_STIFFNESS, NORMAL_STIFFNESS])
        self._object = slice(*(model.joint("object").qposadr[0] + np.array([0, 7])))
        joints = [model.joint(name) for name in ("left", "lift")]
        self._motors = np.array([joint.qposadr[0] for joint in joints])
        self._motor_speeds = np.array([joint.dofadr[0] for joint in joints])

    def _run_ticks(self, squeeze: float, speed: float) -> float:
        # Returns the mean squeeze over the step.
        model, data = self.model, self.data
        total, start = 0.0, self._command[0]
        for tick in range(1, _TICKS + 1):
            change = np.clip(speed - self._speed, -_MAX_SPEED_CHANGE, _MAX_SPEED_CHANGE)
            self._speed += float(change)
            data.ctrl[0] = start + (squeeze - start) * tick / _TICKS
            data.ctrl[1] = self._speed
            self._mujoco.mj_step(model, data)
            total += data.qpos[self._taxels[:, 2]].sum()
        return float(total) * NORMAL_STIFFNESS / (2 * _TICKS)

    def _judge(self) -> None:
        height = float(self.data.qpos[self._motors[1]])
        pose = self.data.qpos[self._object].copy()
        pose[2] -= height
        if self._start is None and self.is_touching:
            self._start = pose
        if self._start is not None:
            self._slide = max(self._slide, float(np.hypot(*(pose - self._start)[1:3])))
            # |<q1, q2>| is the cosine of half the angle between two orientations.
            cosine = min(1.0, abs(float((pose[3:] * self._start[3:]).sum())))
            self._tilt = max(self._tilt, 2 * float(np.arccos(cosine)))
        self._steps_at_height += height >= _LIFT_HEIGHT
        limits = self.limits
        if self._peak > limits.squeeze_ratio * self.need + limits.squeeze_margin:
            self._label = "crushed"
        elif self._slide > limits.slide:
            self._label = "slipped"
        elif self._tilt > limits.tilt:
            self._label = "turned"
        elif self._steps_at_height >= _HOLD_STEPS:
            self._label = "success" if self._start is not None else "unfinished"
        elif self._steps >= _MAX_STEPS:
            self._label = "unfinished"

    def _observe(self) -> LiftObservation:
        data, rng = self.data, self._rng
        position = data.qpos[self._motors].copy()
        velocity = data.qvel[self._motor_speeds].copy()
        position[0] = self.item.width + 2 * (self._gap - position[0])
        velocity[0] *= -2
        position += _POSITION_NOISE * rng.normal(size=2)
        velocity += _VELOCITY_NOISE * rng.normal(size=2)
        force = data.actuator_force + self._force_offset + _FORCE_NOISE * rng.normal(size=2)
        return LiftObservation(
            readings=self._device.readings(self.taxel_force),
            position=position.astype(np.float32),
            velocity=velocity.astype(np.float32),
            command=self._command.astype(np.float32),
            force=force.astype(np.float32),
        )
