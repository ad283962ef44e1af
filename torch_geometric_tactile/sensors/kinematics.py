r"""From joint angles to the places of links and taxels."""

import dataclasses
import json
import math
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple, Self
from xml.etree import ElementTree

import torch
from torch import Tensor

from torch_geometric_tactile.sensors.layout import TaxelLayout
from torch_geometric_tactile.sensors.stock import stock_path
from torch_geometric_tactile.typing import PathLike

_FEW = 4  # frames up to which the number of operations costs more than the work in them
_CHUNK = 4096  # frames worked on at a time: the intermediate results then fit into the cache
_MOVING = ("revolute", "continuous")

_Table = tuple[int, Tensor, Tensor | None]  # a link, and what its pose is multiplied with
_Kept = tuple[TaxelLayout, tuple[torch.dtype, torch.device], tuple[list[_Table], Tensor | None]]


class _FewTables(NamedTuple):
    parents: list[Tensor]  # of the links of each level, where they are in the level before
    column: Tensor  # of each link's joint in the joint vector
    turns: Tensor  # (L - 1, 3, 16), the three terms of each link's matrix below its parent
    link: Tensor  # (N,), of each taxel
    pos: Tensor  # (N, 1, 4)
    normal: Tensor  # (N, 1, 4)


_KeptFew = tuple[TaxelLayout, tuple[torch.dtype, torch.device], _FewTables]


class LinkPose(NamedTuple):
    r"""Where the links are, in the frame of the root link.

    :obj:`rotation` :math:`(..., L, 3, 3)` turns vectors of a link's frame into the root's, and
    :obj:`translation` :math:`(..., L, 3)` is the link's origin in metres.
    """

    rotation: Tensor
    translation: Tensor


class PosedTaxels(NamedTuple):
    r"""Where the taxels are, in the frame of the root link: :obj:`pos` in metres and unit
    :obj:`normal`, both :math:`(..., N, 3)`. Without normals in the layout :obj:`normal` is
    :obj:`None`.
    """

    pos: Tensor
    normal: Tensor | None


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
            object.__setattr__(self, "axis", tuple(number / length for number in self.axis))
        if not float(self.lower) <= float(self.upper):
            raise ValueError(
                f"the limits of joint '{self.name}' must rise (got {self.lower} and {self.upper})"
            )


