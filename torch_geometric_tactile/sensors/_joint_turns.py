r"""The links of a chain as a tree, and the turns of its joints."""

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from torch_geometric_tactile.sensors.joints import Joint

_MOST_JOINTS = 1000


class LinkTree(NamedTuple):
    r"""The links of a chain, the root first, and the joints level by level: those of a level hang
    on links of the level before.
    """

    names: tuple[str, ...]
    levels: list[list[Joint]]


def link_tree(joints: Sequence[Joint]) -> LinkTree:
    r"""Returns the links that joints make up."""
    if len(joints) > _MOST_JOINTS:
        raise ValueError(f"'joints' must be {_MOST_JOINTS} at most (got {len(joints)})")
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
    if len(roots) != 1:
        raise ValueError(f"the links must be one tree, with one root (got roots {roots})")
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


def _cross_matrix(axis: Sequence[float]) -> Tensor:
    x, y, z = axis
    return torch.tensor([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]], dtype=torch.double)


def joint_turns(joint: Joint) -> Tensor:
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
