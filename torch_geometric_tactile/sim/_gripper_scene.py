r"""A MuJoCo scene: a parallel gripper with two pads of elastic taxels around a box on a table."""

from functools import cache

import numpy as np
import torch

from torch_geometric_tactile.sensors import TaxelLayout, grid
from torch_geometric_tactile.sim.lift_object import LiftObject

FINGERS = ("left", "right")
TIMESTEP = 0.002  # s
GRAVITY = 9.81  # m/s^2
NORMAL_STIFFNESS, SHEAR_STIFFNESS = 600.0, 500.0  # N/m, of a taxel
OBJECT_HEIGHT = 0.06  # m; the pads grip the middle
_CROWN_RADIUS = 0.1  # m, of the crowned pads: outer taxels touch later and slip first
TIP_RADIUS = 0.0005  # m, of the sphere at the surface of a taxel: small, so that edges hold none
_NORMAL_DAMPING, _SHEAR_DAMPING = 0.3, 1.0  # Ns/m, of a taxel
# kg. A contact in MuJoCo is as stiff as the masses in contact: without this inertia, taxels would
# creep along the object and excite it.
_ARMATURE = 0.004
_FINGER_MASS, _GRIPPER_MASS = 0.05, 0.5  # kg
_FINGER_DAMPING = 30.0  # Ns/m; at the smallest squeeze, the pads close at 20 mm/s
_LIFT_GAIN, _LIFT_DAMPING = 3000.0, 100.0  # N/m, Ns/m
_TABLE_FRICTION = 0.4
_FOOT_BREADTH, _FOOT_HEIGHT = 0.04, 0.012  # m, on which also a narrow object stands
MAX_PAD_HEIGHT = OBJECT_HEIGHT - 2 * _FOOT_HEIGHT  # m


@cache
def default_pad() -> TaxelLayout:
    r"""Returns the default pad: 4 x 4 taxels, 5 mm apart."""
    return grid(4, 4, 0.005)


def pad_positions(pad: TaxelLayout) -> np.ndarray:
    r"""Returns the positions of the taxels of a pad relative to its middle, in metres: sideways and
    upwards :math:`(N, 2)`. The columns of the pad are upright.

    Raises:
        ValueError: If the taxels are not in one plane with normals along :math:`z`, or if the pad
            is higher than the object.
    """
    pos = pad.pos.double()
    axes = pad.axes(torch.double)
    if not torch.allclose(pos[:, 2], pos[:1, 2]) or not torch.allclose(
        axes, torch.eye(3, dtype=torch.double).expand_as(axes), atol=1e-6
    ):
        raise ValueError(
            "'pad' must be flat, with the axes x, y and z for all taxels, such as grid(4, 4, "
            f"0.005) (got '{pad.name}')"
        )
    plane = pos[:, :2].numpy()
    if np.ptp(plane[:, 1]) > MAX_PAD_HEIGHT:
        raise ValueError(
            f"'pad' must be at most {MAX_PAD_HEIGHT} m high, because the object is {OBJECT_HEIGHT} "
            f"m high and stands on a foot (got {np.ptp(plane[:, 1]):.4f} m)"
        )
    middle: np.ndarray = (plane.min(axis=0) + plane.max(axis=0)) / 2
    return plane - middle


def _crown_height(position: np.ndarray) -> np.ndarray:
    r"""Returns the distance in metres of each taxel behind the middle of the crowned pad
    :math:`(N,)`.
    """
    height: np.ndarray = (position**2).sum(axis=1) / (2 * _CROWN_RADIUS)
    return height


def normal_forces(position: np.ndarray, squeeze: float) -> np.ndarray:
    r"""Returns the normal force, in newtons, on each taxel that touches a flat face :math:`(N,)`.

    Args:
        position (numpy.ndarray): The taxels in the plane of the pad in metres :math:`(N, 2)`.
        squeeze (float): Sum of the normal forces in newtons.
    """
    height = _crown_height(position)
    level = np.sort(height)
    num_taxels = np.arange(1, len(level) + 1)
    # The depth of the face if exactly the first k taxels touch. The solution is the largest depth
    # below the height of the next taxel.
    depth = (squeeze / NORMAL_STIFFNESS + np.cumsum(level)) / num_taxels
    k = np.flatnonzero(depth > level)[-1]
    forces: np.ndarray = NORMAL_STIFFNESS * (depth[k] - height).clip(min=0)
    return forces


