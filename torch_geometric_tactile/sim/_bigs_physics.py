r"""The physics of one grasp of the simulated BiGS set."""

from typing import Any, NamedTuple

import numpy as np

from torch_geometric_tactile.sim._bigs_plan import BigsGrasp
from torch_geometric_tactile.sim._bigs_scene import CLOSED, FINGERS, HAND_MASS, OPEN, bigs_mjcf
from torch_geometric_tactile.sim._bigs_times import (
    CONTROL_RATE,
    FRAME_RATE,
    INPUT_END,
    NUM_SHAKE_DIRECTIONS,
)
from torch_geometric_tactile.sim._mujoco import import_mujoco

#: The phases of a simulated grasp with three fingertips, in order.
BIGS_PHASES = ("closing", "hold", "lift", "shake")
_TICK = 1.0 / CONTROL_RATE  # s
_TICKS_PER_FRAME = CONTROL_RATE // FRAME_RATE
_TOUCH_FORCE = 0.3  # N; a finger stops closing at this force
_SQUEEZE_SECONDS = 0.5  # the grip is reached after twice this time
_FORCE_GAIN = 0.05  # rad per second and newton
_MAX_FORCE_CONTROL_RATE = 0.4  # rad/s
_PICKUP_WITHOUT_CONTACT = 1.6  # s until pick-up if no finger touches the object
_LOSS_DEPTH = 0.03  # m; an object that sinks this far in the hand counts as lost
_LOSS_SECONDS = 0.1  # an object without contact for this time counts as lost
_SECONDS_AFTER_LOSS = 0.3  # recorded time after the loss
_NUM_CYCLES = 2  # cycles of the shake in each direction
_SHAKE_ANGLE = 0.28  # rad; amplitude of the shake about x and y


