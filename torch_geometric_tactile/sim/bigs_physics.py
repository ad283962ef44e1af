r"""The physics of one grasp of the simulated BiGS set."""

from typing import Any, NamedTuple

import numpy as np

from torch_geometric_tactile.sim._bigs_scene import CLOSED, FINGERS, HAND_MASS, OPEN, bigs_mjcf
from torch_geometric_tactile.sim._bigs_times import (
    CONTROL_RATE,
    DIRECTIONS,
    FRAME_RATE,
    INPUT_END,
)
from torch_geometric_tactile.sim._mujoco import import_mujoco
from torch_geometric_tactile.sim.bigs_plan import BigsGrasp

#: The phases of a simulated grasp with three fingertips, in order.
BIGS_PHASES = ("closing", "hold", "lift", "shake")
_TICK = 1.0 / CONTROL_RATE  # s
_FRAME = CONTROL_RATE // FRAME_RATE  # ticks
_TOUCH = 0.3  # N, at which a finger stops closing
_SQUEEZE = 0.5  # s, half of that in which the wanted force is reached
_FORCE_GAIN = 0.05  # rad per second and newton
_FASTEST = 0.4  # rad/s
_PATIENCE = 1.6  # s until pick-up if nothing is touched
_LOST = 0.03  # m by which an object that is lost has sunk in the hand
_FREE = 0.1  # s without contact, after which it is lost as well
_AFTER = 0.3  # s recorded after the loss
_CYCLES = 2  # of the shake in each direction
_TURN = 0.28  # rad, of the shake about x and y


