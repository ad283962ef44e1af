r"""Joints, and the files that list them."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree import ElementTree

import torch
from torch import Tensor

_MOVING = ("revolute", "continuous")


@dataclass(frozen=True)
class Joint:
    r"""A joint of a chain.

    Args:
        name (str): Its name.
        parent (str): The link that it is on.
        child (str): The link that it moves.
        xyz (tuple of float): Origin of the child in the parent's frame, in metres.
        rpy (tuple of float): Rotation of the child at angle zero, about the parent's fixed
            :math:`x`, then :math:`y`, then :math:`z` axis, in radians.
        axis (tuple of float, optional): Axis in the child's frame; :obj:`None` if fixed.
        lower (float): Lower limit in radians.
        upper (float): Upper limit in radians.
    """

    name: str
    parent: str
    child: str
    xyz: tuple[float, float, float] = (0.0, 0.0, 0.0)
    rpy: tuple[float, float, float] = (0.0, 0.0, 0.0)
    axis: tuple[float, float, float] | None = None
    lower: float = -math.inf
    upper: float = math.inf

    def __post_init__(self) -> None:
        for key in ("xyz", "rpy", "axis"):
            value = getattr(self, key)
            if value is None and key == "axis":
                continue
            value = tuple(float(number) for number in value)
            if len(value) != 3 or not all(map(math.isfinite, value)):
                raise ValueError(
                    f"'{key}' of joint '{self.name}' must be three finite numbers (got {value})"
                )
            object.__setattr__(self, key, value)
        if self.axis is not None:
            length = math.hypot(*self.axis)
            if length == 0:
                raise ValueError(
                    f"the axis of joint '{self.name}' must have a direction (got 0 0 0)"
                )
            if not math.isclose(length, 1.0, rel_tol=1e-15):  # or a copy would differ by rounding
                object.__setattr__(self, "axis", tuple(number / length for number in self.axis))
        if not float(self.lower) <= float(self.upper):
            raise ValueError(
                f"the limits of joint '{self.name}' must rise (got {self.lower} and {self.upper})"
            )

    def to_dict(self) -> dict[str, Any]:
        r"""Returns the arguments as JSON values, without limits that are infinite."""
        content: dict[str, Any] = {"name": self.name, "parent": self.parent, "child": self.child}
        content |= {"xyz": list(self.xyz), "rpy": list(self.rpy)}
        if self.axis is not None:
            content["axis"] = list(self.axis)
        for key in ("lower", "upper"):
            if math.isfinite(getattr(self, key)):
                content[key] = float(getattr(self, key))
        return content


class LinkTree(NamedTuple):
    r"""The links of a chain, the root first, and the joints level by level: those of a level hang
    on links of the level before.
    """

    names: tuple[str, ...]
    levels: list[list[Joint]]


def link_tree(joints: Sequence[Joint]) -> LinkTree:
    r"""Returns the links that joints make up.

    Args:
        joints (sequence of Joint): The joints.

    Raises:
        ValueError: If a link has two parents, or the links are not one tree.
    """
    by_child: dict[str, Joint] = {}
    for joint in joints:
        if joint.child in by_child:
            raise ValueError(
                f"a link must have one parent (got '{joint.child}' below "
                f"'{by_child[joint.child].parent}' and '{joint.parent}')"
            )
        by_child[joint.child] = joint
    roots = list(dict.fromkeys(j.parent for j in joints if j.parent not in by_child))
    if len(roots) != 1:
        raise ValueError(f"the links must be one tree, with one root (got roots {roots})")
    names, levels = [roots[0]], []
    level = names
    while level:
        children = [joint for joint in joints if joint.parent in level]
        level = [joint.child for joint in children]
        if children:
            levels.append(children)
            names = names + level
    if len(names) != len(joints) + 1:
        lost = sorted(set(by_child) - set(names))
        raise ValueError(f"the links must be one tree, with one root (got a ring of {lost})")
    return LinkTree(tuple(names), levels)


def read_urdf(path: Path, joint_names: Sequence[str] | None) -> tuple[list[Joint], str]:
    r"""Returns the joints of a URDF file and the name of its robot.

    Args:
        path (Path): The file.
        joint_names (sequence of str, optional): As of :meth:`HandKinematics.from_urdf`.

    Raises:
        ValueError: If the file is no URDF, a joint has another type, or a named joint is missing
            or named twice.
    """
    try:
        root = ElementTree.fromstring(path.read_bytes())  # bytes: the file declares its encoding
    except ElementTree.ParseError as error:
        raise ValueError(str(error)) from error
    if root.tag != "robot":
        raise ValueError(f"the root element must be 'robot' (got '{root.tag}')")
    joints = [_urdf_joint(element) for element in root.iter("joint") if element.get("type")]
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


def _cross_matrix(axis: Sequence[float]) -> Tensor:
    x, y, z = axis
    return torch.tensor([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]], dtype=torch.double)


def joint_turns(joint: Joint) -> Tensor:
    r"""Returns the terms :math:`1, \sin q, 1 - \cos q` of the rotation of a joint by :math:`q`.

    Args:
        joint (Joint): The joint.

    Shapes:
        - **output:** :math:`(3, 3, 3)`
    """
    # Rodrigues: R = R0 (1 + sin K + (1 - cos) K^2), as a table of its three terms.
    roll, pitch, yaw = joint.rpy
    still = torch.eye(3, dtype=torch.double)
    for angle, axis in ((roll, (1, 0, 0)), (pitch, (0, 1, 0)), (yaw, (0, 0, 1))):
        still = torch.linalg.matrix_exp(angle * _cross_matrix(axis)) @ still
    cross = _cross_matrix(joint.axis or (0.0, 0.0, 0.0))
    return torch.stack([still, still @ cross, still @ cross @ cross])


def _still(joint: Joint) -> Joint:
    return Joint(joint.name, joint.parent, joint.child, joint.xyz, joint.rpy)


def _urdf_joint(element: ElementTree.Element) -> Joint:
    name, kind = element.get("name", ""), element.get("type")
    if kind not in (*_MOVING, "fixed"):
        raise ValueError(f"joint '{name}' must be revolute, continuous or fixed (got '{kind}')")

    def numbers(tag: str, key: str, default: str) -> Any:
        found = element.find(tag)
        text = default if found is None else found.get(key, default)
        return tuple(float(number) for number in text.split())

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
        lower=float(limits.get("lower", -math.inf)),
        upper=float(limits.get("upper", math.inf)),
    )