class BigsPhysics(NamedTuple):
    r"""The forces, poses and phases of a simulated grasp, sampled :obj:`CONTROL_RATE` times per
    second (:math:`K` ticks). The second dimension of fields with fingertips is left, middle, right.

    Shapes:
        - **force:** forces in newtons that the object exerts on the fingertips, in the frames of
          the fingertips (x to the end of the finger, y across, z into the pad) :math:`(K, 3, 3)`
        - **normal:** normal force in newtons :math:`(K, 3)`
        - **shear:** force in newtons in the plane of contact :math:`(K, 3)`
        - **place:** centre of the contact in metres in the frame of the fingertip, zero without
          contact :math:`(K, 3, 3)`
        - **slide:** sliding velocity of the object in metres per second in the frame of the
          fingertip, zero without contact :math:`(K, 3, 3)`
        - **wrench:** force in newtons and torque in newton metres that the object exerts on the
          hand, in the frame and about the origin of the hand :math:`(K, 6)`
        - **finger:** angles of the knuckles in radians :math:`(K, 3)`
        - **hand:** position in metres and roll, pitch and yaw in radians of the hand
          :math:`(K, 6)`
        - **object_pose:** position and quaternion of the object :math:`(K, 7)`
        - **phase:** indices into :obj:`BIGS_PHASES` :math:`(K,)`
        - **pickup:** tick at which the lift begins
        - **loss:** tick at which the object was lost, or :obj:`None`

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
        r"""Whether the object was still in the hand after the shake."""
        return self.loss is None


class BigsSimulator:
    r"""A simulator of one grasp with three fingertips in MuJoCo.

    Args:
        grasp (BigsGrasp): The grasp.

    Raises:
        ImportError: If MuJoCo is missing.

    Examples:
        >>> from torch_geometric_tactile.sim._bigs_plan import draw_grasp
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
        # Addresses of the joints in the state of MuJoCo.
        self._object = model.joint("object").qposadr[0]
        self._hand = model.joint("hand_x").qposadr[0]
        self._hand_dof = model.joint("hand_x").dofadr[0]
        self._fingers = np.array([model.joint(name).qposadr[0] for name in FINGERS])

    def run(self) -> BigsPhysics:
        r"""Runs the grasp until the end of the shake, or until shortly after the object is lost,
        but at least until the end of the input of P3. Returns the physics of the grasp.
        """
        mujoco, model, data = self._mujoco, self.model, self.data
        start, target = self._place_hand(), np.full(3, OPEN)
        motion = _hand_motion(self.grasp)
        velocity = np.diff(motion, axis=0, prepend=motion[:1]) * CONTROL_RATE
        push = np.diff(velocity, axis=0, append=velocity[-1:]) * CONTROL_RATE * HAND_MASS
        # Rotations are stored as roll, pitch, yaw; the hinges are yaw, pitch, roll.
        order = np.array([0, 1, 2, 5, 4, 3])
        motion, velocity, push = motion[:, order], velocity[:, order], push[:, order]
        hand = slice(self._hand, self._hand + 6)
        hand_dof = slice(self._hand_dof, self._hand_dof + 6)
        item = slice(self._object, self._object + 7)
        log, progress = _ContactLog(model), _GraspProgress(self.grasp)
        rows: list[tuple[Any, ...]] = []
        mujoco.mj_forward(model, data)
        while not progress.is_over(len(rows), len(motion)):
            tick = len(rows)
            normal = log.add(data)
            progress.update(tick, normal, float(data.qpos[item][2] - data.qpos[hand][2]))
            phase = progress.phase(tick)
            rows.append(
                (data.qpos[self._fingers], data.qpos[hand].copy(), data.qpos[item].copy(), phase)
            )
            # Before contact, every tick is checked, so that contact is detected immediately. After
            # contact, the frame rate suffices.
            interval = _TICKS_PER_FRAME if progress.touched.all() else 1
            if tick % interval == 0:
                self._close_fingers(target, progress, normal, tick, interval * _TICK)
                data.ctrl[:] = target
            if progress.pickup is None:
                data.qpos[hand] = start
                data.qvel[hand_dof] = 0.0
            else:
                step = tick - progress.pickup
                data.qpos[hand] = start + motion[step]
                data.qvel[hand_dof] = velocity[step]
                data.qfrc_applied[hand_dof] = push[step]
            mujoco.mj_step(model, data)
        finger, hand_pose, pose, phases = (np.array(column) for column in zip(*rows, strict=True))
        assert progress.pickup is not None
        contacts = log.to_fingertip_contacts()
        return BigsPhysics(
            *contacts, finger, hand_pose[:, order], pose, phases, progress.pickup, progress.loss
        )

    def _place_hand(self) -> np.ndarray:
        # Places the hand, opens the fingers, and returns the joint positions of the hand.
        grasp, data = self.grasp, self.data
        roll, pitch, yaw = grasp.turn
        hand_pose = [*grasp.offset, grasp.half_height + grasp.height, yaw, pitch, roll]
        data.qpos[self._hand : self._hand + 6] = hand_pose
        data.qpos[self._fingers] = OPEN
        return np.array(hand_pose)

    def _close_fingers(
        self,
        target: np.ndarray,
        progress: "_GraspProgress",
        normal: np.ndarray,
        tick: int,
        dt: float,
    ) -> None:
        # Fingers close until they touch. Then the left and right fingers control their force, and
        # the middle finger, which opposes both, does not move.
        grasp, touched = self.grasp, progress.touched
        has_started = tick * _TICK >= np.array(grasp.delay)
        target += grasp.speed * dt * (~touched & has_started)
        if progress.first_contact is None:
            return
        # Force control starts when all fingers touch, or after a limited waiting time.
        contact_seconds = (tick - progress.first_contact) * _TICK
        if touched.all() or contact_seconds > _SQUEEZE_SECONDS:
            desired = grasp.grip * np.array([grasp.balance, 1.0, 2.0 - grasp.balance])
            ramp = min(1.0, contact_seconds / (2 * _SQUEEZE_SECONDS))
            rate = _FORCE_GAIN * (_TOUCH_FORCE + (desired - _TOUCH_FORCE) * ramp - normal)
            limit = _MAX_FORCE_CONTROL_RATE
            target[[0, 2]] += (rate * touched)[[0, 2]].clip(-limit, limit) * dt
        np.clip(target, OPEN, CLOSED, out=target)


