r"""A three-fingered hand around an object on a table, for MuJoCo."""

import math

import numpy as np

from torch_geometric_tactile.sim._bigs_times import CONTROL_RATE
from torch_geometric_tactile.sim.bigs_plan import BigsGrasp

#: The fingers. The middle one opposes the other two, as on a Barrett hand.
FINGERS = ("left", "middle", "right")
HAND_MASS = 1000.0  # kg: the hand moves as it is told, whatever the object does
FINGER_LENGTH = 0.090  # m, from the knuckle to the middle of the pad
PAD_CENTRE = -0.006  # m, of the ellipsoid of the skin on the axis of the tip
PAD = (0.016, 0.0075, 0.007)  # m, its half axes: the skin lies 1 to 3 mm above the electrodes
OPEN = -0.35  # rad
CLOSED = 1.1  # rad
_AT_CONTACT = 0.08  # rad, about
_BOX_FINGERS = 0.020  # m, of left and right finger beside the middle of a box
_TORSION = 0.003  # m, friction against turning on a soft fingertip
_SKIN_TIME = 0.02  # s
_GAIN, _DAMPING, _TORQUE = 40.0, 0.8, 2.5  # of a finger joint: Nm/rad, Nms/rad, Nm
_ARMATURE = 0.002  # kg m^2


def bigs_mjcf(grasp: BigsGrasp) -> str:
    r"""Returns a MuJoCo model (MJCF): three fingers that hang from a hand, which moves freely, and
    the object on a table.

    A finger has one hinge at the knuckle and ends in an ellipsoid of skin. The frame of a fingertip
    (site :obj:`tip_left` and so on) is that of the layout :obj:`biotac`: x along the finger to its
    end, and -z out of the pad.
    """
    joints = "".join(
        f'<joint name="hand_{name}" type="{kind}" axis="{axis}"/>'
        for name, kind, axis in (
            ("x", "slide", "1 0 0"),
            ("y", "slide", "0 1 0"),
            ("z", "slide", "0 0 1"),
            ("yaw", "hinge", "0 0 1"),
            ("pitch", "hinge", "0 1 0"),
            ("roll", "hinge", "1 0 0"),
        )
    )
    inertia = f"{HAND_MASS} {HAND_MASS} {HAND_MASS}"
    fingers = "".join(_finger(grasp, number) for number in range(3))
    actuators = "".join(
        f'<position joint="{name}" kp="{_GAIN}" kv="{_DAMPING}" forcerange="-{_TORQUE} {_TORQUE}"/>'
        for name in FINGERS
    )
    weight = FINGER_LENGTH**2 / (_ARMATURE + 0.0004)  # inverse mass in 1/kg of a tip
    # How stiff a contact of MuJoCo is depends on the masses that meet in it.
    skin = _SKIN_TIME * math.sqrt(6.0 / (1.0 / grasp.mass + weight))
    pairs = "".join(
        f'<pair geom1="skin_{name}" geom2="object" condim="4" solref="{skin!r} 1" '
        f'solimp="0.7 0.95 0.003" friction="{grasp.friction!r} {grasp.friction!r} {_TORSION} '
        f'0.0001 0.0001"/>'
        for name in FINGERS
    )
    size = {
        "cylinder": _text(grasp.half_width, grasp.half_height),
        "box": _text(grasp.half_width, grasp.half_width, grasp.half_height),
        "ball": _text(grasp.half_width),
    }[grasp.shape]
    kind = "sphere" if grasp.shape == "ball" else grasp.shape
    return f"""<mujoco model="bigs">
<compiler angle="radian" autolimits="true"/>
<option timestep="{1 / CONTROL_RATE!r}" integrator="implicitfast" solver="Newton" cone="elliptic"
 impratio="20"/>
<worldbody>
<geom name="table" type="plane" size="1 1 0.1" contype="1" conaffinity="1" condim="6"
 friction="0.5 0.01 0.003"/>
<body name="object" pos="{_text(0, 0, grasp.half_height)}"><freejoint name="object"/>
<geom name="object" type="{kind}" size="{size}" mass="{grasp.mass!r}" contype="1" conaffinity="1"
 condim="6" friction="0.5 0.01 0.003"/></body>
<body name="hand" gravcomp="1">{joints}
<inertial pos="0 0 0" mass="{HAND_MASS}" diaginertia="{inertia}"/>{fingers}</body>
</worldbody>
<contact>{pairs}</contact>
<actuator>{actuators}</actuator>
</mujoco>"""


def _finger(grasp: BigsGrasp, number: int) -> str:
    # The frame of a finger: x down along it, -z where it closes to, y its hinge.
    toward, contact = _closing(grasp, number)
    base = contact - toward * (PAD[2] + FINGER_LENGTH * math.sin(_AT_CONTACT))
    lateral = np.cross([-toward[0], -toward[1], 0.0], [0.0, 0.0, -1.0])
    bend = grasp.bend[number] - _AT_CONTACT
    name = FINGERS[number]
    half = grasp.twist[number] / 2
    pad = _text(
        math.cos(bend / 2) * math.cos(half),
        math.cos(bend / 2) * math.sin(half),
        math.sin(bend / 2) * math.cos(half),
        -math.sin(bend / 2) * math.sin(half),
    )
    return f"""<body name="{name}" pos="{_text(*base[:2], FINGER_LENGTH)}"
 xyaxes="{_text(0, 0, -1, *lateral)}" gravcomp="1">
<joint name="{name}" axis="0 1 0" range="{OPEN - 0.1} {CLOSED}" damping="0.05"
 armature="{_ARMATURE}"/>
<inertial pos="{_text(FINGER_LENGTH / 2, 0, 0)}" mass="0.1" diaginertia="1e-5 7e-5 7e-5"/>
<body name="tip_{name}" pos="{_text(FINGER_LENGTH, 0, 0)}" quat="{pad}" gravcomp="1">
<geom name="skin_{name}" type="ellipsoid" size="{_text(*PAD)}" mass="0.01" contype="0"
 conaffinity="0"/>
<site name="tip_{name}" pos="{_text(-PAD_CENTRE, 0, 0)}"/></body></body>"""


def _closing(grasp: BigsGrasp, number: int) -> tuple[np.ndarray, np.ndarray]:
    # Where a finger closes to, and where it would touch an object below the middle of the hand.
    if number == 1:
        return np.array([-1.0, 0.0, 0.0]), np.array([grasp.half_width, 0.0, 0.0])
    side = 1.0 if number == 0 else -1.0
    angle = -side * grasp.spread
    toward = np.array([math.cos(angle), math.sin(angle), 0.0])
    if grasp.shape == "box":
        return toward, np.array([-grasp.half_width, side * _BOX_FINGERS, 0.0])
    return toward, -grasp.half_width * toward


def _text(*numbers: float) -> str:
    return " ".join(repr(float(number)) for number in numbers)
