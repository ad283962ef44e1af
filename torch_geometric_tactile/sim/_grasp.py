r"""A grasp with the simulated hand: plan, physics and forces."""

from typing import Any, NamedTuple

import numpy as np
import torch

from torch_geometric_tactile.sensors import HandKinematics, TaxelLayout
from torch_geometric_tactile.sim._hand_motion import (
    JOINT_TREMOR,
    draw_phases,
    draw_postures,
    palm_path,
    tremor,
)
from torch_geometric_tactile.sim._mujoco import import_mujoco
from torch_geometric_tactile.sim.hand_model import ContactParameters, grasp_mjcf
from torch_geometric_tactile.sim.objects import GraspObject
from torch_geometric_tactile.sim.spread import GraspSpread

#: The phases of a simulated grasp, in order.
PHASES = ("hover", "reach", "close", "squeeze", "lift", "hold")

# Shortest and longest duration of each phase except the last, in seconds of a trial of 17 s.
_SCHEDULE = ((1.2, 2.2), (2.0, 3.0), (2.2, 3.2), (0.6, 1.4), (1.8, 2.6))
_FULL_LENGTH = 17.0  # s
_SQUEEZE_ANGLES = (0.0, 0.10, 0.10, 0.10) * 3 + (0.0, 0.0, 0.10, 0.10)  # rad
_MIN_LIFT = 0.05  # m; at this height an object counts as lifted


class GraspPlan(NamedTuple):
    r"""A planned grasp: the target pose of the palm and the fingers every :obj:`step` seconds.

    Shapes:
        - **gantry:** position x, y, z in metres and yaw in radians of the palm :math:`(K, 4)`
        - **joint:** target angles of the joints in radians :math:`(K, 16)`
        - **phase:** indices into :obj:`PHASES` :math:`(K,)`

    Examples:
        >>> plan = plan_grasp((0.07, 0.1, 0.06), np.random.default_rng(0))
        >>> plan.joint.shape, plan.step
        ((1700, 16), 0.01)
        >>> plan.phase_names[plan.phase[-1]]
        'hold'
    """

    gantry: np.ndarray
    joint: np.ndarray
    phase: np.ndarray
    step: float

    @property
    def phase_names(self) -> tuple[str, ...]:
        r"""The names of the phases."""
        return PHASES

    def gives_up(self, tick: int, moved: np.ndarray) -> bool:
        r"""Returns whether the attempt has failed, because the object is not lifted in the last
        phase.

        Args:
            tick (int): Index of the step.
            moved (numpy.ndarray): Displacement of the object from its initial position in metres
                :math:`(3,)`.
        """
        return bool(self.phase[tick] == len(PHASES) - 1 and moved[2] < _MIN_LIFT)

    def is_done(self, phase: np.ndarray, force: np.ndarray, layout: TaxelLayout) -> bool:
        r"""Returns whether an attempt that ran to its end is a success. A grasp is always a
        success.

        Args:
            phase (numpy.ndarray): The phases of the frames :math:`(T,)`.
            force (numpy.ndarray): The forces on the taxels in newtons :math:`(T, N, 3)`.
            layout (TaxelLayout): The taxels.
        """
        return True


class GraspResult(NamedTuple):
    r"""The recorded forces, joint angles and poses of a simulated grasp, and its success.

    Shapes:
        - **time:** time in seconds :math:`(T,)`
        - **joint:** joint angles in radians :math:`(T, 16)`
        - **force:** forces without noise in newtons, in the frames of the taxels: shear that the
          object exerts along :math:`x` and :math:`y`, and pressure :math:`z`, which is positive if
          the object presses :math:`(T, N, 3)`
        - **bone_force:** sum of the normal forces on the bones in newtons :math:`(T,)`
        - **support:** force in newtons that the hand exerts on the object, in the world frame
          :math:`(T, 3)`
        - **object_pose, palm_pose:** positions and quaternions :math:`(T, 7)`
        - **phase:** indices into the phases of the plan :math:`(T,)`
        - **success:** whether the object was lifted and held, or squeezed

    Examples:
        >>> result = GraspResult(
        ...     time=np.zeros(2), joint=np.zeros((2, 16)), force=np.full((2, 384, 3), 0.01),
        ...     bone_force=np.zeros(2), support=np.zeros((2, 3)), object_pose=np.zeros((2, 7)),
        ...     palm_pose=np.zeros((2, 7)), phase=np.zeros(2, int), success=True,
        ... )
        >>> result.force[0, :, 2].sum().round(2)  # newtons of pressure in the first frame
        np.float64(3.84)
    """

    time: np.ndarray
    joint: np.ndarray
    force: np.ndarray
    bone_force: np.ndarray
    support: np.ndarray
    object_pose: np.ndarray
    palm_pose: np.ndarray
    phase: np.ndarray
    success: bool