class _GraspProgress:
    # The ticks of first contact, pick-up and loss, once they have occurred.
    def __init__(self, grasp: BigsGrasp) -> None:
        self.grasp = grasp
        self.touched = np.zeros(3, dtype=bool)
        self.first_contact: int | None = None
        self.pickup: int | None = None
        self.loss: int | None = None
        self._pickup_height, self._ticks_without_contact = 0.0, 0

    def is_over(self, tick: int, num_steps: int) -> bool:
        if self.pickup is None:
            return False
        if self.loss is None:
            return tick - self.pickup >= num_steps
        end = self.pickup + (INPUT_END + 0.05) * CONTROL_RATE
        end = max(end, self.loss + _SECONDS_AFTER_LOSS * CONTROL_RATE)
        return tick > end or tick - self.pickup >= num_steps

    def update(self, tick: int, normal: np.ndarray, height: float) -> None:
        # `height` is the height of the object relative to the hand.
        self.touched |= normal > _TOUCH_FORCE
        if self.first_contact is None and self.touched.any():
            self.first_contact = tick
        if self.pickup is None:
            pickup = _PICKUP_WITHOUT_CONTACT * CONTROL_RATE
            if self.first_contact is not None:
                pickup = self.first_contact + round(self.grasp.hold * CONTROL_RATE)
            if tick >= pickup:
                self.pickup, self._pickup_height = tick, height
        elif self.loss is None:
            without_contact = self._ticks_without_contact
            self._ticks_without_contact = without_contact + 1 if normal.max() == 0 else 0
            is_free = self._ticks_without_contact > _LOSS_SECONDS * CONTROL_RATE
            if self._pickup_height - height > _LOSS_DEPTH or is_free:
                self.loss = tick

    def phase(self, tick: int) -> int:
        if self.pickup is None:
            return int(self.first_contact is not None)
        return 2 + int((tick - self.pickup) * _TICK >= self.grasp.pause)


def _hand_motion(grasp: BigsGrasp) -> np.ndarray:
    # The displacement of the hand from pick-up to the end of the shake in steps of the physics:
    # x, y, z in metres, and roll, pitch and yaw in radians (K, 6). The hand rises, waits, and is
    # shaken along x, y, z and about x and y. Each shake has two cycles with growing and falling
    # amplitude. Shaking begins after the end of the input of P3.
    time = np.arange(round(grasp.span * CONTROL_RATE)) / CONTROL_RATE
    motion = np.zeros((len(time), 6))
    s = (time / grasp.lift).clip(0.0, 1.0)
    motion[:, 2] = grasp.rise * s**3 * (10 - 15 * s + 6 * s**2)
    for i in range(NUM_SHAKE_DIRECTIONS):
        progress = ((time - grasp.pause) / grasp.shake_time - i).clip(0.0, 1.0)
        swing = np.sin(np.pi * progress) ** 2 * np.sin(2 * np.pi * _NUM_CYCLES * progress)
        motion[:, i] += swing * (grasp.shake if i < 3 else _SHAKE_ANGLE)
    return motion


class _FingertipContacts(NamedTuple):
    r"""Contacts of the fingertips: forces, positions and sliding velocities in the frames of the
    fingertips :math:`(K, 3, 3)`, normal force and force in the plane of contact :math:`(K, 3)`, and
    force and torque on the hand :math:`(K, 6)`.
    """

    force: np.ndarray
    normal: np.ndarray
    shear: np.ndarray
    place: np.ndarray
    slide: np.ndarray
    wrench: np.ndarray