class BigsPhysics(NamedTuple):
    r"""The forces, poses and phases of a simulated grasp, sampled :obj:`CONTROL_RATE` times a
    second.

    :obj:`force` are the forces of the object on the fingertips in their frames, x to the end of the
    finger, y across, z into the pad, :math:`(K, 3, 3)`; :obj:`normal` and :obj:`shear` their parts
    along the normal and in the plane of contact, :math:`(K, 3)`, in newtons; :obj:`place` the
    middle of the contact in the frame of the fingertip :math:`(K, 3, 3)` in metres; :obj:`slide`
    the velocity at which the object slides there, likewise, in metres per second; both zero without
    contact. :obj:`wrench` are the force in newtons and the torque in newton metres of the object on
    the hand, in its frame and about its origin, :math:`(K, 6)`. :obj:`finger` are the angles of the
    knuckles :math:`(K, 3)`, :obj:`hand` the place and turn of the hand :math:`(K, 6)`,
    :obj:`object_pose` that of the object :math:`(K, 7)`. :obj:`phase` indexes :obj:`BIGS_PHASES`.
    :obj:`pickup` is the tick at which the lift begins, :obj:`loss` that at which the object was
    lost, or none.

    Examples:
        >>> zeros = np.zeros((2, 3))
        >>> vectors, pose = np.zeros((2, 3, 3)), np.zeros((2, 7))
        >>> physics = BigsPhysics(
        ...     force=vectors, normal=zeros, shear=zeros, place=vectors, slide=vectors,
        ...     wrench=np.zeros((2, 6)), finger=zeros, hand=np.zeros((2, 6)), object_pose=pose,
        ...     phase=np.zeros(2, int), pickup=0, loss=None,
        ... )
        >>> physics.success
        True
    """

    force: np.ndarray
    normal: np.ndarray
    shear: np.ndarray
    place: np.ndarray
    slide: np.ndarray
    wrench: np.ndarray
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
    r"""Simulates one grasp with three fingertips in MuJoCo.

    Args:
        grasp (BigsGrasp): The grasp.

    Raises:
        ImportError: If MuJoCo is missing.

    Examples:
        >>> from torch_geometric_tactile.sim import draw_grasp
        >>> simulator = BigsSimulator(draw_grasp("ball", np.random.default_rng(0)))
        >>> simulator.model.opt.timestep == 1 / CONTROL_RATE
        True
        >>> simulator.run().success  # doctest: +SKIP
        True
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
        mujoco, model, data = self._mujoco, self.model, self.data
        start, target = self._start(), np.full(3, OPEN)
        motion = _hand_motion(self.grasp)
        velocity = np.diff(motion, axis=0, prepend=motion[:1]) * CONTROL_RATE
        push = np.diff(velocity, axis=0, append=velocity[-1:]) * CONTROL_RATE * HAND_MASS
        # Turns are stored as roll, pitch, yaw; the hinges are yaw, pitch, roll.
        order = np.array([0, 1, 2, 5, 4, 3])
        motion, velocity, push = motion[:, order], velocity[:, order], push[:, order]
        hand = slice(self._hand, self._hand + 6)
        hand_dof = slice(self._hand_dof, self._hand_dof + 6)
        held = slice(self._object, self._object + 7)
        log, seen = _ContactLog(model), _Course(self.grasp)
        rows: list[tuple[Any, ...]] = []
        mujoco.mj_forward(model, data)
        while not seen.is_over(len(rows), len(motion)):
            tick = len(rows)
            normal = log.add(data)
            seen.notice(tick, normal, float(data.qpos[held][2] - data.qpos[hand][2]))
            phase = seen.phase(tick)
            rows.append(
                (data.qpos[self._fingers], data.qpos[hand].copy(), data.qpos[held].copy(), phase)
            )
            # As often as frames come once all fingers touch, at every tick until then.
            every = _FRAME if seen.touched.all() else 1
            if tick % every == 0:
                self._close(target, seen, normal, tick, every * _TICK)
                data.ctrl[:] = target
            if seen.pickup is None:
                data.qpos[hand] = start
                data.qvel[hand_dof] = 0.0
            else:
                step = tick - seen.pickup
                data.qpos[hand] = start + motion[step]
                data.qvel[hand_dof] = velocity[step]
                data.qfrc_applied[hand_dof] = push[step]
            mujoco.mj_step(model, data)
        finger, moved, pose, phases = (np.array(column) for column in zip(*rows, strict=True))
        assert seen.pickup is not None
        contacts = log.finish()
        return BigsPhysics(*contacts, finger, moved[:, order], pose, phases, seen.pickup, seen.loss)

    def _start(self) -> np.ndarray:
        # Places the hand and opens the fingers.
        grasp, data = self.grasp, self.data
        roll, pitch, yaw = grasp.turn
        place = [*grasp.offset, grasp.half_height + grasp.height, yaw, pitch, roll]
        data.qpos[self._hand : self._hand + 6] = place
        data.qpos[self._fingers] = OPEN
        return np.array(place)

    def _close(
        self, target: np.ndarray, seen: "_Course", normal: np.ndarray, tick: int, dt: float
    ) -> None:
        # Fingers close until they touch; then left and right regulate their force.
        grasp, touched = self.grasp, seen.touched
        waited = tick * _TICK >= np.array(grasp.delay)
        target += grasp.speed * dt * (~touched & waited)
        if seen.first is None:
            return
        # They wait for each other, but not for long.
        since = (tick - seen.first) * _TICK
        if touched.all() or since > _SQUEEZE:
            want = grasp.grip * np.array([grasp.balance, 1.0, 2.0 - grasp.balance])
            ramp = min(1.0, since / (2 * _SQUEEZE))
            rate = _FORCE_GAIN * (_TOUCH + (want - _TOUCH) * ramp - normal)
            target[[0, 2]] += (rate * touched)[[0, 2]].clip(-_FASTEST, _FASTEST) * dt
        np.clip(target, OPEN, CLOSED, out=target)


class _Course:
    # What has happened so far: the ticks of first contact, pick-up and loss.
    def __init__(self, grasp: BigsGrasp) -> None:
        self.grasp = grasp
        self.touched = np.zeros(3, dtype=bool)
        self.first: int | None = None
        self.pickup: int | None = None
        self.loss: int | None = None
        self._height, self._free = 0.0, 0

    def is_over(self, tick: int, steps: int) -> bool:
        if self.pickup is None:
            return False
        if self.loss is None:
            return tick - self.pickup >= steps
        end = self.pickup + (INPUT_END + 0.05) * CONTROL_RATE
        end = max(end, self.loss + _AFTER * CONTROL_RATE)
        return tick > end or tick - self.pickup >= steps

    def notice(self, tick: int, normal: np.ndarray, height: float) -> None:
        # `height` is that of the object in the hand.
        self.touched |= normal > _TOUCH
        if self.first is None and self.touched.any():
            self.first = tick
        if self.pickup is None:
            begin = _PATIENCE * CONTROL_RATE
            if self.first is not None:
                begin = self.first + round(self.grasp.hold * CONTROL_RATE)
            if tick >= begin:
                self.pickup, self._height = tick, height
        elif self.loss is None:
            self._free = self._free + 1 if normal.max() == 0 else 0
            if self._height - height > _LOST or self._free > _FREE * CONTROL_RATE:
                self.loss = tick

    def phase(self, tick: int) -> int:
        if self.pickup is None:
            return int(self.first is not None)
        return 2 + int((tick - self.pickup) * _TICK >= self.grasp.pause)


def _hand_motion(grasp: BigsGrasp) -> np.ndarray:
    # By how much the hand is moved, from pick-up to the end of the shake, in steps of the physics:
    # x, y, z in metres, roll, pitch and yaw in radians (K, 6). It rises, waits, and is shaken along
    # x, y, z and about x and y, two cycles each that swell and fade. That begins later than the
    # input of P3 ends.
    time = np.arange(round(grasp.span * CONTROL_RATE)) / CONTROL_RATE
    out = np.zeros((len(time), 6))
    s = (time / grasp.lift).clip(0.0, 1.0)
    out[:, 2] = grasp.rise * s**3 * (10 - 15 * s + 6 * s**2)
    for i in range(DIRECTIONS):
        part = ((time - grasp.pause) / grasp.shake_time - i).clip(0.0, 1.0)
        swing = np.sin(np.pi * part) ** 2 * np.sin(2 * np.pi * _CYCLES * part)
        out[:, i] += swing * (grasp.shake if i < 3 else _TURN)
    return out


class _FingertipContacts(NamedTuple):
    r"""Forces, places and sliding velocities in the frames of the fingertips :math:`(K, 3, 3)`, the
    parts of the force along the normal and in the plane of contact :math:`(K, 3)`, and force and
    torque on the hand :math:`(K, 6)`.
    """

    force: np.ndarray
    normal: np.ndarray
    shear: np.ndarray
    place: np.ndarray
    slide: np.ndarray
    wrench: np.ndarray


class _ContactLog:
    r"""Keeps the contacts of fingertips and object while a simulation runs."""

    def __init__(self, model: Any) -> None:
        self._finger = np.full(model.ngeom, -1)
        self._finger[[model.geom(f"skin_{name}").id for name in FINGERS]] = range(3)
        self._site = np.array([model.site(f"tip_{name}").id for name in FINGERS])
        # Object first, then fingertips; MuJoCo gives velocities at the centre of mass of the tree.
        names = ["object", *(f"tip_{name}" for name in FINGERS)]
        self._body = np.array([model.body(name).id for name in names])
        self._hand = model.body("hand").id
        self._tree = np.array([model.body("object").id, self._hand])
        self._contacts: list[tuple[np.ndarray, ...]] = []
        self._ticks: list[tuple[np.ndarray, ...]] = []

    def add(self, data: Any) -> np.ndarray:
        r"""Keeps the contacts of now, and returns the normal force of each finger in newtons."""
        normal = np.zeros(3)
        self._ticks.append(
            (
                data.site_xmat[self._site],
                data.site_xpos[self._site],
                data.cvel[self._body],
                data.subtree_com[self._tree],
                data.xmat[self._hand].copy(),
                data.xpos[self._hand].copy(),
            )
        )
        if data.ncon:
            contact = data.contact
            address = contact.efc_address
            finger = self._finger[contact.geom]  # of both sides
            mine = np.flatnonzero((finger.max(axis=1) >= 0) & (address >= 0))
            if len(mine):
                local = data.efc_force[address[mine, None] + np.arange(3)]
                tick = np.full(len(mine), len(self._ticks) - 1)
                frame, pos = contact.frame[mine], contact.pos[mine]
                self._contacts.append((tick, finger[mine], local, frame, pos))
                np.add.at(normal, finger[mine].max(axis=1), local[:, 0])
        return normal

    def finish(self) -> _FingertipContacts:
        r"""Returns what was kept."""
        num_ticks = len(self._ticks)
        force, place, slide = np.zeros((3, num_ticks, 3, 3))
        normal, shear = np.zeros((2, num_ticks, 3))
        wrench = np.zeros((num_ticks, 6))
        result = _FingertipContacts(force, normal, shear, place, slide, wrench)
        if not self._contacts:
            return result
        tick, fingers, local, frame, pos = map(np.concatenate, zip(*self._contacts, strict=True))
        columns = map(np.array, zip(*self._ticks, strict=True))
        turn, origin, velocity, centre, hand_turn, hand_origin = columns
        finger = fingers.max(axis=1)
        sign = np.where(fingers[:, 0] >= 0, -1.0, 1.0)  # the frame points from first to second
        frame = frame.reshape(-1, 3, 3)
        turn = turn.reshape(-1, 3, 3, 3)[tick, finger]
        at = (tick, finger)
        world = sign[:, None] * np.einsum("ca,cai->ci", local, frame)
        np.add.at(force, at, np.einsum("ci,cia->ca", world, turn))
        arm = pos - hand_origin[tick]
        on_hand = np.stack([world, np.cross(arm, world)], axis=1)
        hand_turn = hand_turn.reshape(-1, 3, 3)[tick]
        np.add.at(wrench, tick, np.einsum("cki,cia->cka", on_hand, hand_turn).reshape(-1, 6))
        np.add.at(normal, at, local[:, 0])
        np.add.at(shear, at, np.hypot(local[:, 1], local[:, 2]))
        place[at] = np.einsum("ci,cia->ca", pos - origin[at], turn)

        def speed(body: Any, tree: int) -> np.ndarray:
            twist = velocity[tick, body]
            return np.asarray(twist[:, 3:] + np.cross(twist[:, :3], pos - centre[tick, tree]))

        relative = speed(0, 0) - speed(1 + finger, 1)
        out = frame[:, 0]
        relative -= out * (out * relative).sum(axis=1, keepdims=True)
        slide[at] = np.einsum("ci,cia->ca", relative, turn)
        return result
