r"""The tree of a hand's links, and constant tables of a hand and a layout for its poses."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from torch_geometric_tactile._checks import need
from torch_geometric_tactile.sensors.joints import Joint
from torch_geometric_tactile.sensors.layout import TaxelLayout

_MAX_JOINTS = 1000


class LinkTree(NamedTuple):
    r"""The links of a hand, with the root first, and its joints by level. The parents of the links
    of a level are in the previous level.
    """

    names: tuple[str, ...]
    levels: list[list[Joint]]


def link_tree(joints: Sequence[Joint]) -> LinkTree:
    r"""Returns the tree of the links that joints connect.

    Raises:
        ValueError: If there are too many joints, two have the same name, a link has two parents, or
            the links do not form one tree.
    """
    need(len(joints) <= _MAX_JOINTS, f"'joints' must hold at most {_MAX_JOINTS}", len(joints))
    if len({joint.name for joint in joints}) < len(joints):
        raise ValueError("'joints' must have different names (got one twice)")
    by_child: dict[str, Joint] = {}
    for joint in joints:
        if joint.child in by_child:
            raise ValueError(
                f"a link must have one parent (got '{joint.child}' below "
                f"'{by_child[joint.child].parent}' and '{joint.parent}')"
            )
        by_child[joint.child] = joint
    roots = list(dict.fromkeys(j.parent for j in joints if j.parent not in by_child))
    need(len(roots) == 1, f"the links must form one tree with one root (got roots {roots})")
    names, levels = [roots[0]], []
    level = names
    while level:
        parents = set(level)
        children = [joint for joint in joints if joint.parent in parents]
        level = [joint.child for joint in children]
        if children:
            levels.append(children)
            names = names + level
    if len(names) != len(joints) + 1:
        unreachable = sorted(set(by_child) - set(names))
        raise ValueError(
            f"the links must form one tree with one root (got a ring of {unreachable})"
        )
    return LinkTree(tuple(names), levels)


class Level(NamedTuple):
    r"""One level of :math:`K` links, whose parents are all in the previous level. One matrix
    product computes all poses of a level.

    Shapes:
        - **parent:** index of the parent link :math:`(K,)`
        - **column:** index of the joint angle in the joint vector :math:`(K,)`
        - **turns:** terms of the joint's rotation :math:`(K, 3, 3, 3)`
        - **xyz:** origin in the parent's frame in metres :math:`(K, 3)`
    """

    parent: Tensor
    column: Tensor
    turns: Tensor
    xyz: Tensor


class SmallBatchTables(NamedTuple):
    r"""Constants to compute the poses of a small batch with few operations.

    Shapes:
        - **parents:** for each level, the index of each link's parent in the level before
        - **column:** index of each link's joint angle in the joint vector :math:`(L - 1,)`
        - **turns:** terms of each link's matrix relative to its parent :math:`(L - 1, 3, 16)`
        - **link:** link of each taxel :math:`(N,)`
        - **pos, normal:** homogeneous coordinates of each taxel :math:`(N, 1, 4)`
    """

    parents: list[Tensor]
    column: Tensor
    turns: Tensor
    link: Tensor
    pos: Tensor
    normal: Tensor


# A link, and the factors of its pose for the positions and the normals of its taxels.
LinkTable = tuple[int, Tensor, Tensor | None]


def tree_levels(tree: LinkTree, moving: Sequence[Joint]) -> list[Level]:
    r"""Returns the constants of each level of a hand's links."""
    link_index = {name: i for i, name in enumerate(tree.names)}
    column = {joint.name: i for i, joint in enumerate(moving)}
    return [
        Level(
            torch.tensor([link_index[joint.parent] for joint in level]),
            # A fixed joint uses an additional column of zeros after the moving joints.
            torch.tensor([column.get(joint.name, len(moving)) for joint in level]),
            torch.stack([_joint_turns(joint) for joint in level]),
            torch.tensor([joint.xyz for joint in level], dtype=torch.double),
        )
        for level in tree.levels
    ]


def _cross_matrix(axis: Sequence[float]) -> Tensor:
    x, y, z = axis
    return torch.tensor([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]], dtype=torch.double)


