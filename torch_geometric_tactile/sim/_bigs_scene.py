r"""A MuJoCo scene: a three-fingered hand around an object on a table."""

import math

import numpy as np

from torch_geometric_tactile.sim._bigs_plan import BigsGrasp
from torch_geometric_tactile.sim._bigs_times import CONTROL_RATE

#: The fingers. The middle finger opposes left and right, as on a Barrett hand.
FINGERS = ("left", "middle", "right")
HAND_MASS = 1000.0  # kg, so large that contact forces do not disturb the planned motion
FINGER_LENGTH = 0.090  # m, from the knuckle to the middle of the pad
PAD_CENTRE = -0.006  # m, position of the skin's ellipsoid along the finger
PAD = (0.016, 0.0075, 0.007)  # m, half axes of the skin, 1 to 3 mm above the electrodes
OPEN = -0.35  # rad, knuckle of an open finger
CLOSED = 1.1  # rad, largest angle of a knuckle
_CONTACT_ANGLE = 0.08  # rad, approximate angle of a knuckle at contact
_BOX_FINGER_OFFSET = 0.020  # m, offset of the left and right fingers from the middle of a box
_TORSION = 0.003  # m, friction against turning on a soft fingertip
_SKIN_TIME = 0.02  # s, time constant of the skin
_GAIN, _DAMPING, _TORQUE = 40.0, 0.8, 2.5  # of a finger joint: Nm/rad, Nms/rad, Nm
_ARMATURE = 0.002  # kg m^2, rotor inertia of a finger joint


def bigs_mjcf(grasp: BigsGrasp) -> str:
    r"""Returns a MuJoCo model (MJCF) with three fingers on a freely moving hand, and the object on
    a table.

    A finger has one hinge at the knuckle and ends in an ellipsoid of skin. The frame of a fingertip
    (sites :obj:`tip_left`, :obj:`tip_middle` and :obj:`tip_right`) is the frame of the layout
    :obj:`biotac`: x points along the finger to its end, and -z points out of the pad.
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
    fingers = "".join(_finger_mjcf(grasp, number) for number in range(3))
    actuators = "".join(
        f'<position joint="{name}" kp="{_GAIN}" kv="{_DAMPING}" forcerange="-{_TORQUE} {_TORQUE}"/>'
        for name in FINGERS
    )
    inverse_tip_mass = FINGER_LENGTH**2 / (_ARMATURE + 0.0004)  # 1/kg
    # The stiffness of a contact in MuJoCo depends on the masses in contact; the time constant
    # compensates for it.
    skin = _SKIN_TIME * math.sqrt(6.0 / (1.0 / grasp.mass + inverse_tip_mass))
    pairs = "".join(
        f'<pair geom1="skin_{name}" geom2="object" condim="4" solref="{skin!r} 1" '
        f'solimp="0.7 0.95 0.003" friction="{grasp.friction!r} {grasp.friction!r} {_TORSION} '
        f'0.0001 0.0001"/>'
        for name in FINGERS
    )
    size = {
        "cylinder": _join_numbers(grasp.half_width, grasp.half_height),
        "box": _join_numbers(grasp.half_width, grasp.half_width, grasp.half_height),
        "ball": _join_numbers(grasp.half_width),
    }[grasp.shape]
    kind = "sphere" if grasp.shape == "ball" else grasp.shape
    return f"""<mujoco model="bigs">
<compiler angle="radian" autolimits="true"/>
<option timestep="{1 / CONTROL_RATE!r}" integrator="implicitfast" solver="Newton" cone="elliptic"
 impratio="20"/>
<worldbody>
<geom name="table" type="plane" size="1 1 0.1" contype="1" conaffinity="1" condim="6"
 friction="0.5 0.01 0.003"/>
<body name="object" pos="{_join_numbers(0, 0, grasp.half_height)}"><freejoint name="object"/>
<geom name="object" type="{kind}" size="{size}" mass="{grasp.mass!r}" contype="1" conaffinity="1"
 condim="6" friction="0.5 0.01 0.003"/></body>
<body name="hand" gravcomp="1">{joints}
<inertial pos="0 0 0" mass="{HAND_MASS}" diaginertia="{inertia}"/>{fingers}</body>
</worldbody>
<contact>{pairs}</contact>
<actuator>{actuators}</actuator>
</mujoco>"""


def _finger_mjcf(grasp: BigsGrasp, number: int) -> str:
    # The frame of a finger has x down along the finger, -z in the closing direction, and y along
    # the hinge.
    direction, contact = _closing_direction(grasp, number)
    base = contact - direction * (PAD[2] + FINGER_LENGTH * math.sin(_CONTACT_ANGLE))
    lateral = np.cross([-direction[0], -direction[1], 0.0], [0.0, 0.0, -1.0])
    bend = grasp.bend[number] - _CONTACT_ANGLE
    name = FINGERS[number]
    half_twist = grasp.twist[number] / 2
    pad = _join_numbers(
        math.cos(bend / 2) * math.cos(half_twist),
        math.cos(bend / 2) * math.sin(half_twist),
        math.sin(bend / 2) * math.cos(half_twist),
        -math.sin(bend / 2) * math.sin(half_twist),
    )
    return f"""<body name="{name}" pos="{_join_numbers(*base[:2], FINGER_LENGTH)}"
 xyaxes="{_join_numbers(0, 0, -1, *lateral)}" gravcomp="1">
<joint name="{name}" axis="0 1 0" range="{OPEN - 0.1} {CLOSED}" damping="0.05"
 armature="{_ARMATURE}"/>
<inertial pos="{_join_numbers(FINGER_LENGTH / 2, 0, 0)}" mass="0.1" diaginertia="1e-5 7e-5 7e-5"/>
<body name="tip_{name}" pos="{_join_numbers(FINGER_LENGTH, 0, 0)}" quat="{pad}" gravcomp="1">
<geom name="skin_{name}" type="ellipsoid" size="{_join_numbers(*PAD)}" mass="0.01" contype="0"
 conaffinity="0"/>
<site name="tip_{name}" pos="{_join_numbers(-PAD_CENTRE, 0, 0)}"/></body></body>"""


def _closing_direction(grasp: BigsGrasp, number: int) -> tuple[np.ndarray, np.ndarray]:
    # The closing direction of a finger, and its point of contact with an object below the middle
    # of the hand.
    if number == 1:
        return np.array([-1.0, 0.0, 0.0]), np.array([grasp.half_width, 0.0, 0.0])
    side = 1.0 if number == 0 else -1.0
    angle = -side * grasp.spread
    direction = np.array([math.cos(angle), math.sin(angle), 0.0])
    if grasp.shape == "box":
        return direction, np.array([-grasp.half_width, side * _BOX_FINGER_OFFSET, 0.0])
    return direction, -grasp.half_width * direction


def _join_numbers(*numbers: float) -> str:
    return " ".join(repr(float(number)) for number in numbers)
