r"""The links of a hand as a tree, and the constants that its poses are multiplied with: made once
for a hand and a layout.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from torch_geometric_tactile._checks import need
from torch_geometric_tactile.sensors.joints import Joint
from torch_geometric_tactile.sensors.layout import TaxelLayout

_MOST_JOINTS = 1000


class LinkTree(NamedTuple):
    r"""The links of a chain, the root first, and the joints level by level: those of a level hang
    on links of the level before.
    """

    names: tuple[str, ...]
    levels: list[list[Joint]]


def link_tree(joints: Sequence[Joint]) -> LinkTree:
    r"""Returns the links that joints make up."""
    need(len(joints) <= _MOST_JOINTS, f"'joints' must be {_MOST_JOINTS} at most", len(joints))
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
    need(len(roots) == 1, f"the links must be one tree, with one root (got roots {roots})")
    names, levels = [roots[0]], []
    level = names
    while level:
        above = set(level)
        children = [joint for joint in joints if joint.parent in above]
        level = [joint.child for joint in children]
        if children:
            levels.append(children)
            names = names + level
    if len(names) != len(joints) + 1:
        lost = sorted(set(by_child) - set(names))
        raise ValueError(f"the links must be one tree, with one root (got a ring of {lost})")
    return LinkTree(tuple(names), levels)


class Level(NamedTuple):
    r"""The :math:`K` links that hang on the links of the level before, so that their poses are one
    product: where their parents are, which joint moves them, the terms of its rotation
    :math:`(K, 3, 3, 3)` and their origins in the parents' frames :math:`(K, 3)`.
    """

    parent: Tensor
    column: Tensor
    turns: Tensor
    xyz: Tensor


class SmallBatchTables(NamedTuple):
    r"""What poses few frames of a layout with few operations."""

    parents: list[Tensor]  # of the links of each level, where they are in the level before
    column: Tensor  # of each link's joint in the joint vector
    turns: Tensor  # (L - 1, 3, 16), the three terms of each link's matrix below its parent
    link: Tensor  # (N,), of each taxel
    pos: Tensor  # (N, 1, 4)
    normal: Tensor  # (N, 1, 4)


LinkTable = tuple[int, Tensor, Tensor | None]  # a link, and what its pose is multiplied with


def tree_levels(tree: LinkTree, moving: Sequence[Joint]) -> list[Level]:
    r"""Returns the levels of a hand's links."""
    number = {name: i for i, name in enumerate(tree.names)}
    column = {joint.name: i for i, joint in enumerate(moving)}
    return [
        Level(
            torch.tensor([number[joint.parent] for joint in level]),
            # A fixed joint reads the column of zeros behind the joints' own.
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
    # Rodrigues: R = R0 (1 + sin K + (1 - cos) K^2), as a table of its three terms.
    roll, pitch, yaw = joint.rpy
    still = torch.eye(3, dtype=torch.double)
    for angle, axis in ((roll, (1, 0, 0)), (pitch, (0, 1, 0)), (yaw, (0, 0, 1))):
        still = torch.linalg.matrix_exp(angle * _cross_matrix(axis)) @ still
    cross = _cross_matrix(joint.axis or (0.0, 0.0, 0.0))
    return torch.stack([still, still @ cross, still @ cross @ cross])


def pose_links(levels: Sequence[Level], joint: Tensor) -> tuple[Tensor, Tensor]:
    r"""Returns rotation :math:`(..., L, 3, 3)` and translation :math:`(..., L, 3)` of all links.

    Shapes:
        - **joint:** Joint angles in radians :math:`(..., J)`.
    """
    shape = joint.shape[:-1]
    waves = _waves(joint)
    rotation = torch.eye(3).to(joint).expand(*shape, 1, 3, 3)
    translation = joint.new_zeros(*shape, 1, 3)
    for parent, column, turns, xyz in levels:
        turns = turns.to(joint).flatten(-2)
        turn = (waves[..., column, None, :] @ turns).view(*shape, len(column), 3, 3)
        above = rotation[..., parent, :, :]
        origin = (above @ xyz.to(joint).unsqueeze(-1)).squeeze(-1)
        rotation = torch.cat([rotation, above @ turn], dim=-3)
        translation = torch.cat([translation, translation[..., parent, :] + origin], dim=-2)
    return rotation, translation


def _waves(joint: Tensor) -> Tensor:
    angle = torch.nn.functional.pad(joint, (0, 1))
    return torch.stack([torch.ones_like(angle), angle.sin(), 1 - angle.cos()], dim=-1)


def small_batch_tables(
    levels: Sequence[Level], numbers: Mapping[str, int], layout: TaxelLayout, like: Tensor
) -> SmallBatchTables:
    r"""Returns the tables of :func:`pose_small_batch`."""
    assert layout.link is not None
    number = torch.zeros(len(layout.link_names), dtype=torch.long)
    for name, i in numbers.items():
        number[layout.link_names.index(name)] = i
    normal = torch.zeros_like(layout.pos) if layout.normal is None else layout.normal
    parents, column, turns, xyz = zip(*levels, strict=True)
    table = torch.zeros(sum(map(len, parents)), 3, 4, 4, dtype=torch.double)
    table[..., :3, :3] = torch.cat(turns)
    table[:, 0, :3, 3] = torch.cat(xyz)
    table[:, 0, 3, 3] = 1.0
    first = [0, *torch.tensor([len(level) for level in parents]).cumsum(0).tolist()]
    with torch.inference_mode(False):  # or no gradient could pass through them later
        return SmallBatchTables(
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


def pose_small_batch(
    tables: SmallBatchTables, joint: Tensor, with_normal: bool
) -> tuple[Tensor, Tensor | None]:
    r"""Returns positions and normals :math:`(T, N, 3)` of few frames.

    It works with homogeneous matrices and taxel by taxel: more arithmetic than with
    :func:`link_tables`, but fewer operations, whose number decides the delay of a live frame.

    Shapes:
        - **joint:** Joint angles in radians :math:`(T, J)`.
    """
    pose = chain_small_batch(tables, joint).index_select(1, tables.link)[:, :, :3]
    pos = (pose * tables.pos).sum(dim=-1)
    return pos, (pose * tables.normal).sum(dim=-1) if with_normal else None


def chain_small_batch(tables: SmallBatchTables, joint: Tensor) -> Tensor:
    r"""Returns the matrices of all links :math:`(T, L, 4, 4)` in few frames.

    Shapes:
        - **joint:** Joint angles in radians :math:`(T, J)`.
    """
    waves = _waves(joint).index_select(1, tables.column).unsqueeze(2)
    steps = (waves @ tables.turns).unflatten(-1, (4, 4)).squeeze(2)
    root = torch.eye(4, dtype=joint.dtype, device=joint.device)
    poses, start = [root.expand(len(joint), 1, 4, 4)], 0
    for parent in tables.parents:
        step = steps[:, start : start + len(parent)]
        poses.append(poses[-1].index_select(1, parent) @ step if start else step)
        start += len(parent)
    return torch.cat(poses, dim=1)


def link_tables(
    numbers: Mapping[str, int], layout: TaxelLayout, like: Tensor
) -> tuple[list[LinkTable], Tensor | None]:
    r"""Returns a table for each link, and the place of each taxel in their results if these are in
    another order than the taxels.
    """
    assert layout.link is not None
    with torch.inference_mode(False):  # or no gradient could pass through them later
        tables, order = [], []
        for name, i in numbers.items():
            taxels = (layout.link == layout.link_names.index(name)).nonzero().view(-1)
            tables.append((i, *_link_table(layout, taxels, like)))
            order.append(taxels)
        place = torch.cat(order).argsort()
    in_order = torch.equal(place, torch.arange(layout.num_taxels))
    return tables, None if in_order else place


def _link_table(layout: TaxelLayout, taxels: Tensor, like: Tensor) -> tuple[Tensor, Tensor | None]:
    # Position and normal are linear in the link's pose: one matrix serves all frames.
    eye = torch.eye(3).to(like)

    def turned(vectors: Tensor) -> Tensor:
        return torch.einsum("nj,ik->ijnk", vectors[taxels].to(like), eye).reshape(9, -1)

    shift = eye.unsqueeze(1).expand(3, len(taxels), 3).reshape(3, -1)
    normal = None if layout.normal is None else turned(layout.normal)
    return torch.cat([turned(layout.pos), shift]), normal


def pose_tables(
    levels: Sequence[Level],
    tables: Sequence[LinkTable],
    joint: Tensor,
    with_normal: bool,
    chunk: int,
) -> list[Tensor]:
    r"""Returns positions, and normals if they are wanted, of many frames, in the order of the
    tables :math:`(T, 3 N)`.

    Shapes:
        - **joint:** Joint angles in radians :math:`(T, J)`.
    """
    parts = joint.split(chunk)
    if len(parts) == 1 or (torch.is_grad_enabled() and joint.requires_grad):
        return [torch.cat(values, dim=1) for values in _by_link(levels, tables, joint, with_normal)]
    width = sum(pos_table.size(1) for _, pos_table, _ in tables)
    out = [joint.new_empty(len(joint), width) for _ in range(1 + with_normal)]
    targets = zip(*(value.split(chunk) for value in out), strict=True)
    for part, target in zip(parts, targets, strict=True):
        by_link = _by_link(levels, tables, part, with_normal)
        for values, whole in zip(by_link, target, strict=True):
            torch.cat(values, dim=1, out=whole)
    return out


def _by_link(
    levels: Sequence[Level], tables: Sequence[LinkTable], joint: Tensor, with_normal: bool
) -> list[list[Tensor]]:
    rotation, translation = pose_links(levels, joint)
    pos, normal = [], []
    for link, pos_table, normal_table in tables:
        turn = rotation[:, link].reshape(-1, 9)
        pos.append(torch.cat([turn, translation[:, link]], dim=1) @ pos_table)
        if with_normal and normal_table is not None:
            normal.append(turn @ normal_table)
    return [pos, normal] if normal else [pos]