def _joint_turns(joint: Joint) -> Tensor:
    r"""Returns the terms :math:`1, \sin q, 1 - \cos q` of the rotation of a joint by :math:`q`.

    Shapes:
        - **output:** :math:`(3, 3, 3)`
    """
    # Rodrigues' formula: R = R0 (1 + sin(q) K + (1 - cos(q)) K^2), with the rotation R0 at q = 0.
    roll, pitch, yaw = joint.rpy
    rotation = torch.eye(3, dtype=torch.double)
    for angle, axis in ((roll, (1, 0, 0)), (pitch, (0, 1, 0)), (yaw, (0, 0, 1))):
        rotation = torch.linalg.matrix_exp(angle * _cross_matrix(axis)) @ rotation
    cross = _cross_matrix(joint.axis or (0.0, 0.0, 0.0))
    return torch.stack([rotation, rotation @ cross, rotation @ cross @ cross])


def pose_links(levels: Sequence[Level], joint: Tensor) -> tuple[Tensor, Tensor]:
    r"""Returns the rotation :math:`(..., L, 3, 3)` and translation :math:`(..., L, 3)` of all links
    in the frame of the root link.

    Shapes:
        - **joint:** Joint angles in radians :math:`(..., J)`.
    """
    shape = joint.shape[:-1]
    terms = _angle_terms(joint)
    rotation = torch.eye(3).to(joint).expand(*shape, 1, 3, 3)
    translation = joint.new_zeros(*shape, 1, 3)
    for parent, column, turns, xyz in levels:
        turns = turns.to(joint).flatten(-2)
        local_rotation = (terms[..., column, None, :] @ turns).view(*shape, len(column), 3, 3)
        parent_rotation = rotation[..., parent, :, :]
        origin = (parent_rotation @ xyz.to(joint).unsqueeze(-1)).squeeze(-1)
        rotation = torch.cat([rotation, parent_rotation @ local_rotation], dim=-3)
        translation = torch.cat([translation, translation[..., parent, :] + origin], dim=-2)
    return rotation, translation


def _angle_terms(joint: Tensor) -> Tensor:
    # 1, sin(q) and 1 - cos(q) of each joint, and of the zero angle of fixed joints (..., J + 1, 3).
    angle = torch.nn.functional.pad(joint, (0, 1))
    return torch.stack([torch.ones_like(angle), angle.sin(), 1 - angle.cos()], dim=-1)


def small_batch_tables(
    levels: Sequence[Level], link_index: Mapping[str, int], layout: TaxelLayout, like: Tensor
) -> SmallBatchTables:
    r"""Returns the constants of :func:`pose_small_batch`.

    Args:
        levels (sequence of Level): The levels of the hand's links.
        link_index (Mapping of str to int): Index of each link with taxels in the hand.
        layout (TaxelLayout): The taxels.
        like (Tensor): Joint angles, whose type and device are used.
    """
    assert layout.link is not None
    index = torch.zeros(len(layout.link_names), dtype=torch.long)
    for name, i in link_index.items():
        index[layout.link_names.index(name)] = i
    normal = torch.zeros_like(layout.pos) if layout.normal is None else layout.normal
    parents, column, turns, xyz = zip(*levels, strict=True)
    table = torch.zeros(sum(map(len, parents)), 3, 4, 4, dtype=torch.double)
    table[..., :3, :3] = torch.cat(turns)
    table[:, 0, :3, 3] = torch.cat(xyz)
    table[:, 0, 3, 3] = 1.0
    first = [0, *torch.tensor([len(level) for level in parents]).cumsum(0).tolist()]
    with torch.inference_mode(False):  # Gradients cannot pass through inference tensors.
        return SmallBatchTables(
            # The index in all links becomes an index in the level before; the root is link 0.
            [
                (level - (first[i - 1] + 1 if i else 0)).to(like.device)
                for i, level in enumerate(parents)
            ],
            torch.cat(column).to(like.device),
            table.flatten(2).to(like),
            index[layout.link].to(like.device),
            torch.nn.functional.pad(layout.pos, (0, 1), value=1.0).unsqueeze(1).to(like),
            torch.nn.functional.pad(normal, (0, 1)).unsqueeze(1).to(like),
        )


def pose_small_batch(
    tables: SmallBatchTables, joint: Tensor, with_normal: bool
) -> tuple[Tensor, Tensor | None]:
    r"""Returns the positions and normals :math:`(T, N, 3)` of a small batch of frames.

    A homogeneous matrix for each taxel takes more arithmetic than :func:`pose_tables`, but fewer
    operations, and the number of operations determines the latency of a live frame.

    Shapes:
        - **joint:** Joint angles in radians :math:`(T, J)`.
    """
    pose = chain_small_batch(tables, joint).index_select(1, tables.link)[:, :, :3]
    pos = (pose * tables.pos).sum(dim=-1)
    return pos, (pose * tables.normal).sum(dim=-1) if with_normal else None


