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
from torch_geometric_tactile.sensors._content_checks import need_only_keys, need_text
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
# Up to this number of frames, the overhead of the operations costs more than the arithmetic.
_MAX_SMALL_BATCH = 4
_CHUNK = 4096  # frames at a time, so that intermediate results fit into the processor's cache


# The layout, type and device that constants were computed for, and the constants.
_CacheEntry = tuple[TaxelLayout, tuple[torch.dtype, torch.device], Any]
_BuildTables = Callable[[Mapping[str, int]], Any]  # from the indices of the links


class LinkPose(NamedTuple):
    r"""The rotations and translations of the links of a hand, in the frame of the root link.

    :obj:`rotation` :math:`(..., L, 3, 3)` rotates vectors from a link's frame to the root frame,
    and :obj:`translation` :math:`(..., L, 3)` is the link's origin in metres.

    Examples:
        >>> pose = HandKinematics.allegro().link_pose(torch.zeros(16))
        >>> pose.rotation.shape[-2:], pose.translation.shape[-1]
        (torch.Size([3, 3]), 3)
    """

    rotation: Tensor
    translation: Tensor


class PosedTaxels(NamedTuple):
    r"""The positions and normals of the taxels of a posed hand, in the frame of the root link.
    :obj:`pos` is in metres, and :obj:`normal` holds unit vectors, both :math:`(..., N, 3)`.
    :obj:`normal` is :obj:`None` if the layout has no normals.

    Examples:
        >>> from torch_geometric_tactile.sensors import allegro_uskin
        >>> posed = HandKinematics.allegro().taxel_pose(allegro_uskin(), torch.zeros(16))
        >>> posed.pos.shape, posed.normal.shape
        (torch.Size([384, 3]), torch.Size([384, 3]))
    """

    pos: Tensor
    normal: Tensor | None