class HandKinematics:
    r"""The forward kinematics of a hand: joint angles to link poses to taxel positions and normals,
    batched and differentiable.

    Angles are never clipped; :meth:`outside_limits` tells which are beyond a limit.

    Args:
        joints (sequence of Joint): The joints. The moving ones, in this order, are the joint vector
            :math:`(J,)`.
        name (str): Name of the hand.

    Raises:
        ValueError: If no joint moves, a link has two parents, or the links are not one tree.

    Examples:
        >>> hand = HandKinematics.allegro()
        >>> hand
        HandKinematics('allegro_right', num_joints=16, num_links=21)
        >>> pose = hand.link_pose(torch.zeros(16))
        >>> pose.translation[hand.link_names.index("link_7_tip")]
        tensor([0.0000, 0.0000, 0.1362])
    """

    def __init__(self, joints: Sequence[Joint], name: str = "hand") -> None:
        self.name = name
        self.joints = tuple(joints)
        moving = [joint for joint in self.joints if joint.axis is not None]
        if not moving:
            raise ValueError("'joints' must hold at least one joint that moves (got none)")
        self.joint_names = tuple(joint.name for joint in moving)
        if len(set(self.joint_names)) < len(moving):
            raise ValueError("'joints' must have different names (got one twice)")
        self.lower = torch.tensor([float(joint.lower) for joint in moving])
        self.upper = torch.tensor([float(joint.upper) for joint in moving])
        self._sort_links(moving)
        self._kept: _Kept | None = None
        self._kept_few: _KeptFew | None = None

    def _sort_links(self, moving: list[Joint]) -> None:
        by_child: dict[str, Joint] = {}
        for joint in self.joints:
            if joint.child in by_child:
                raise ValueError(
                    f"a link must have one parent (got '{joint.child}' below "
                    f"'{by_child[joint.child].parent}' and '{joint.parent}')"
                )
            by_child[joint.child] = joint
        roots = list(dict.fromkeys(j.parent for j in self.joints if j.parent not in by_child))
        if len(roots) != 1:
            raise ValueError(f"the links must be one tree, with one root (got roots {roots})")
        # A level holds the links that hang on the level before, so that each is one product.
        names, levels = [roots[0]], []
        level = names
        while level:
            children = [joint for joint in self.joints if joint.parent in level]
            level = [joint.child for joint in children]
            if children:
                levels.append(children)
                names = names + level
        if len(names) != len(self.joints) + 1:
            lost = sorted(set(by_child) - set(names))
            raise ValueError(f"the links must be one tree, with one root (got a ring of {lost})")
        self.link_names = tuple(names)
        number = {name: i for i, name in enumerate(names)}
        column = {joint.name: i for i, joint in enumerate(moving)}
        self._levels = [
            (
                torch.tensor([number[joint.parent] for joint in level]),
                # A fixed joint reads the column of zeros behind the joints' own.
                torch.tensor([column.get(joint.name, len(moving)) for joint in level]),
                torch.stack([_turns(joint) for joint in level]),
                torch.tensor([joint.xyz for joint in level], dtype=torch.double),
            )
            for level in levels
        ]

    @property
    def num_joints(self) -> int:
        r"""The number of moving joints :math:`J`."""
        return len(self.joint_names)

    @classmethod
    def allegro(cls) -> Self:
        r"""The right Allegro hand: 16 joints in the order of its ROS driver (index, middle, ring,
        thumb, from base to tip), root :obj:`palm_link`, with :math:`x` out of the palm, :math:`y`
        towards the index finger and :math:`z` towards the fingertips.
        """
        return cls.load(stock_path("chains", "allegro_right"))

    def to_dict(self) -> dict[str, Any]:
        r"""Returns the chain as numbers, strings, lists and dictionaries; limits that a joint does
        not have are left out.
        """
        return {"name": self.name, "joints": [_joint_to_dict(joint) for joint in self.joints]}

    @classmethod
    def from_dict(cls, content: Mapping[str, Any]) -> Self:
        r"""Builds a chain from what :meth:`to_dict` returns.

        Args:
            content (Mapping): :obj:`"joints"`, a list of the arguments of :class:`Joint`, and, if
                wanted, :obj:`"name"`.

        Raises:
            ValueError: If there are no joints, or an argument is missing or unknown.
        """
        if not isinstance(content, Mapping) or "joints" not in content:
            raise ValueError("it must be a JSON object with the key 'joints'")
        try:
            joints = [Joint(**joint) for joint in content["joints"]]
        except TypeError as error:
            raise ValueError(
                f"'joints' must be a list of the arguments of Joint: {error}"
            ) from error
        return cls(joints, name=content.get("name", "hand"))

    @classmethod
    def load(cls, path: PathLike) -> Self:
        r"""Reads a chain from a JSON table, as :obj:`stock_path("chains", "allegro_right")` is one.

        Args:
            path (str or PathLike): The file: :obj:`"name"` and :obj:`"joints"`, a list of the
                arguments of :class:`Joint`.

        Raises:
            FileNotFoundError: If there is no such file.
            ValueError: If the file is no such table; the message names the file.
        """
        try:
            content = json.loads(Path(path).read_text(encoding="utf-8"))
            if isinstance(content, dict):
                content.setdefault("name", Path(path).stem)
            return cls.from_dict(content)
        except (ValueError, TypeError) as error:
            raise ValueError(f"'{path}' is not a table of joints: {error}") from error

    @classmethod
    def from_urdf(cls, path: PathLike, joint_names: Sequence[str] | None = None) -> Self:
        r"""Reads the chain of a URDF file: its revolute, continuous and fixed joints. A
        :obj:`mimic` tag is not followed: such a joint has an angle of its own.

        Args:
            path (str or PathLike): The file.
            joint_names (sequence of str, optional): The moving joints in the order of the joint
                vector; the order of the file if left out. Moving joints that are not named stay
                at angle zero.

        Raises:
            FileNotFoundError: If there is no such file.
            ValueError: If the file is no URDF, a joint has another type, or a named joint is
                missing or named twice; the message names the file.
        """
        content = Path(path).read_bytes()  # not text: the file itself declares its encoding
        try:
            root = ElementTree.fromstring(content)
            if root.tag != "robot":
                raise ValueError(f"the root element must be 'robot' (got '{root.tag}')")
            joints = [_urdf_joint(element) for element in root.iter("joint") if element.get("type")]
            if joint_names is not None:
                moving = {joint.name: joint for joint in joints if joint.axis is not None}
                missing = [name for name in joint_names if name not in moving]
                if missing:
                    raise ValueError(
                        f"'joint_names' must name its moving joints, {list(moving)} "
                        f"(got '{missing[0]}')"
                    )
                if len(set(joint_names)) < len(joint_names):
                    raise ValueError("'joint_names' must name each joint once (got one twice)")
                named = [moving[name] for name in joint_names]
                rest = [joint for joint in joints if joint not in named]
                joints = named + [_still(joint) if joint.axis else joint for joint in rest]
            return cls(joints, name=root.get("name", Path(path).stem))
        except (ValueError, TypeError, ElementTree.ParseError) as error:
            raise ValueError(f"'{path}' is not a URDF of a hand: {error}") from error

    def outside_limits(self, joint: Tensor) -> Tensor:
        r"""Tells which angles are beyond a joint limit, or missing (NaN).

        Args:
            joint (torch.Tensor): Joint angles in radians :math:`(..., J)`.

        Shapes:
            - **output:** booleans :math:`(..., J)`
        """
        self._check(joint)
        moving = [one for one in self.joints if one.axis is not None]
        # Not from float32: a double angle at its limit would be beyond the rounded limit.
        lower = joint.new_tensor([float(one.lower) for one in moving])
        upper = joint.new_tensor([float(one.upper) for one in moving])
        return ~((joint >= lower) & (joint <= upper))

    def _check(self, joint: Tensor) -> None:
        if joint.dim() == 0 or joint.size(-1) != self.num_joints:
            raise ValueError(
                f"'joint' must have shape (..., {self.num_joints}), as '{self.name}' has joints "
                f"(got {tuple(joint.shape)})"
            )
        if not joint.is_floating_point():
            raise ValueError(f"'joint' must be floating-point angles (got {joint.dtype})")
        # No hand turns this far.
        if joint.numel() and bool((joint.detach().abs() > 2 * math.pi).any()):
            warnings.warn(
                f"'joint' must be in radians; an angle of {float(joint.detach().abs().max()):.4g} "
                "looks like degrees (torch.deg2rad converts them)",
                stacklevel=3,
            )

    def link_pose(self, joint: Tensor) -> LinkPose:
        r"""Returns the pose of every link, in the order of :obj:`link_names`.

        Args:
            joint (torch.Tensor): Joint angles in radians :math:`(..., J)`.

        Raises:
            ValueError: If :obj:`joint` has another number of angles, or no floating-point ones.
        """
        self._check(joint)
        return self._link_pose(joint)

    def _link_pose(self, joint: Tensor) -> LinkPose:
        shape = joint.shape[:-1]
        angle = torch.nn.functional.pad(joint, (0, 1))
        ones = torch.ones_like(angle)
        waves = torch.stack([ones, angle.sin(), 1 - angle.cos()], dim=-1)  # (..., J + 1, 3)
        rotation = torch.eye(3).to(joint).expand(*shape, 1, 3, 3)
        translation = joint.new_zeros(*shape, 1, 3)
        for parent, column, turns, xyz in self._levels:
            turns = turns.to(joint).flatten(-2)
            turn = (waves[..., column, None, :] @ turns).view(*shape, len(column), 3, 3)
            above = rotation[..., parent, :, :]
            origin = (above @ xyz.to(joint).unsqueeze(-1)).squeeze(-1)
            rotation = torch.cat([rotation, above @ turn], dim=-3)
            translation = torch.cat([translation, translation[..., parent, :] + origin], dim=-2)
        return LinkPose(rotation, translation)

    def taxel_pose(self, layout: TaxelLayout, joint: Tensor, normal: bool = True) -> PosedTaxels:
        r"""Returns the positions and normals of the taxels of a layout.

        Args:
            layout (TaxelLayout): The layout; its links are links of this hand.
            joint (torch.Tensor): Joint angles in radians :math:`(..., J)`.
            normal (bool): Whether normals are wanted.

        Raises:
            ValueError: If a link of the layout is not one of this hand, or :obj:`joint` has another
                number of angles.
        """
        self._check(joint)
        shape, num_taxels = joint.shape[:-1], layout.num_taxels
        flat = joint.reshape(-1, self.num_joints)
        with_normal = normal and layout.normal is not None
        if len(flat) <= _FEW:
            pos, normals = self._few_taxels(layout, flat, with_normal)
            normals = None if normals is None else normals.view(*shape, num_taxels, 3)
            return PosedTaxels(pos.view(*shape, num_taxels, 3), normals)
        tables, place = self._tables(layout, flat)
        parts = flat.split(_CHUNK)
        if len(parts) > 1 and not (torch.is_grad_enabled() and joint.requires_grad):
            out = [flat.new_empty(len(flat), num_taxels * 3) for _ in range(1 + with_normal)]
            targets = zip(*(value.split(_CHUNK) for value in out), strict=True)
            for part, target in zip(parts, targets, strict=True):
                for values, whole in zip(self._taxels(tables, part, normal), target, strict=True):
                    torch.cat(values, dim=1, out=whole)
        else:
            out = [torch.cat(values, dim=1) for values in self._taxels(tables, flat, normal)]
        values = [value.view(*shape, num_taxels, 3) for value in out]
        if place is not None:
            values = [value[..., place, :] for value in values]
        return PosedTaxels(values[0], values[1] if with_normal else None)

    def require_links(self, layout: TaxelLayout) -> list[str]:
        r"""Returns the links that carry taxels of a layout.

        Args:
            layout (TaxelLayout): The layout.

        Raises:
            ValueError: If one of them is not a link of this hand.
        """
        assert layout.link is not None
        used = [layout.link_names[int(i)] for i in layout.link.unique()]
        missing = [name for name in used if name not in self.link_names]
        if missing:
            raise ValueError(
                f"'{self.name}' must have the links of layout '{layout.name}' (got none named "
                f"'{missing[0]}'; its links are {', '.join(self.link_names)})"
            )
        return used

    def _few_taxels(self, layout: TaxelLayout, joint: Tensor, with_normal: bool) -> PosedTaxels:
        # With homogeneous matrices and taxel by taxel: more work for the processor than the tables,
        # but fewer operations, whose number is what a live frame waits for.
        few = self._few_tables(layout, joint)
        angle = torch.nn.functional.pad(joint, (0, 1))
        waves = torch.stack([torch.ones_like(angle), angle.sin(), 1 - angle.cos()], dim=-1)
        steps = (waves[:, few.column, None, :] @ few.turns).unflatten(-1, (4, 4)).squeeze(2)
        root = torch.eye(4, dtype=joint.dtype, device=joint.device)
        poses, start = [root.expand(len(joint), 1, 4, 4)], 0
        for parent in few.parents:
            step = steps[:, start : start + len(parent)]
            poses.append(poses[-1][:, parent] @ step if start else step)
            start += len(parent)
        pose = torch.cat(poses, dim=1)[:, few.link, :3]
        pos = (pose * few.pos).sum(dim=-1)
        return PosedTaxels(pos, (pose * few.normal).sum(dim=-1) if with_normal else None)

    def _few_tables(self, layout: TaxelLayout, like: Tensor) -> _FewTables:
        kept = self._kept_few
        if kept is None or kept[0] is not layout or kept[1] != (like.dtype, like.device):
            assert layout.link is not None
            number = torch.zeros(len(layout.link_names), dtype=torch.long)
            for name in self.require_links(layout):
                number[layout.link_names.index(name)] = self.link_names.index(name)
            normal = torch.zeros_like(layout.pos) if layout.normal is None else layout.normal
            parents, column, turns, xyz = zip(*self._levels, strict=True)
            table = torch.zeros(len(self.joints), 3, 4, 4, dtype=torch.double)
            table[..., :3, :3] = torch.cat(turns)
            table[:, 0, :3, 3] = torch.cat(xyz)
            table[:, 0, 3, 3] = 1.0
            first = [0, *torch.tensor([len(level) for level in parents]).cumsum(0).tolist()]
            with torch.inference_mode(False):  # or no gradient could pass through them later
                tables = _FewTables(
                    # A link hangs on the level before its own.
                    [
                        (level - (first[i - 1] + 1 if i else 0)).to(like.device)
                        for i, level in enumerate(parents)
                    ],
                    torch.cat(column).to(like.device),
                    table.flatten(2).to(like),
                    number[layout.link].to(like.device),
                    torch.nn.functional.pad(layout.pos, (0, 1), value=1.0).unsqueeze(1).to(like),
                    torch.nn.functional.pad(normal, (0, 1)).unsqueeze(1).to(like),
                )
            self._kept_few = kept = (layout, (like.dtype, like.device), tables)
        return kept[2]

    def _tables(self, layout: TaxelLayout, like: Tensor) -> tuple[list[_Table], Tensor | None]:
        # The tables, and where each taxel stands in what they give if that is in another order.
        # Kept, since a layout is frozen, and making them costs more than the pose of a frame.
        kept = self._kept
        if kept is None or kept[0] is not layout or kept[1] != (like.dtype, like.device):
            with torch.inference_mode(False):  # or no gradient could pass through them later
                tables, order = [], []
                assert layout.link is not None
                for name in self.require_links(layout):
                    taxels = (layout.link == layout.link_names.index(name)).nonzero().view(-1)
                    tables.append((self.link_names.index(name), *_tables(layout, taxels, like)))
                    order.append(taxels)
                place = torch.cat(order).argsort()
            in_order = torch.equal(place, torch.arange(layout.num_taxels))
            made = tables, None if in_order else place
            self._kept = kept = (layout, (like.dtype, like.device), made)
        return kept[2]

    def _taxels(self, tables: list[_Table], joint: Tensor, with_normal: bool) -> list[list[Tensor]]:
        rotation, translation = self._link_pose(joint)
        pos, normal = [], []
        for link, pos_table, normal_table in tables:
            turn = rotation[:, link].reshape(-1, 9)
            pos.append(torch.cat([turn, translation[:, link]], dim=1) @ pos_table)
            if with_normal and normal_table is not None:
                normal.append(turn @ normal_table)
        return [pos, normal] if normal else [pos]

    def __repr__(self) -> str:
        return (
            f"{type(self).__name__}('{self.name}', num_joints={self.num_joints}, "
            f"num_links={len(self.link_names)})"
        )