def plan_grasp(
    size: tuple[float, float, float],
    rng: np.random.Generator,
    duration: float = _FULL_LENGTH,
    step: float = 0.01,
    spread: GraspSpread | None = None,
) -> GraspPlan:
    r"""Returns the plan of a grasp from above. The plan depends on the size of the object, but not
    on its mass, friction and softness, as for an operator who only sees the object.

    Args:
        size (tuple of float): Full extent of the object in metres.
        rng (numpy.random.Generator): The random number generator for durations, alignment
            errors and tremor.
        duration (float): Duration of the trial in seconds. The phases are scaled accordingly.
        step (float): Time between targets in seconds.
        spread (GraspSpread, optional): Size of the alignment errors.

    Raises:
        ValueError: If the step is not positive or is longer than the trial.

    Examples:
        >>> plan = plan_grasp((0.07, 0.1, 0.06), np.random.default_rng(0), duration=5.0, step=0.02)
        >>> plan.gantry.shape, plan.joint.shape
        ((250, 4), (250, 16))
    """
    spread = spread or GraspSpread()
    ticks, phase, progress, _ = draw_phases(_SCHEDULE, _FULL_LENGTH, rng, duration, step)
    _, reach, close, squeeze, lift = progress
    rise = rng.uniform(0.09, 0.13) * lift
    gantry = palm_path(size, rng, spread, step, reach, close, rise)
    open_hand, closed_hand = draw_postures(rng, spread)
    firmness = rng.uniform(0.6, 1.4)
    joint_tremor = tremor(rng, step, (len(ticks), 16), sd=JOINT_TREMOR)
    joint = open_hand + spread.close_less(closed_hand - open_hand, rng) * close[:, None]
    joint += firmness * np.array(_SQUEEZE_ANGLES) * squeeze[:, None]
    joint += joint_tremor
    return GraspPlan(gantry, joint, phase, step)


