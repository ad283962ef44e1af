r"""Reading of joints from URDF files."""

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from torch_geometric_tactile._checks import need
from torch_geometric_tactile.sensors.joints import Joint

_MOVING = ("revolute", "continuous")
# The elements of a joint in URDF, with their attributes. Unknown elements are errors, since a
# misspelt element would otherwise be ignored. None allows all attributes of an unused element.
_JOINT_ELEMENTS = {
    "origin": ("xyz", "rpy"),
    "parent": ("link",),
    "child": ("link",),
    "axis": ("xyz",),
    "limit": ("lower", "upper", "effort", "velocity", "acceleration", "deceleration", "jerk"),
    "calibration": None,
    "dynamics": None,
    "mimic": None,
    "safety_controller": None,
}
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)


def read_urdf(path: Path, joint_names: Sequence[str] | None) -> tuple[list[Joint], str]:
    r"""Returns the joints in a URDF file and the name of its robot.

    The moving joints in :obj:`joint_names` come first, in that order. All other moving joints
    become fixed.
    """
    try:
        root = ElementTree.fromstring(path.read_bytes())  # bytes: the file declares its encoding
    except (ElementTree.ParseError, LookupError) as error:  # LookupError: an unknown encoding
        raise ValueError(str(error)) from error
    need(root.tag == "robot", f"the root element must be 'robot' (got '{root.tag}')")
    joints = [_urdf_joint(element) for element in root.findall("joint")]
    links = [element.get("name") for element in root.findall("link")]
    connected = {link for joint in joints for link in (joint.parent, joint.child)}
    if isolated := [name for name in links if name not in connected]:
        raise ValueError(
            f"each link must be connected by a joint (got '{isolated[0]}' without one)"
        )
    if joint_names is not None:
        moving = {joint.name: joint for joint in joints if joint.axis is not None}
        missing = [name for name in joint_names if name not in moving]
        if missing:
            raise ValueError(
                f"'joint_names' must be among its moving joints {list(moving)} (got '{missing[0]}')"
            )
        if len(set(joint_names)) < len(joint_names):
            raise ValueError("'joint_names' must name each joint once (got one twice)")
        named_joints = [moving[name] for name in joint_names]
        other_joints = [joint for joint in joints if joint not in named_joints]
        joints = named_joints + [_fixed(joint) if joint.axis else joint for joint in other_joints]
    return joints, root.get("name", path.stem)


def _fixed(joint: Joint) -> Joint:
    # The joint at angle zero.
    return Joint(joint.name, joint.parent, joint.child, joint.xyz, joint.rpy)


def _urdf_joint(element: ElementTree.Element) -> Joint:
    name, kind = element.get("name", ""), element.get("type")
    need(name, "each joint must have a name (got none)")
    _check_elements(element, name)
    if kind not in (*_MOVING, "fixed"):
        raise ValueError(f"joint '{name}' must be revolute, continuous or fixed (got '{kind}')")

    def numbers(tag: str, key: str, default: str) -> Any:
        child = element.find(tag)
        text = default if child is None else child.get(key, default)
        return tuple(_number(number, name) for number in text.split())

    def link(tag: str) -> str:
        child = element.find(tag)
        if child is None or not child.get("link"):
            raise ValueError(f"joint '{name}' must have a {tag} link (got none)")
        return str(child.get("link"))

    limits: Mapping[str, str] = {}
    if kind == "revolute" and (limit := element.find("limit")) is not None:
        limits = limit.attrib
    return Joint(
        name=name,
        parent=link("parent"),
        child=link("child"),
        xyz=numbers("origin", "xyz", "0 0 0"),
        rpy=numbers("origin", "rpy", "0 0 0"),
        axis=numbers("axis", "xyz", "1 0 0") if kind in _MOVING else None,
        lower=_number(limits.get("lower", "-inf"), name),
        upper=_number(limits.get("upper", "inf"), name),
    )


def _check_elements(element: ElementTree.Element, name: str) -> None:
    if unknown := set(element.keys()) - {"name", "type"}:
        raise ValueError(f"joint '{name}' must have only a name and a type (got {min(unknown)!r})")
    tags = set()
    for child in element:
        if child.tag not in _JOINT_ELEMENTS or child.tag in tags:
            raise ValueError(
                f"joint '{name}' must have each of {', '.join(_JOINT_ELEMENTS)} at most once "
                f"(got {child.tag!r})"
            )
        tags.add(child.tag)
        attributes = _JOINT_ELEMENTS[child.tag]
        if attributes is not None and (unknown := set(child.keys()) - set(attributes)):
            raise ValueError(
                f"'{child.tag}' of joint '{name}' must have only the attributes "
                f"{', '.join(attributes)} (got {min(unknown)!r})"
            )


def _number(text: str, name: str) -> float:
    if text in ("inf", "-inf") or _NUMBER.fullmatch(text):
        return float(text)
    raise ValueError(f"joint '{name}' must have numbers (got {text!r})")
