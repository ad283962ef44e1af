r"""One grasp of the simulated hand: plan, physics, forces."""

from typing import Any, NamedTuple

import numpy as np
import torch

from torch_geometric_tactile.sensors import HandKinematics, TaxelLayout
from torch_geometric_tactile.sim._hand_motion import (
    JOINT_TREMOR,
    palm_path,
    postures,
    timed_phases,
    tremor,
)
from torch_geometric_tactile.sim._mujoco import import_mujoco
from torch_geometric_tactile.sim.hand_model import ContactParameters, grasp_mjcf
from torch_geometric_tactile.sim.objects import GraspObject
from torch_geometric_tactile.sim.spread import GraspSpread

#: The phases of a simulated grasp, in order.
PHASES = ("hover", "reach", "close", "squeeze", "lift", "hold")

# Shortest and longest duration of each phase but the last, in seconds of a trial of 17 s.
_SCHEDULE = ((1.2, 2.2), (2.0, 3.0), (2.2, 3.2), (0.6, 1.4), (1.8, 2.6))
_FULL_LENGTH = 17.0
_SQUEEZE = (0.0, 0.10, 0.10, 0.10) * 3 + (0.0, 0.0, 0.10, 0.10)
_LIFTED = 0.05  # height above the stand that counts, m


class GraspPlan(NamedTuple):
    r"""A planned grasp: the target pose of palm and fingers every :obj:`step` seconds.

    :obj:`gantry` are x, y, z (metres) and yaw (radians) of the palm :math:`(K, 4)`, :obj:`joint`
    the joint targets (radians) :math:`(K, 16)` and :obj:`phase` indices into :obj:`PHASES`
    :math:`(K,)`.

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
        r"""Whether the attempt has failed.

        Args:
            tick (int): Which of the steps.
            moved (numpy.ndarray): How far the object is from where it was, in metres :math:`(3,)`.
        """
        return bool(self.phase[tick] == len(PHASES) - 1 and moved[2] < _LIFTED)

    def is_done(self, phase: np.ndarray, force: np.ndarray, layout: TaxelLayout) -> bool:
        r"""Whether an attempt that was not given up is a success.

        Args:
            phase (numpy.ndarray): The phases of the frames :math:`(T,)`.
            force (numpy.ndarray): The forces on the taxels in newtons :math:`(T, N, 3)`.
            layout (TaxelLayout): The taxels.
        """
        return True


class GraspResult(NamedTuple):
    r"""The recorded forces, joint angles and poses of a simulated grasp, and whether it succeeded.

    :obj:`force` are the clean forces in the frames of the taxels :math:`(T, N, 3)` in newtons:
    shear that the object exerts along :math:`x` and :math:`y`, and pressure :math:`z`, positive
    where it presses. :obj:`bone_force` is the sum of normal forces on the bones :math:`(T,)`,
    :obj:`support` the force of the hand on the object in the world's frame :math:`(T, 3)`,
    :obj:`object_pose` and :obj:`palm_pose` are positions and quaternions :math:`(T, 7)`.
    :obj:`success` tells whether the plan was fulfilled: the object lifted and held, or squeezed.

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
    r"""Plans a grasp from above that knows the size of the object, but not its mass, friction and
    softness, as an operator who only sees it.

    Args:
        size (tuple of float): Full extent of the object in metres.
        rng (numpy.random.Generator): Draws durations, alignment errors and tremor.
        duration (float): Length of the trial in seconds; the phases are scaled with it.
        step (float): Time between targets in seconds.
        spread (GraspSpread, optional): How large the errors are.

    Raises:
        ValueError: If the step is not positive, or longer than the trial.

    Examples:
        >>> plan = plan_grasp((0.07, 0.1, 0.06), np.random.default_rng(0), duration=5.0, step=0.02)
        >>> plan.gantry.shape, plan.joint.shape
        ((250, 4), (250, 16))
    """
    spread = spread or GraspSpread()
    ticks, phase, progress, _ = timed_phases(_SCHEDULE, _FULL_LENGTH, rng, duration, step)
    _, reach, close, squeeze, lift = progress
    rise = rng.uniform(0.09, 0.13) * lift
    gantry = palm_path(size, rng, spread, step, reach, close, rise)
    start, end = postures(rng, spread)
    firmness = rng.uniform(0.6, 1.4)
    shake = tremor(rng, step, (len(ticks), 16), sd=JOINT_TREMOR)
    joint = start + spread.close_less(end - start, rng) * close[:, None]
    joint += firmness * np.array(_SQUEEZE) * squeeze[:, None]
    joint += shake
    return GraspPlan(gantry, joint, phase, step)


