r"""A MuJoCo model of the Allegro hand, generated from the layout and the kinematics."""

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

import numpy as np

from torch_geometric_tactile.sensors import HandKinematics, Joint, TaxelLayout, stock_path
from torch_geometric_tactile.sim.objects import GraspObject

STAND = (0.02, 0.05, 0.07)  # m: half width, half length and height of the stand below the object
_TIP_RADIUS = 0.0090  # m, of the bone in a fingertip, behind the skin
_BONE_REDUCTION = np.array([0.002, 0.006, 0.0])  # m, of bones relative to the boxes of the links
_SOLIMP = "0.5 0.93 0.004"
_GANTRY_MASS = 0.5  # kg
_FINGER_INVERSE_MASS = 5.0  # 1/kg, effective at a contact on a finger


@dataclass(frozen=True)
class ContactParameters:
    r"""The parameters of contacts and joints of the simulated hand: time constants, friction and
    joint stiffness. The values are plausible, not measured.

    Args:
        timestep (float): Step of the simulation in seconds.
        taxel_radius (float): Radius of the collision sphere of a taxel in metres.
        skin_time (float): Time constant of the skin in seconds.
        hard_time (float): Time constant of a hard object in seconds.
        soft_time (float): Time constant of a soft object in seconds.
        hand_friction (float): Friction coefficient of the hand. It is below the coefficients of the
            objects, because MuJoCo uses the larger coefficient.
        joint_gain (float): Stiffness of a finger joint in newton metres per radian.
        joint_torque (float): Largest torque of a finger joint in newton metres.
        joint_damping (float): Damping of a finger joint in newton metre seconds per radian.
        armature (float): Rotor inertia of a finger joint in kilogram square metres.

    Examples:
        >>> ContactParameters(taxel_radius=0.003).taxel_radius
        0.003
    """

    timestep: float = 0.002
    taxel_radius: float = 0.0035
    skin_time: float = 0.025
    hard_time: float = 0.005
    soft_time: float = 0.08
    hand_friction: float = 0.05
    joint_gain: float = 0.85
    joint_torque: float = 0.7
    joint_damping: float = 0.06
    armature: float = 0.001


def stock_bodies() -> list[dict[str, Any]]:
    r"""Returns the collision boxes and fingertip spheres of the Allegro hand's links, in metres and
    kilograms.

    Examples:
        >>> stock_bodies()[0]["link"], stock_bodies()[0]["mass"]
        ('palm_link', 0.4154)
    """
    content = json.loads(stock_path("chains", "allegro_right").read_text(encoding="utf-8"))
    bodies: list[dict[str, Any]] = content["bodies"]
    return bodies


def grasp_mjcf(
    layout: TaxelLayout,
    kinematics: HandKinematics,
    item: GraspObject,
    parameters: ContactParameters | None = None,
    bodies: Sequence[Mapping[str, Any]] | None = None,
) -> str:
    r"""Returns a MuJoCo model (MJCF) that needs no other files: the hand on a gantry, palm down,
    above an object on a stand.

    Each taxel is a small collision sphere below the surface of the skin, named
    :obj:`taxel_0`, :obj:`taxel_1`, ..., with a site of the same name at the taxel. The bones are
    the collision boxes of the links, a few millimetres behind the skin. They limit the compression
    of the skin.

    The stiffness of a contact in MuJoCo depends on the masses in contact. Time constants are
    therefore scaled with the mass of the object and the effective mass of a finger or the palm, so
    that the softness of skin and object does not depend on these masses.

    Args:
        layout (TaxelLayout): The layout; its links are links of :obj:`kinematics`.
        kinematics (HandKinematics): The hand.
        item (GraspObject): The object.
        parameters (ContactParameters, optional): Parameters of contacts and joints.
        bodies (sequence of dict, optional): Boxes and spheres of the links (default: the bodies of
            the Allegro hand).

    Raises:
        ValueError: If the layout has no normals, or if it has a link that the hand does not have.

    Examples:
        >>> from torch_geometric_tactile.sensors import HandKinematics, allegro_uskin
        >>> from torch_geometric_tactile.sim import paper8
        >>> mjcf = grasp_mjcf(allegro_uskin(), HandKinematics.allegro(), paper8()[1])
        >>> '"taxel_383"' in mjcf
        True
    """
    if layout.normal is None:
        raise ValueError(f"layout '{layout.name}' must have normals (got none)")
    parameters = parameters or ContactParameters()
    kinematics.require_links(layout)
    bodies = stock_bodies() if bodies is None else bodies
    palm_inverse_mass = 1.0 / (_GANTRY_MASS + sum(body["mass"] for body in bodies))

    def solref(time_constant: float, inverse_mass: float = _FINGER_INVERSE_MASS) -> str:
        return f"{time_constant * math.sqrt(15.0 / (1.0 / item.mass + inverse_mass))!r} 1"

    root = Element("mujoco", model="grasp")
    SubElement(root, "compiler", angle="radian", autolimits="true")
    option = SubElement(root, "option", timestep=repr(parameters.timestep))
    option.attrib |= {"integrator": "implicitfast", "solver": "Newton"}
    option.attrib |= {"cone": "elliptic", "impratio": "5"}
    world = SubElement(root, "worldbody")
    SubElement(world, "light", pos="0 -0.5 1.5", dir="0 0.3 -1")
    _add_ground(world, item)
    object_time = parameters.soft_time if item.soft else parameters.hard_time
    _add_object(world, item, solref(object_time))
    links = _add_links(world, kinematics, parameters)
    for shape in bodies:
        _add_bone(links[shape["link"]], shape, solref(parameters.hard_time), parameters)
    skin = _hand_geom(parameters, solref(parameters.skin_time))
    # MuJoCo averages the parameters of both geometries, unless one has priority. The effective mass
    # of the palm differs from the effective mass of the fingers, so the palm gets the average.
    mean_time = (parameters.skin_time + object_time) / 2
    palm_solref = solref(mean_time, palm_inverse_mass)
    palm = {"priority": "1", "solref": palm_solref, "friction": _friction_attribute(item)}
    _add_skin(links, layout, {kinematics.link_names[0]: skin | palm}, skin, parameters)
    _add_actuators(root, kinematics, parameters)
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode")