def gripper_mjcf(pad: TaxelLayout, item: LiftObject, gap: float) -> str:
    r"""Returns a MuJoCo model (MJCF) of the gripper around an object on a table.

    The gripper closes along the :math:`x` axis of the world; :math:`y` points sideways and
    :math:`z` upwards. Each taxel is a small sphere on three springs (joints :obj:`left_0_x`,
    :obj:`left_0_y`, :obj:`left_0_z`, ...), two along the axes of the taxel and one into the pad.

    Args:
        pad (TaxelLayout): The taxels of each pad.
        item (LiftObject): The object.
        gap (float): Distance between each pad and the object in metres.
    """
    position, half_width, half_height = pad_positions(pad), item.width / 2, OBJECT_HEIGHT / 2
    foot, foot_height = max(item.breadth, _FOOT_BREADTH), _FOOT_HEIGHT / 2
    fingers = "".join(_finger_mjcf(name, position, half_width + gap) for name in FINGERS)
    # Without noslip, an object at rest creeps. With a stiffer contact (solimp 0.99), slow slides
    # are jerky, and the object slips at 10 % more squeeze than friction requires.
    slide = f"{item.friction!r} {item.friction!r} 0.001 0.0001 0.0001"
    pairs = "".join(
        f'<pair geom1="{name}_{i}" geom2="object" condim="3" friction="{slide}" '
        f'solref="0.004 1" solimp="0.95 0.99 0.001"/>'
        for name in FINGERS
        for i in range(len(position))
    )
    table = f"{_TABLE_FRICTION} {_TABLE_FRICTION} 0.001 0.0001 0.0001"
    return f"""<mujoco model="gripper_lift">
<compiler angle="radian" autolimits="true"/>
<option timestep="{TIMESTEP}" integrator="implicitfast" solver="Newton" cone="elliptic"
 impratio="10" noslip_iterations="3"/>
<visual><headlight ambient="0.5 0.5 0.5"/><global offwidth="1280" offheight="960"/>
<map znear="0.001"/></visual>
<asset><texture type="skybox" builtin="flat" rgb1="1 1 1" rgb2="1 1 1" width="8"
 height="8"/></asset>
<worldbody>
<geom name="table" type="plane" size="0.3 0.3 0.1" contype="0" conaffinity="0"
 rgba="0.9 0.9 0.9 1"/>
<body name="object" pos="0 0 {half_height}"><freejoint name="object"/>
<inertial pos="{_join_numbers(0, item.offset, 0)}" mass="{item.mass!r}"
 diaginertia="{_box_inertia(item)}"/>
<geom name="object" type="box" pos="{_join_numbers(0, item.place, 0)}" contype="0" conaffinity="0"
 size="{_join_numbers(half_width, item.breadth / 2, half_height)}" rgba="0.8 0.5 0.2 1"/>
<geom name="foot" type="box" pos="{_join_numbers(0, item.place, foot_height - half_height)}"
 contype="0" conaffinity="0" size="{_join_numbers(half_width, foot / 2, foot_height)}"
 rgba="0.8 0.5 0.2 1"/></body>
<body name="gripper" pos="0 0 {half_height}" gravcomp="1">
<joint name="lift" type="slide" axis="0 0 1"/>
<inertial pos="0 0 0" mass="{_GRIPPER_MASS}" diaginertia="0.001 0.001 0.001"/>{fingers}</body>
</worldbody>
<equality><joint joint1="right" joint2="left" polycoef="0 1 0 0 0" solref="0.01 1"/></equality>
<contact>{pairs}
<pair geom1="table" geom2="foot" condim="3" friction="{table}"/></contact>
<actuator><motor name="squeeze" joint="left" gear="2"/>
<intvelocity name="lift" joint="lift" kp="{_LIFT_GAIN}" kv="{_LIFT_DAMPING}" actrange="-1 1"/>
</actuator>
</mujoco>"""


def _finger_mjcf(name: str, position: np.ndarray, distance: float) -> str:
    side = 1 if name == "left" else -1
    damping = _FINGER_DAMPING if name == "left" else 0.0  # one motor closes both fingers
    taxels = "".join(
        _taxel_mjcf(f"{name}_{i}", side, place, height)
        for i, (place, height) in enumerate(zip(position, _crown_height(position), strict=True))
    )
    return f"""<body name="{name}" pos="{_join_numbers(-side * distance, 0, 0)}" gravcomp="1">
<joint name="{name}" type="slide" axis="{side} 0 0" damping="{damping}"/>
<inertial pos="0 0 0" mass="{_FINGER_MASS}" diaginertia="1e-5 1e-5 1e-5"/>
<geom type="box" size="0.004 0.011 0.011" pos="{_join_numbers(-side * 0.0085, 0, 0)}"
 contype="0" conaffinity="0" mass="0" rgba="0.3 0.3 0.35 1"/>{taxels}</body>"""


def _taxel_mjcf(name: str, side: int, place: np.ndarray, height: float) -> str:
    # The x axis of a taxel points to the next column, so that z points out of both pads.
    pos = _join_numbers(-side * (TIP_RADIUS + height), side * place[0], place[1])
    joints = "".join(
        f'<joint name="{name}_{key}" type="slide" axis="{axis}" stiffness="{stiffness}" '
        f'damping="{damping}" armature="{_ARMATURE}"/>'
        for key, axis, stiffness, damping in (
            ("x", f"0 {side} 0", SHEAR_STIFFNESS, _SHEAR_DAMPING),
            ("y", "0 0 1", SHEAR_STIFFNESS, _SHEAR_DAMPING),
            ("z", f"{-side} 0 0", NORMAL_STIFFNESS, _NORMAL_DAMPING),
        )
    )
    return f"""<body name="{name}" pos="{pos}" gravcomp="1">{joints}
<inertial pos="0 0 0" mass="0.0001" diaginertia="1e-8 1e-8 1e-8"/>
<geom name="{name}" type="sphere" size="{TIP_RADIUS}" contype="0" conaffinity="0" mass="0"/>
<geom type="box" pos="{_join_numbers(-side * 0.0015, 0, 0)}" size="0.0015 0.002 0.002" contype="0"
 conaffinity="0" mass="0" rgba="0.1 0.45 0.75 1"/></body>"""


def _box_inertia(item: LiftObject) -> str:
    x, y, z = item.width**2, max(item.breadth, _FOOT_BREADTH) ** 2, OBJECT_HEIGHT**2
    return _join_numbers(*(item.mass / 12 * sum(pair) for pair in ((y, z), (x, z), (x, y))))


def _join_numbers(*numbers: float) -> str:
    return " ".join(repr(float(number)) for number in numbers)