class GraspSimulator:
    r"""Simulates grasps of one object with an Allegro hand in MuJoCo.

    Args:
        layout (TaxelLayout): The taxels.
        kinematics (HandKinematics): The hand that carries them.
        item (GraspObject): The object.
        parameters (ContactParameters, optional): How things touch.

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
        # Which taxel a geometry is: -1 a bone, -2 anything else.
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
        r"""Returns the forces on the taxels :math:`(N, 3)` now, the sum on the bones, and the force
        of the hand on the object :math:`(3,)`, in newtons.
        """
        out, bones, support = np.zeros((self.layout.num_taxels, 3)), 0.0, np.zeros(3)
        data = self.data
        contact = data.contact
        touching = contact.efc_address >= 0
        geom = contact.geom[touching]
        if len(geom) == 0:
            return out, bones, support
        # With elliptic cones `efc_force` is the force in the frame of the contact.
        address = contact.efc_address[touching]
        local = data.efc_force[address[:, None] + np.arange(3)]
        world = np.einsum("ca,cai->ci", local, contact.frame[touching].reshape(-1, 3, 3))
        for side, sign in ((0, -1.0), (1, 1.0)):  # the frame points from the first to the second
            taxel = self._taxel[geom[:, side]]
            bones += float(local[taxel == -1, 0].sum())
            support -= sign * world[taxel >= -1].sum(axis=0)
            on_skin = taxel >= 0
            taxel = taxel[on_skin]
            turn = data.xmat[self._body[taxel]].reshape(-1, 3, 3) @ self._axes[taxel]
            force = sign * np.einsum("ci,cia->ca", world[on_skin], turn)
            force[:, 2] *= -1.0  # the normal points outwards, pressure inwards: TaxelLayout.axes
            np.add.at(out, taxel, force)
        return out, bones, support

    def run(self, plan: GraspPlan, rate: float = 100.0) -> GraspResult:
        r"""Runs a plan; gives up early on an object that was not lifted, that fell or that left.

        Args:
            plan (GraspPlan): What the hand shall do.
            rate (float): Frames recorded per second.

        Raises:
            ValueError: If a frame is not a whole number of the plan's steps, or one of them not a
                whole number of time steps of the physics.
        """
        every = _whole("rate", 1 / rate, plan.step)
        substeps = _whole("plan.step", plan.step, self.model.opt.timestep)
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
            if tick % every == every - 1:
                pose = data.qpos[self._object : self._object + 7].copy()
                palm = np.concatenate([data.xpos[self._palm], data.xquat[self._palm]])
                joint = data.qpos[self._joints].copy()
                frames.append((data.time, joint, *self.forces(), pose, palm))
                if plan.gives_up(tick, pose[:3] - start):
                    success = False
                    break
        columns = [np.array(column) for column in zip(*frames, strict=True)]
        time, joint, force, bones, support, pose, palm = columns
        phase = plan.phase[every - 1 :: every][: len(time)].astype(np.int64)
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


def _whole(name: str, length: float, step: float) -> int:
    count = round(length / step)
    if count < 1 or abs(count * step - length) > 1e-9:
        raise ValueError(
            f"'{name}' must make {length:g} s a whole number of steps of {step:g} s "
            f"(got {length / step:g})"
        )
    return count