class _ContactLog:
    r"""A log of the contacts between fingertips and object during a simulation."""

    def __init__(self, model: Any) -> None:
        self._finger = np.full(model.ngeom, -1)  # finger of each geometry, -1 if none
        self._finger[[model.geom(f"skin_{name}").id for name in FINGERS]] = range(3)
        self._site = np.array([model.site(f"tip_{name}").id for name in FINGERS])
        # The object is first, then the fingertips. MuJoCo returns velocities at the centre of mass
        # of a tree.
        names = ["object", *(f"tip_{name}" for name in FINGERS)]
        self._body = np.array([model.body(name).id for name in names])
        self._hand = model.body("hand").id
        self._tree = np.array([model.body("object").id, self._hand])
        self._contacts: list[tuple[np.ndarray, ...]] = []
        self._ticks: list[tuple[np.ndarray, ...]] = []

    def add(self, data: Any) -> np.ndarray:
        r"""Records the contacts of the current tick, and returns the normal force of each finger in
        newtons.
        """
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
            finger = self._finger[contact.geom]  # of both geometries of a contact
            with_finger = np.flatnonzero((finger.max(axis=1) >= 0) & (address >= 0))
            if len(with_finger):
                local = data.efc_force[address[with_finger, None] + np.arange(3)]
                tick = np.full(len(with_finger), len(self._ticks) - 1)
                frame, pos = contact.frame[with_finger], contact.pos[with_finger]
                self._contacts.append((tick, finger[with_finger], local, frame, pos))
                np.add.at(normal, finger[with_finger].max(axis=1), local[:, 0])
        return normal

    def to_fingertip_contacts(self) -> _FingertipContacts:
        r"""Returns the recorded contacts in the frames of the fingertips and of the hand."""
        num_ticks = len(self._ticks)
        force, place, slide = np.zeros((3, num_ticks, 3, 3))
        normal, shear = np.zeros((2, num_ticks, 3))
        wrench = np.zeros((num_ticks, 6))
        contacts = _FingertipContacts(force, normal, shear, place, slide, wrench)
        if not self._contacts:
            return contacts
        tick, fingers, local, frame, pos = map(np.concatenate, zip(*self._contacts, strict=True))
        columns = map(np.array, zip(*self._ticks, strict=True))
        rotation, origin, velocity, centre, hand_rotation, hand_origin = columns
        finger = fingers.max(axis=1)
        # The frame of a contact points from its first geometry to its second.
        sign = np.where(fingers[:, 0] >= 0, -1.0, 1.0)
        frame = frame.reshape(-1, 3, 3)
        rotation = rotation.reshape(-1, 3, 3, 3)[tick, finger]
        index = (tick, finger)
        world = sign[:, None] * np.einsum("ca,cai->ci", local, frame)
        np.add.at(force, index, np.einsum("ci,cia->ca", world, rotation))
        arm = pos - hand_origin[tick]
        world_wrench = np.stack([world, np.cross(arm, world)], axis=1)
        hand_rotation = hand_rotation.reshape(-1, 3, 3)[tick]
        hand_wrench = np.einsum("cki,cia->cka", world_wrench, hand_rotation)
        np.add.at(wrench, tick, hand_wrench.reshape(-1, 6))
        np.add.at(normal, index, local[:, 0])
        np.add.at(shear, index, np.hypot(local[:, 1], local[:, 2]))
        place[index] = np.einsum("ci,cia->ca", pos - origin[index], rotation)

        def contact_velocity(body: Any, tree: int) -> np.ndarray:
            twist = velocity[tick, body]
            return np.asarray(twist[:, 3:] + np.cross(twist[:, :3], pos - centre[tick, tree]))

        relative = contact_velocity(0, 0) - contact_velocity(1 + finger, 1)
        contact_normal = frame[:, 0]
        relative -= contact_normal * (contact_normal * relative).sum(axis=1, keepdims=True)
        slide[index] = np.einsum("ci,cia->ca", relative, rotation)
        return contacts