class GraspSimulator:
    r"""A simulator of grasps of one object with an Allegro hand in MuJoCo.

    Args:
        layout (TaxelLayout): The taxels.
        kinematics (HandKinematics): The hand that carries the taxels.
        item (GraspObject): The object.
        parameters (ContactParameters, optional): Parameters of contacts and joints.

    Raises:
        ImportError: If MuJoCo is missing.

    Examples:
        >>> from torch_geometric_tactile.sensors import HandKinematics, allegro_uskin
        >>> from torch_geometric_tactile.sim import paper8
        >>> hand = allegro_uskin(), HandKinematics.allegro()
        >>> simulator = GraspSimulator(*hand, paper8()[1])
        >>> plan = plan_grasp(paper8()[1].size, np.random.default_rng(0))
        >>> start = GraspPlan(plan.gantry[:10], plan.joint[:10], plan.phase[:10], plan.step)
        >>> simulator.run(start, 100.0).force.shape  # newtons on each taxel in each frame
        (10, 384, 3)
    """

    def __init__(
        self,
        layout: TaxelLayout,
        kinematics: HandKinematics,
        item: GraspObject,
        parameters: ContactParameters | None = None,
    ) -> None:
        self._mujoco = import_mujoco()
        self.layout = layout
        self.item = item
        mjcf = grasp_mjcf(layout, kinematics, item, parameters)
        self.model = model = self._mujoco.MjModel.from_xml_string(mjcf)
        self.data = self._mujoco.MjData(model)
        # The taxel of each geometry: -1 for a bone, -2 for other geometries.
        self._taxel = np.full(model.ngeom, -2)
        self._body = np.empty(layout.num_taxels, dtype=int)
        for i in range(model.ngeom):
            name = model.geom(i).name
            if name.startswith("bone_"):
                self._taxel[i] = -1
            elif name.startswith("taxel_"):
                taxel = int(name.removeprefix("taxel_"))
                self._taxel[i] = taxel
                self._body[taxel] = model.geom(i).bodyid[0]
        self._axes = layout.axes(torch.double).mT.numpy()
        gantry = [f"gantry_{name}" for name in ("x", "y", "z", "yaw")]
        self._gantry, self._joints = (
            np.array([model.joint(name).qposadr[0] for name in names])
            for names in (gantry, kinematics.joint_names)
        )
        self._object = model.joint("object").qposadr[0]
        self._palm = model.body(kinematics.link_names[0]).id

    def forces(self) -> tuple[np.ndarray, float, np.ndarray]:
        r"""Returns the current forces in newtons: the forces on the taxels :math:`(N, 3)`, the sum
        of the normal forces on the bones, and the force of the hand on the object :math:`(3,)`.
        """
        taxel_force, bone_force = np.zeros((self.layout.num_taxels, 3)), 0.0
        support = np.zeros(3)
        data = self.data
        contact = data.contact
        is_active = contact.efc_address >= 0
        geom = contact.geom[is_active]
        if len(geom) == 0:
            return taxel_force, bone_force, support
        # With elliptic cones `efc_force` is the force in the frame of the contact.
        address = contact.efc_address[is_active]
        local = data.efc_force[address[:, None] + np.arange(3)]
        world = np.einsum("ca,cai->ci", local, contact.frame[is_active].reshape(-1, 3, 3))
        # The frame of a contact points from its first geometry to its second.
        for side, sign in ((0, -1.0), (1, 1.0)):
            taxel = self._taxel[geom[:, side]]
            bone_force += float(local[taxel == -1, 0].sum())
            support -= sign * world[taxel >= -1].sum(axis=0)
            on_skin = taxel >= 0
            taxel = taxel[on_skin]
            rotation = data.xmat[self._body[taxel]].reshape(-1, 3, 3) @ self._axes[taxel]
            force = sign * np.einsum("ci,cia->ca", world[on_skin], rotation)
            # The normal of TaxelLayout.axes points outwards, but pressure counts inwards.
            force[:, 2] *= -1.0
            np.add.at(taxel_force, taxel, force)
        return taxel_force, bone_force, support

    def run(self, plan: GraspPlan, rate: float = 100.0) -> GraspResult:
        r"""Runs a plan and returns the result. Stops early if the attempt fails, for example if the
        object falls.

        Args:
            plan (GraspPlan): The targets of the palm and the fingers.
            rate (float): Number of recorded frames per second.

        Raises:
            ValueError: If a frame is not a whole number of steps of the plan, or a step of the plan
                not a whole number of time steps of the physics.
        """
        steps_per_frame = _num_steps("rate", 1 / rate, plan.step)
        substeps = _num_steps("plan.step", plan.step, self.model.opt.timestep)
        mujoco, model, data = self._mujoco, self.model, self.data
        mujoco.mj_resetData(model, data)
        data.qpos[self._gantry] = plan.gantry[0]
        data.qpos[self._joints] = plan.joint[0]
        mujoco.mj_forward(model, data)
        start = data.qpos[self._object : self._object + 3].copy()
        frames: list[tuple[Any, ...]] = []
        success = True
        for tick in range(len(plan.phase)):
            data.ctrl[:4] = plan.gantry[tick]
            data.ctrl[4:] = plan.joint[tick]
            mujoco.mj_step(model, data, substeps)
            if tick % steps_per_frame == steps_per_frame - 1:
                pose = data.qpos[self._object : self._object + 7].copy()
                palm = np.concatenate([data.xpos[self._palm], data.xquat[self._palm]])
                joint = data.qpos[self._joints].copy()
                frames.append((data.time, joint, *self.forces(), pose, palm))
                if plan.gives_up(tick, pose[:3] - start):
                    success = False
                    break
        columns = [np.array(column) for column in zip(*frames, strict=True)]
        time, joint, force, bones, support, pose, palm = columns
        phase = plan.phase[steps_per_frame - 1 :: steps_per_frame][: len(time)].astype(np.int64)
        return GraspResult(
            time=time,
            joint=joint.astype(np.float32),
            force=force.astype(np.float32),
            bone_force=bones.astype(np.float32),
            support=support.astype(np.float32),
            object_pose=pose,
            palm_pose=palm,
            phase=phase,
            success=success and plan.is_done(phase, force, self.layout),
        )


def _num_steps(name: str, length: float, step: float) -> int:
    num_steps = round(length / step)
    if num_steps < 1 or abs(num_steps * step - length) > 1e-9:
        raise ValueError(
            f"'{name}' must make {length:g} s a whole number of steps of {step:g} s "
            f"(got {length / step:g})"
        )
    return num_steps
