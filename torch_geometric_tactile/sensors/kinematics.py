r"""The forward kinematics of a hand."""

import math
import warnings
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple, Self

import torch
from torch import Tensor

from torch_geometric_tactile._checks import need
from torch_geometric_tactile._texts import read_json, short_repr
from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile.sensors._content_checks import need_text, only_keys
from torch_geometric_tactile.sensors._pose_tables import (
    link_tables,
    link_tree,
    pose_links,
    pose_small_batch,
    pose_tables,
    small_batch_tables,
    tree_levels,
)
from torch_geometric_tactile.sensors._urdf import read_urdf
from torch_geometric_tactile.sensors.joints import Joint
from torch_geometric_tactile.sensors.layout import TaxelLayout
from torch_geometric_tactile.sensors.stock import stock_path

_KEYS = ("name", "source", "joints", "bodies")
_FEW = 4  # frames up to which the number of operations costs more than the work in them
_CHUNK = 4096  # frames worked on at a time: the intermediate results then fit into the cache


_Kept = tuple[TaxelLayout, tuple[torch.dtype, torch.device], Any]
_Make = Callable[[Mapping[str, int]], Any]  # of the numbers of the links


class LinkPose(NamedTuple):
    r"""The rotations and translations of the links of a hand, in the frame of the root link.

    :obj:`rotation` :math:`(..., L, 3, 3)` turns vectors of a link's frame into the root's, and
    :obj:`translation` :math:`(..., L, 3)` is the link's origin in metres.

    Examples:
        >>> pose = HandKinematics.allegro().link_pose(torch.zeros(16))
        >>> pose.rotation.shape[-2:], pose.translation.shape[-1]
        (torch.Size([3, 3]), 3)
    """

    rotation: Tensor
    translation: Tensor


class PosedTaxels(NamedTuple):
    r"""The positions and normals of the taxels of a posed hand, in the frame of the root link:
    :obj:`pos` in metres and unit :obj:`normal`, both :math:`(..., N, 3)`. :obj:`normal` is
    :obj:`None` if the layout has no normals.

    Examples:
        >>> from torch_geometric_tactile.sensors import allegro_uskin
        >>> posed = HandKinematics.allegro().taxel_pose(allegro_uskin(), torch.zeros(16))
        >>> posed.pos.shape, posed.normal.shape
        (torch.Size([384, 3]), torch.Size([384, 3]))
    """

    pos: Tensor
    normal: Tensor | None