def _tables(layout: TaxelLayout, taxels: Tensor, like: Tensor) -> tuple[Tensor, Tensor | None]:
    # Position and normal are linear in the link's pose: one matrix serves all frames.
    eye = torch.eye(3).to(like)

    def turned(vectors: Tensor) -> Tensor:
        return torch.einsum("nj,ik->ijnk", vectors[taxels].to(like), eye).reshape(9, -1)

    shift = eye.unsqueeze(1).expand(3, len(taxels), 3).reshape(3, -1)
    normal = None if layout.normal is None else turned(layout.normal)
    return torch.cat([turned(layout.pos), shift]), normal


def _cross_matrix(axis: Sequence[float]) -> Tensor:
    x, y, z = axis
    return torch.tensor([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]], dtype=torch.double)


def _turns(joint: Joint) -> Tensor:
    # Rodrigues: R = R0 (1 + sin K + (1 - cos) K^2), as a table of its three terms.
    roll, pitch, yaw = joint.rpy
    still = torch.eye(3, dtype=torch.double)
    for angle, axis in ((roll, (1, 0, 0)), (pitch, (0, 1, 0)), (yaw, (0, 0, 1))):
        still = torch.linalg.matrix_exp(angle * _cross_matrix(axis)) @ still
    cross = _cross_matrix(joint.axis or (0.0, 0.0, 0.0))
    return torch.stack([still, still @ cross, still @ cross @ cross])


def _joint_to_dict(joint: Joint) -> dict[str, Any]:
    content = dataclasses.asdict(joint)
    for key in ("lower", "upper"):
        if math.isinf(content[key]):  # no number in JSON
            del content[key]
    return {key: list(v) if isinstance(v, tuple) else v for key, v in content.items()}


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
