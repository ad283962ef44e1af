r"""URDF files: the joints of a hand as XML."""

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from torch_geometric_tactile._checks import need
from torch_geometric_tactile.sensors.joints import Joint

_MOVING = ("revolute", "continuous")
# What URDF knows in a joint, and the attributes that are read. A misspelt one would be left out.
_URDF_PARTS = {
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
    r"""Returns the joints of a URDF file and the name of its robot."""
    try:
        root = ElementTree.fromstring(path.read_bytes())  # bytes: the file declares its encoding
    except (ElementTree.ParseError, LookupError) as error:  # another encoding is a LookupError
        raise ValueError(str(error)) from error
    need(root.tag == "robot", f"the root element must be 'robot' (got '{root.tag}')")
    joints = [_urdf_joint(element) for element in root.findall("joint")]
    links = [element.get("name") for element in root.findall("link")]
    held = {link for joint in joints for link in (joint.parent, joint.child)}
    if loose := [name for name in links if name not in held]:
        raise ValueError(f"each link must be that of a joint (got '{loose[0]}' alone)")
    if joint_names is not None:
        moving = {joint.name: joint for joint in joints if joint.axis is not None}
        missing = [name for name in joint_names if name not in moving]
        if missing:
            raise ValueError(
                f"'joint_names' must name its moving joints, {list(moving)} (got '{missing[0]}')"
            )
        if len(set(joint_names)) < len(joint_names):
            raise ValueError("'joint_names' must name each joint once (got one twice)")
        named = [moving[name] for name in joint_names]
        rest = [joint for joint in joints if joint not in named]
        joints = named + [_still(joint) if joint.axis else joint for joint in rest]
    return joints, root.get("name", path.stem)


def _still(joint: Joint) -> Joint:
    return Joint(joint.name, joint.parent, joint.child, joint.xyz, joint.rpy)


def _urdf_joint(element: ElementTree.Element) -> Joint:
    name, kind = element.get("name", ""), element.get("type")
    need(name, "each joint must have a name (got none)")
    _check_parts(element, name)
    if kind not in (*_MOVING, "fixed"):
        raise ValueError(f"joint '{name}' must be revolute, continuous or fixed (got '{kind}')")

    def numbers(tag: str, key: str, default: str) -> Any:
        found = element.find(tag)
        text = default if found is None else found.get(key, default)
        return tuple(_number(number, name) for number in text.split())

    def link(tag: str) -> str:
        found = element.find(tag)
        if found is None or not found.get("link"):
            raise ValueError(f"joint '{name}' must have a {tag} link (got none)")
        return str(found.get("link"))

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


def _check_parts(element: ElementTree.Element, name: str) -> None:
    if unknown := set(element.keys()) - {"name", "type"}:
        raise ValueError(f"joint '{name}' must have a name and a type only (got {min(unknown)!r})")
    seen = set()
    for part in element:
        if part.tag not in _URDF_PARTS or part.tag in seen:
            raise ValueError(
                f"joint '{name}' must have each of {', '.join(_URDF_PARTS)} once at most "
                f"(got {part.tag!r})"
            )
        seen.add(part.tag)
        known = _URDF_PARTS[part.tag]
        if known is not None and (unknown := set(part.keys()) - set(known)):
            raise ValueError(
                f"'{part.tag}' of joint '{name}' must have no other attributes than "
                f"{', '.join(known)} (got {min(unknown)!r})"
            )


def _number(text: str, name: str) -> float:
    if text in ("inf", "-inf") or _NUMBER.fullmatch(text):
        return float(text)
    raise ValueError(f"joint '{name}' must have numbers (got {text!r})")