class HandKinematics:
    r"""Computes the forward kinematics of a hand, from joint angles to link poses to taxel
    positions and normals, batched and differentiable.

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
        need(moving, "'joints' must hold at least one joint that moves (got none)")
        self.joint_names = tuple(joint.name for joint in moving)
        if len(set(self.joint_names)) < len(moving):
            raise ValueError("'joints' must have different names (got one twice)")
        self.lower = torch.tensor([float(joint.lower) for joint in moving])
        self.upper = torch.tensor([float(joint.upper) for joint in moving])
        tree = link_tree(self.joints)
        self.link_names = tree.names
        self._levels = tree_levels(tree, moving)
        self._kept: dict[str, _Kept] = {}

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_kept": {}}  # a cache is no part of a copy

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
            content = read_json(path)
            if isinstance(content, dict):
                content = {"name": Path(path).stem, **content}
            return cls.from_dict(content)
        except ValueError as error:
            raise ValueError(f"'{path}' is not a table of joints: {error}") from error

    def to_dict(self) -> dict[str, Any]:
        r"""Returns the hand as numbers, texts, lists and dictionaries."""
        return {"name": self.name, "joints": [joint.to_dict() for joint in self.joints]}

    @classmethod
    def from_dict(cls, content: Mapping[str, Any]) -> Self:
        r"""Builds a hand from what :meth:`to_dict` returns.

        Args:
            content (Mapping): :obj:`"joints"`, a list of the arguments of :class:`Joint`, and, if
                wanted, :obj:`"name"`; :obj:`"source"` and :obj:`"bodies"` are not read.

        Raises:
            ValueError: If it holds no joints, or the joints are no hand.
        """
        if not isinstance(content, Mapping) or "joints" not in content:
            raise ValueError("it must be a JSON object with the key 'joints'")
        only_keys(content, _KEYS, "a table of joints")
        if not isinstance(content["joints"], list | tuple):
            raise ValueError(f"'joints' must be a list (got {short_repr(content['joints'])})")
        try:
            joints = [Joint(**joint) for joint in content["joints"]]
        except (TypeError, OverflowError) as error:
            raise ValueError(f"'joints' must list the arguments of Joint: {error}") from error
        name = content.get("name", "hand")
        need_text(name, "'name'")
        return cls(joints, name=name)

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
        try:
            joints, name = read_urdf(Path(path), joint_names)
            return cls(joints, name=name)
        except ValueError as error:
            raise ValueError(f"'{path}' is not a URDF of a hand: {error}") from error

    def outside_limits(self, joint: Tensor) -> Tensor:
        r"""Tells which angles are beyond a joint limit, or missing (NaN).

        Args:
            joint (torch.Tensor): Joint angles in radians :math:`(..., J)`.

        Shapes:
            - **output:** booleans :math:`(..., J)`
        """
        _check_joint(self, joint)
        moving = [one for one in self.joints if one.axis is not None]
        # Not from float32: a double angle at its limit would be beyond the rounded limit.
        lower = joint.new_tensor([float(one.lower) for one in moving])
        upper = joint.new_tensor([float(one.upper) for one in moving])
        return ~((joint >= lower) & (joint <= upper))

    def link_pose(self, joint: Tensor) -> LinkPose:
        r"""Returns the pose of every link, in the order of :obj:`link_names`.

        Args:
            joint (torch.Tensor): Joint angles in radians :math:`(..., J)`.

        Raises:
            ValueError: If :obj:`joint` has another number of angles, or no floating-point ones.
        """
        _check_joint(self, joint)
        return LinkPose(*pose_links(self._levels, joint))

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
        _check_joint(self, joint)
        shape, num_taxels = joint.shape[:-1], layout.num_taxels
        flat = joint.reshape(-1, self.num_joints)
        with_normal = normal and layout.normal is not None
        if len(flat) <= _FEW:
            tables = self._kept_tables(layout, flat, small=True)
            pos, normals = pose_small_batch(tables, flat, with_normal)
            normals = None if normals is None else normals.view(*shape, num_taxels, 3)
            return PosedTaxels(pos.view(*shape, num_taxels, 3), normals)
        tables, place = self._kept_tables(layout, flat, small=False)
        out = pose_tables(self._levels, tables, flat, with_normal, _CHUNK)
        values = [value.view(*shape, num_taxels, 3) for value in out]
        if place is not None:
            values = [value[..., place, :] for value in values]
        return PosedTaxels(values[0], values[1] if with_normal else None)

    def taxel_axes(self, layout: TaxelLayout, joint: Tensor) -> Tensor:
        r"""Returns the axes of the taxels, :meth:`TaxelLayout.axes`, in the frame of the root link.

        Args:
            layout (TaxelLayout): The layout; its links are links of this hand.
            joint (torch.Tensor): Joint angles in radians :math:`(..., J)`.

        Shapes:
            - **output:** the unit axes :math:`x`, :math:`y` and normal as rows
              :math:`(..., N, 3, 3)`

        Raises:
            ValueError: If a link of the layout is not one of this hand, or :obj:`joint` has another
                number of angles.
        """
        links, axes = self._kept_axes(layout, joint)
        return axes @ self.link_pose(joint).rotation[..., links, :, :].mT

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

    def _kept_tables(self, layout: TaxelLayout, like: Tensor, small: bool) -> Any:
        if small:
            return self._kept_for(
                "small", layout, like, lambda of: small_batch_tables(self._levels, of, layout, like)
            )
        return self._kept_for("many", layout, like, lambda of: link_tables(of, layout, like))

    def _kept_axes(self, layout: TaxelLayout, like: Tensor) -> Any:
        # The link of each taxel, and its axes in this link's frame.
        def made(numbers: Mapping[str, int]) -> tuple[Tensor, Tensor]:
            assert layout.link is not None
            with torch.inference_mode(False):  # or no gradient could pass through them later
                links = torch.tensor([numbers.get(name, 0) for name in layout.link_names])
                return links[layout.link].to(like.device), layout.axes(torch.double).to(like)

        return self._kept_for("axes", layout, like, made)

    def _kept_for(self, what: str, layout: TaxelLayout, like: Tensor, make: _Make) -> Any:
        # Kept, since a layout is frozen, and making it costs more than the pose of a frame.
        kept = self._kept.get(what)
        if kept is None or kept[0] is not layout or kept[1] != (like.dtype, like.device):
            names = self.require_links(layout)
            made = make({name: self.link_names.index(name) for name in names})
            self._kept[what] = kept = (layout, (like.dtype, like.device), made)
        return kept[2]

    def __repr__(self) -> str:
        return (
            f"{type(self).__name__}('{self.name}', num_joints={self.num_joints}, "
            f"num_links={len(self.link_names)})"
        )


def _check_joint(hand: HandKinematics, joint: Tensor) -> None:
    if joint.dim() == 0 or joint.size(-1) != hand.num_joints:
        raise ValueError(
            f"'joint' must have shape (..., {hand.num_joints}), as '{hand.name}' has joints "
            f"(got {tuple(joint.shape)})"
        )
    need(joint.is_floating_point(), "'joint' must be floating-point angles", joint.dtype)
    if torch.compiler.is_compiling():  # an export must not depend on values
        return
    # No hand turns this far.
    if joint.numel() and bool((joint.detach().abs() > 2 * math.pi).any()):
        warnings.warn(
            f"'joint' must be in radians; an angle of {float(joint.detach().abs().max()):.4g} "
            "looks like degrees (torch.deg2rad converts them)",
            stacklevel=3,
        )