def _join_numbers(numbers: Iterable[float]) -> str:
    return " ".join(repr(float(number)) for number in numbers)


def _rpy_to_quaternion(rpy: tuple[float, float, float]) -> np.ndarray:
    quaternion = np.array([1.0, 0.0, 0.0, 0.0])
    for angle, axis in zip(rpy, (1, 2, 3), strict=True):
        rotation = np.zeros(4)
        rotation[0], rotation[axis] = math.cos(angle / 2), math.sin(angle / 2)
        quaternion = _multiply_quaternions(rotation, quaternion)
    return quaternion


def _multiply_quaternions(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    scalar = a[0] * b[0] - a[1:] @ b[1:]
    return np.array([scalar, *(a[0] * b[1:] + b[0] * a[1:] + np.cross(a[1:], b[1:]))])


def _add_ground(world: Element, item: GraspObject) -> None:
    object_contacts_only = {"contype": "0", "conaffinity": "1"}
    table = {"name": "table", "type": "plane", "size": "1 1 0.1", "friction": "0.6"}
    SubElement(world, "geom", table | object_contacts_only)
    half_x, half_y, height = STAND
    stand = {
        "name": "stand",
        "type": "box",
        "size": _join_numbers((half_x, min(half_y, 0.4 * item.size[1]), height / 2)),
        "pos": _join_numbers((0, 0, height / 2)),
        "friction": "0.6 0.01 0.002",
        "condim": "6",  # rolling friction keeps a cylinder on the stand before the hand touches it
    }
    SubElement(world, "geom", stand | object_contacts_only)


def _add_object(world: Element, item: GraspObject, solref: str) -> None:
    x, y, z = (length / 2 for length in item.size)
    body = SubElement(world, "body", name="object", pos=_join_numbers((0, 0, STAND[2] + z)))
    SubElement(body, "freejoint", name="object")
    is_lying = item.shape == "cylinder"  # cylinders in MuJoCo point along z, here along y
    SubElement(
        body,
        "geom",
        name="object",
        type=item.shape,
        size=_join_numbers({"cylinder": (x, y), "sphere": (x,)}.get(item.shape, (x, y, z))),
        quat=_join_numbers((0.5**0.5, 0.5**0.5, 0, 0) if is_lying else (1, 0, 0, 0)),
        mass=repr(item.mass),
        friction=_friction_attribute(item),
        condim="4",
        contype="1",
        conaffinity="2",
        solref=solref,
        solimp=_SOLIMP,
        rgba="0.9 0.6 0.2 1",
    )


def _friction_attribute(item: GraspObject) -> str:
    return f"{item.friction!r} 0.005 0.0005"


def _add_links(
    world: Element, kinematics: HandKinematics, parameters: ContactParameters
) -> dict[str, Element]:
    gantry = SubElement(world, "body", name="gantry", gravcomp="1")
    for name, kind, axis, damping in (
        ("x", "slide", "1 0 0", "20"),
        ("y", "slide", "0 1 0", "20"),
        ("z", "slide", "0 0 1", "20"),
        ("yaw", "hinge", "0 0 1", "0.5"),
    ):
        SubElement(gantry, "joint", name=f"gantry_{name}", type=kind, axis=axis, damping=damping)
    SubElement(
        gantry, "inertial", pos="0 0 0", mass=repr(_GANTRY_MASS), diaginertia="0.002 0.002 0.002"
    )
    # Palm down: x of the hand points to the table, and z (along the fingers) along x of the world.
    root = kinematics.link_names[0]
    quat = _join_numbers((0.5**0.5, 0, 0.5**0.5, 0))
    links = {root: SubElement(gantry, "body", name=root, quat=quat, gravcomp="1")}
    for joint in _joints_from_root(kinematics):
        body = SubElement(
            links[joint.parent],
            "body",
            name=joint.child,
            pos=_join_numbers(joint.xyz),
            quat=_join_numbers(_rpy_to_quaternion(joint.rpy)),
            gravcomp="1",
        )
        links[joint.child] = body
        if joint.axis is not None:
            SubElement(
                body,
                "joint",
                name=joint.name,
                type="hinge",
                axis=_join_numbers(joint.axis),
                range=_join_numbers((joint.lower, joint.upper)),
                damping=repr(parameters.joint_damping),
                armature=repr(parameters.armature),
            )
    return links


def _joints_from_root(kinematics: HandKinematics) -> list[Joint]:
    link_index = {name: i for i, name in enumerate(kinematics.link_names)}
    return sorted(kinematics.joints, key=lambda joint: link_index[joint.child])


def _hand_geom(parameters: ContactParameters, solref: str) -> dict[str, str]:
    # The hand can touch only the object, not itself or the table.
    return {
        "contype": "2",
        "conaffinity": "0",
        "friction": f"{parameters.hand_friction!r} 0.005 0.0001",
        "solref": solref,
    }


def _add_bone(
    body: Element, shape: Mapping[str, Any], solref: str, parameters: ContactParameters
) -> None:
    if "box" in shape:
        size = {
            "type": "box",
            "size": _join_numbers((np.array(shape["box"]) - _BONE_REDUCTION) / 2),
        }
    else:
        size = {"type": "sphere", "size": repr(_TIP_RADIUS)}
    attributes = {
        "name": f"bone_{shape['link']}",
        "mass": repr(float(shape["mass"])),
        "pos": _join_numbers(shape["center"]),
        "rgba": "0.35 0.35 0.4 1",
    }
    SubElement(body, "geom", attributes | size | _hand_geom(parameters, solref))


def _add_skin(
    links: Mapping[str, Element],
    layout: TaxelLayout,
    link_attributes: Mapping[str, dict[str, str]],
    default_attributes: dict[str, str],
    parameters: ContactParameters,
) -> None:
    assert layout.link is not None
    assert layout.normal is not None
    radius = parameters.taxel_radius
    normal = layout.normal.double().numpy()
    pos = layout.pos.double().numpy()
    for i in range(layout.num_taxels):
        link = layout.link_names[int(layout.link[i])]
        body = links[link]
        attributes = {
            "name": f"taxel_{i}",
            "type": "sphere",
            "size": repr(radius),
            "pos": _join_numbers(pos[i] - radius * normal[i]),
            "mass": "0",
            "solimp": _SOLIMP,
            "rgba": "0.2 0.2 0.2 1",
        }
        contact_attributes = link_attributes.get(link, default_attributes)
        SubElement(body, "geom", attributes | contact_attributes)
        SubElement(body, "site", name=f"taxel_{i}", pos=_join_numbers(pos[i]), size="0.0005")


def _add_actuators(
    root: Element, kinematics: HandKinematics, parameters: ContactParameters
) -> None:
    actuator = SubElement(root, "actuator")
    for name, gain, damping in (
        ("x", "4000", "200"),
        ("y", "4000", "200"),
        ("z", "6000", "250"),
        ("yaw", "60", "3"),
    ):
        SubElement(actuator, "position", joint=f"gantry_{name}", kp=gain, kv=damping)
    for name in kinematics.joint_names:
        SubElement(
            actuator,
            "position",
            joint=name,
            kp=repr(parameters.joint_gain),
            forcerange=_join_numbers((-parameters.joint_torque, parameters.joint_torque)),
        )
