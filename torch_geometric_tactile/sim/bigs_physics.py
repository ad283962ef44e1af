r"""The physics of one grasp of the simulated BiGS set."""

from typing import Any, NamedTuple

import numpy as np

from torch_geometric_tactile.sim.bigs_contacts import ContactLog
from torch_geometric_tactile.sim.bigs_plan import (
    CONTROL_RATE,
    FRAME_RATE,
    INPUT_END,
    BigsGrasp,
    hand_motion,
)
from torch_geometric_tactile.sim.bigs_scene import FINGERS, HAND_MASS, OPEN, bigs_mjcf
from torch_geometric_tactile.sim.grasp import import_mujoco

BIGS_PHASES = ("closing", "hold", "lift", "shake")
_TOUCH = 0.3  # N, at which a finger stops closing
_SQUEEZE = 0.5  # s in which the wanted force is reached
_FORCE_GAIN = 0.05  # rad per second and newton
_PATIENCE = 1.6  # s until pick-up if nothing is touched
_LOST = 0.03  # m by which an object that is lost has sunk in the hand
_FREE = 0.1  # s without contact, after which it is lost as well
_AFTER = 0.3  # s recorded after the loss


class BigsPhysics(NamedTuple):
    r"""What happened, :obj:`CONTROL_RATE` times a second.

    :obj:`force` are the forces of the object on the fingertips in their frames, x to the end of the
    finger, y across, z into the pad, :math:`(K, 3, 3)`; :obj:`normal` and :obj:`shear` their parts
    along the normal and in the plane of contact, :math:`(K, 3)`, in newtons; :obj:`place` the
    middle of the contact in the frame of the fingertip :math:`(K, 3, 3)` in metres; :obj:`slide`
    the velocity at which the object slides there, likewise, in metres per second; both zero without
    contact. :obj:`finger` are the angles of the knuckles :math:`(K, 3)`, :obj:`hand` the place and
    turn of the hand :math:`(K, 6)`, :obj:`object_pose` that of the object :math:`(K, 7)`.
    :obj:`phase` indexes :obj:`BIGS_PHASES`. :obj:`pickup` is the tick at which the lift begins,
    :obj:`loss` that at which the object was lost, or none.
    """

    force: np.ndarray
    normal: np.ndarray
    shear: np.ndarray
    place: np.ndarray
    slide: np.ndarray
    finger: np.ndarray
    hand: np.ndarray
    object_pose: np.ndarray
    phase: np.ndarray
    pickup: int
    loss: int | None

    @property
    def success(self) -> bool:
        r"""Whether the object was in the hand after the shake."""
        return self.loss is None