def chain_small_batch(tables: SmallBatchTables, joint: Tensor) -> Tensor:
    r"""Returns the homogeneous matrices of all links :math:`(T, L, 4, 4)` for a small batch.

    Shapes:
        - **joint:** Joint angles in radians :math:`(T, J)`.
    """
    terms = _angle_terms(joint).index_select(1, tables.column).unsqueeze(2)
    steps = (terms @ tables.turns).unflatten(-1, (4, 4)).squeeze(2)
    root = torch.eye(4, dtype=joint.dtype, device=joint.device)
    poses, start = [root.expand(len(joint), 1, 4, 4)], 0
    for parent in tables.parents:
        step = steps[:, start : start + len(parent)]
        poses.append(poses[-1].index_select(1, parent) @ step if start else step)
        start += len(parent)
    return torch.cat(poses, dim=1)


def link_tables(
    link_index: Mapping[str, int], layout: TaxelLayout, like: Tensor
) -> tuple[list[LinkTable], Tensor | None]:
    r"""Returns the constants of each link for :func:`pose_tables`, and the permutation that brings
    its output into the order of the taxels, or :obj:`None` if no permutation is needed.
    """
    assert layout.link is not None
    with torch.inference_mode(False):  # Gradients cannot pass through inference tensors.
        tables, order = [], []
        for name, i in link_index.items():
            taxels = (layout.link == layout.link_names.index(name)).nonzero().view(-1)
            tables.append((i, *_link_table(layout, taxels, like)))
            order.append(taxels)
        permutation = torch.cat(order).argsort()
    is_identity = torch.equal(permutation, torch.arange(layout.num_taxels))
    return tables, None if is_identity else permutation


def _link_table(layout: TaxelLayout, taxels: Tensor, like: Tensor) -> tuple[Tensor, Tensor | None]:
    # Positions (12, 3 N) and normals (9, 3 N) are linear in the pose of the link, so one matrix
    # product computes them for all frames.
    eye = torch.eye(3).to(like)

    def rotation_table(vectors: Tensor) -> Tensor:
        return torch.einsum("nj,ik->ijnk", vectors[taxels].to(like), eye).reshape(9, -1)

    translation_table = eye.unsqueeze(1).expand(3, len(taxels), 3).reshape(3, -1)
    normal = None if layout.normal is None else rotation_table(layout.normal)
    return torch.cat([rotation_table(layout.pos), translation_table]), normal


def pose_tables(
    levels: Sequence[Level],
    tables: Sequence[LinkTable],
    joint: Tensor,
    with_normal: bool,
    chunk: int,
) -> list[Tensor]:
    r"""Returns the positions of the taxels in many frames, and with :obj:`with_normal` their
    normals, each :math:`(T, 3 N)`. Taxels are in the order of the tables.

    Shapes:
        - **joint:** Joint angles in radians :math:`(T, J)`.
    """
    parts = joint.split(chunk)
    # torch.cat(out=...) has no gradient.
    if len(parts) == 1 or (torch.is_grad_enabled() and joint.requires_grad):
        return [torch.cat(blocks, dim=1) for blocks in _by_link(levels, tables, joint, with_normal)]
    width = sum(pos_table.size(1) for _, pos_table, _ in tables)
    outputs = [joint.new_empty(len(joint), width) for _ in range(1 + with_normal)]
    out_parts = zip(*(output.split(chunk) for output in outputs), strict=True)
    for part, out_part in zip(parts, out_parts, strict=True):
        by_link = _by_link(levels, tables, part, with_normal)
        for blocks, out in zip(by_link, out_part, strict=True):
            torch.cat(blocks, dim=1, out=out)
    return outputs


def _by_link(
    levels: Sequence[Level], tables: Sequence[LinkTable], joint: Tensor, with_normal: bool
) -> list[list[Tensor]]:
    # The positions, and the normals if required, as one block of columns for each link.
    rotation, translation = pose_links(levels, joint)
    pos, normal = [], []
    for link, pos_table, normal_table in tables:
        link_rotation = rotation[:, link].reshape(-1, 9)
        pos.append(torch.cat([link_rotation, translation[:, link]], dim=1) @ pos_table)
        if with_normal and normal_table is not None:
            normal.append(link_rotation @ normal_table)
    return [pos, normal] if normal else [pos]