class HandKinematics:
    r"""Computes the forward kinematics of a hand: link poses, taxel positions and taxel normals
    from joint angles. All results are batched and differentiable.

    Angles are never clipped. Use :meth:`outside_limits` to find angles beyond a limit.

    Args:
        joints (sequence of Joint): The joints. The joint vector :math:`(J,)` holds the angles of
            the moving joints, in this order.
        name (str): Name of the hand.

    Raises:
        ValueError: If no joint moves, two joints have the same name, a link has two parents, or the
            links do not form one tree.

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
        self._kept: dict[str, _CacheEntry] = {}

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_kept": {}}  # The cache is not copied or pickled.

    @property
    def num_joints(self) -> int:
        r"""The number of moving joints :math:`J`."""
        return len(self.joint_names)

    @classmethod
    def allegro(cls) -> Self:
        r"""Returns the right Allegro hand, with 16 joints in the order of its ROS driver (index,
        middle, ring, thumb, from base to tip). In the root frame, :obj:`palm_link`, :math:`x`
        points out of the palm, :math:`y` towards the index finger and :math:`z` towards the
        fingertips.
        """
        return cls.load(stock_path("chains", "allegro_right"))

    @classmethod
    def load(cls, path: PathLike) -> Self:
        r"""Reads a hand from a JSON file, such as :obj:`stock_path("chains", "allegro_right")`.

        Args:
            path (str or PathLike): The file, with the keys :obj:`"name"` and :obj:`"joints"`, a
                list of the arguments of :class:`Joint`.

        Raises:
            FileNotFoundError: If the file does not exist.
            ValueError: If the file is not a table of joints. The message names the file.
        """
        try:
            content = read_json(path)
            if isinstance(content, dict):
                content = {"name": Path(path).stem, **content}
            return cls.from_dict(content)
        except ValueError as error:
            raise ValueError(f"'{path}' is not a table of joints: {error}") from error

    def to_dict(self) -> dict[str, Any]:
        r"""Returns the hand as JSON values."""
        return {"name": self.name, "joints": [joint.to_dict() for joint in self.joints]}

    @classmethod
    def from_dict(cls, content: Mapping[str, Any]) -> Self:
        r"""Builds a hand from the output of :meth:`to_dict`.

        Args:
            content (Mapping): The key :obj:`"joints"`, a list of the arguments of :class:`Joint`,
                and optionally :obj:`"name"`. The keys :obj:`"source"` and :obj:`"bodies"` are
                ignored.

        Raises:
            ValueError: If :obj:`"joints"` is missing, a key is unknown, or the joints do not form a
                hand.
        """
        if not isinstance(content, Mapping) or "joints" not in content:
            raise ValueError("it must be a JSON object with the key 'joints'")
        need_only_keys(content, _KEYS, "a table of joints")
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
        r"""Reads a hand from a URDF file with revolute, continuous and fixed joints. The
        :obj:`mimic` tag is ignored: such a joint has an independent angle.

        Args:
            path (str or PathLike): The file.
            joint_names (sequence of str, optional): The moving joints in the order of the joint
                vector. By default the order of the file. Other moving joints stay at angle zero.

        Raises:
            FileNotFoundError: If the file does not exist.
            ValueError: If the file is not a URDF, a joint has an unsupported type, or a named joint
                is missing or named twice. The message names the file.
        """
        try:
            joints, name = read_urdf(Path(path), joint_names)
            return cls(joints, name=name)
        except ValueError as error:
            raise ValueError(f"'{path}' is not a URDF of a hand: {error}") from error

    def outside_limits(self, joint: Tensor) -> Tensor:
        r"""Returns which angles are beyond a joint limit or missing (NaN).

        Args:
            joint (torch.Tensor): Joint angles in radians :math:`(..., J)`.

        Shapes:
            - **output:** booleans :math:`(..., J)`
        """
        _check_joint(self, joint)
        moving = [each for each in self.joints if each.axis is not None]
        # Not self.lower and self.upper: rounded to float32, a limit may be below an angle at it.
        lower = joint.new_tensor([float(moving_joint.lower) for moving_joint in moving])
        upper = joint.new_tensor([float(moving_joint.upper) for moving_joint in moving])
        return ~((joint >= lower) & (joint <= upper))

    def link_pose(self, joint: Tensor) -> LinkPose:
        r"""Returns the pose of every link, in the order of :obj:`link_names`.

        Args:
            joint (torch.Tensor): Joint angles in radians :math:`(..., J)`.

        Raises:
            ValueError: If :obj:`joint` has the wrong number of angles or is not floating-point.
        """
        _check_joint(self, joint)
        return LinkPose(*pose_links(self._levels, joint))

    def taxel_pose(self, layout: TaxelLayout, joint: Tensor, normal: bool = True) -> PosedTaxels:
        r"""Returns the positions and normals of the taxels of a layout.

        Args:
            layout (TaxelLayout): The layout. Its links must be links of this hand.
            joint (torch.Tensor): Joint angles in radians :math:`(..., J)`.
            normal (bool): Whether to return normals.

        Raises:
            ValueError: If a link of the layout is not a link of this hand, or :obj:`joint` has the
                wrong number of angles.
        """
        _check_joint(self, joint)
        shape, num_taxels = joint.shape[:-1], layout.num_taxels
        flat = joint.reshape(-1, self.num_joints)
        with_normal = normal and layout.normal is not None
        if len(flat) <= _MAX_SMALL_BATCH:
            tables = self._cached_tables(layout, flat, small=True)
            pos, normals = pose_small_batch(tables, flat, with_normal)
            normals = None if normals is None else normals.view(*shape, num_taxels, 3)
            return PosedTaxels(pos.view(*shape, num_taxels, 3), normals)
        tables, permutation = self._cached_tables(layout, flat, small=False)
        columns = pose_tables(self._levels, tables, flat, with_normal, _CHUNK)
        vectors = [column.view(*shape, num_taxels, 3) for column in columns]
        if permutation is not None:
            vectors = [vector[..., permutation, :] for vector in vectors]
        return PosedTaxels(vectors[0], vectors[1] if with_normal else None)

    def taxel_axes(self, layout: TaxelLayout, joint: Tensor) -> Tensor:
        r"""Returns the axes of the taxels (:meth:`TaxelLayout.axes`) in the frame of the root link.

        Args:
            layout (TaxelLayout): The layout. Its links must be links of this hand.
            joint (torch.Tensor): Joint angles in radians :math:`(..., J)`.

        Shapes:
            - **output:** the unit axes :math:`x`, :math:`y` and normal as rows
              :math:`(..., N, 3, 3)`

        Raises:
            ValueError: If a link of the layout is not a link of this hand, or :obj:`joint` has the
                wrong number of angles.
        """
        links, axes = self._cached_axes(layout, joint)
        return axes @ self.link_pose(joint).rotation[..., links, :, :].mT

    def require_links(self, layout: TaxelLayout) -> list[str]:
        r"""Returns the names of the links that carry taxels of a layout.

        Args:
            layout (TaxelLayout): The layout.

        Raises:
            ValueError: If a link of the layout is not a link of this hand.
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

    def _cached_tables(self, layout: TaxelLayout, like: Tensor, small: bool) -> Any:
        if small:
            return self._cached(
                "small",
                layout,
                like,
                lambda link_index: small_batch_tables(self._levels, link_index, layout, like),
            )
        return self._cached(
            "many", layout, like, lambda link_index: link_tables(link_index, layout, like)
        )

    def _cached_axes(self, layout: TaxelLayout, like: Tensor) -> Any:
        # The link of each taxel (N,), and its axes in the frame of the link (N, 3, 3).
        def build(link_index: Mapping[str, int]) -> tuple[Tensor, Tensor]:
            assert layout.link is not None
            with torch.inference_mode(False):  # Gradients cannot pass through inference tensors.
                links = torch.tensor([link_index.get(name, 0) for name in layout.link_names])
                return links[layout.link].to(like.device), layout.axes(torch.double).to(like)

        return self._cached("axes", layout, like, build)

    def _cached(self, key: str, layout: TaxelLayout, like: Tensor, build: _BuildTables) -> Any:
        # A layout is frozen, so its constants are computed only once: computing them takes longer
        # than the pose of a frame. Only the last layout is cached for each key.
        entry = self._kept.get(key)
        if entry is None or entry[0] is not layout or entry[1] != (like.dtype, like.device):
            names = self.require_links(layout)
            tables = build({name: self.link_names.index(name) for name in names})
            self._kept[key] = entry = (layout, (like.dtype, like.device), tables)
        return entry[2]

    def __repr__(self) -> str:
        return (
            f"{type(self).__name__}('{self.name}', num_joints={self.num_joints}, "
            f"num_links={len(self.link_names)})"
        )


def _check_joint(hand: HandKinematics, joint: Tensor) -> None:
    if joint.dim() == 0 or joint.size(-1) != hand.num_joints:
        raise ValueError(
            f"'joint' must have shape (..., {hand.num_joints}), the joints of '{hand.name}' "
            f"(got {tuple(joint.shape)})"
        )
    need(joint.is_floating_point(), "'joint' must be floating-point angles", joint.dtype)
    if torch.compiler.is_compiling():  # A compiled graph must not depend on values.
        return
    # No joint of a hand turns by more than a full turn, so larger angles are probably in degrees.
    if joint.numel() and bool((joint.detach().abs() > 2 * math.pi).any()):
        warnings.warn(
            f"'joint' must be in radians; an angle of {float(joint.detach().abs().max()):.4g} "
            "looks like degrees (torch.deg2rad converts them)",
            stacklevel=3,
        )