class BigsSimulator:
    r"""Runs one grasp.

    Args:
        grasp (BigsGrasp): The grasp.

    Raises:
        ImportError: If MuJoCo is missing.
    """

    def __init__(self, grasp: BigsGrasp) -> None:
        self._mujoco = mujoco = import_mujoco()
        self.grasp = grasp
        self.model = model = mujoco.MjModel.from_xml_string(bigs_mjcf(grasp))
        self.data = mujoco.MjData(model)
        self._object = model.joint("object").qposadr[0]
        self._hand = model.joint("hand_x").qposadr[0]
        self._hand_dof = model.joint("hand_x").dofadr[0]
        self._fingers = np.array([model.joint(name).qposadr[0] for name in FINGERS])

    def run(self) -> BigsPhysics:
        r"""Runs the grasp to the end of the shake, or until shortly after the object is lost, but
        not before the input of P3 ends.
        """
        mujoco, model, data, grasp = self._mujoco, self.model, self.data, self.grasp
        start = self._start()
        motion = hand_motion(grasp)
        velocity = np.diff(motion, axis=0, prepend=motion[:1]) * CONTROL_RATE
        push = np.diff(velocity, axis=0, append=velocity[-1:]) * CONTROL_RATE * HAND_MASS
        # Turns are stored as roll, pitch, yaw; the hinges are yaw, pitch, roll.
        order = np.array([0, 1, 2, 5, 4, 3])
        motion, velocity, push = motion[:, order], velocity[:, order], push[:, order]
        hand, hand_dof = (
            slice(self._hand, self._hand + 6),
            slice(self._hand_dof, self._hand_dof + 6),
        )

        log = ContactLog(model)
        rows: list[tuple[Any, ...]] = []
        first: int | None = None
        pickup: int | None = None
        loss: int | None = None
        touched = np.zeros(3, dtype=bool)
        target = np.full(3, OPEN)
        dt, every = 1.0 / CONTROL_RATE, CONTROL_RATE // FRAME_RATE
        free, rest_height, tick = 0, 0.0, 0
        mujoco.mj_forward(model, data)
        while True:
            step = 0 if pickup is None else tick - pickup
            if step >= len(motion):
                break
            if loss is not None and tick > max(
                loss + _AFTER * CONTROL_RATE, (pickup or 0) + (INPUT_END + 0.05) * CONTROL_RATE
            ):
                break
            normal = log.add(data)
            if first is None and normal.max() > _TOUCH:
                first = tick
            if pickup is None:
                began = (
                    round(_PATIENCE * CONTROL_RATE)
                    if first is None
                    else first + round(grasp.hold * CONTROL_RATE)
                )
                if tick >= began:
                    pickup, rest_height = tick, self._sunk()
            elif loss is None:
                free = free + 1 if normal.max() == 0 else 0
                if rest_height - self._sunk() > _LOST or free > _FREE * CONTROL_RATE:
                    loss = tick
            since = -1.0 if pickup is None else (tick - pickup) * dt
            phase = int(first is not None) if since < 0 else 2 + int(since >= grasp.pause)
            rows.append(
                (
                    data.qpos[self._fingers],
                    data.qpos[hand].copy(),
                    data.qpos[self._object : self._object + 7].copy(),
                    phase,
                )
            )
            touched |= normal > _TOUCH
            # As often as frames come once all fingers touch, at every tick until then.
            if tick % every == 0 or not touched.all():
                step_time = every * dt if touched.all() else dt
                since_first = None if first is None else (tick - first) * dt
                self._close(target, touched, normal, tick * dt, since_first, step_time)
                data.ctrl[:] = target
            if pickup is not None:
                data.qpos[hand] = start + motion[step]
                data.qvel[hand_dof] = velocity[step]
                data.qfrc_applied[hand_dof] = push[step]
            else:
                data.qpos[hand] = start
                data.qvel[hand_dof] = 0.0
            mujoco.mj_step(model, data)
            tick += 1
        finger, moved, pose, phases = (np.array(column) for column in zip(*rows, strict=True))
        assert pickup is not None
        return BigsPhysics(*log.finish(), finger, moved[:, order], pose, phases, pickup, loss)

    def _start(self) -> np.ndarray:
        # Places the hand and opens the fingers.
        grasp, data = self.grasp, self.data
        roll, pitch, yaw = grasp.turn
        place = [*grasp.offset, grasp.half_height + grasp.height, yaw, pitch, roll]
        data.qpos[self._hand : self._hand + 6] = place
        data.qpos[self._fingers] = OPEN
        return np.array(place)

    def _sunk(self) -> float:
        # Height of the object in the hand.
        data = self.data
        return float(data.qpos[self._object + 2] - data.qpos[self._hand + 2])

    def _close(
        self,
        target: np.ndarray,
        touched: np.ndarray,
        normal: np.ndarray,
        time: float,
        since: float | None,
        dt: float,
    ) -> None:
        # Fingers close until they touch; then left and right regulate their force.
        grasp = self.grasp
        target += grasp.speed * dt * (~touched & (time >= np.array(grasp.delay)))
        if since is None or not touched.any():
            return
        # They wait for each other, but not for long.
        if touched.all() or since > _SQUEEZE:
            want = grasp.grip * np.array([grasp.balance, 1.0, 2.0 - grasp.balance])
            ramp = min(1.0, since / (2 * _SQUEEZE))
            rate = _FORCE_GAIN * (_TOUCH + (want - _TOUCH) * ramp - normal)
            target[[0, 2]] += (rate * touched)[[0, 2]].clip(-0.4, 0.4) * dt
        np.clip(target, OPEN, 1.1, out=target)
