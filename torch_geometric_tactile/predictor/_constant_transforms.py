r"""Transforms whose output is the same for all frames, such as a graph of the taxels. They are
applied once, not for each frame.
"""

from collections.abc import Sequence
from typing import Any

from torch_geometric_tactile.data import StaticData, apply_transform
from torch_geometric_tactile.data._transform_rules import own_declaration, static_rule
from torch_geometric_tactile.transforms import TactileTransform
from torch_geometric_tactile.transforms._attributes import EDGES

_Names = tuple[str, ...] | None


def apply_constant_transforms(
    shared: StaticData, transforms: Sequence[Any]
) -> tuple[StaticData, list[Any]]:
    r"""Applies the transforms whose output is the same for all frames. Returns the attributes that
    all frames share afterwards, and the transforms that remain to be applied to each frame.
    """
    per_frame: list[Any] = []
    varying, used = {"x", "joint"}, set[str]()
    for i, transform in enumerate(transforms):
        reads, writes = attribute_access(transform)
        if reads is None or writes is None:
            return shared, [*per_frame, *transforms[i:]]
        # Also checks that no earlier per-frame transform reads an attribute that this transform
        # writes. The earlier transform would otherwise see the new values.
        if varying.isdisjoint((*reads, *writes)) and used.isdisjoint(writes):
            shared = apply_transform(transform, shared)
        else:
            per_frame.append(transform)
            varying.update(writes)
            used.update(reads)
    return shared, per_frame


def attribute_access(transform: Any) -> tuple[_Names, _Names]:
    r"""Returns the names of the attributes that a transform reads, and the names of the attributes
    that it writes. Either is :obj:`None` if unknown.
    """
    if isinstance(transform, TactileTransform):
        return own_declaration(transform, "reads"), own_declaration(transform, "writes")
    rule = static_rule(transform)
    if rule.reads is None or own_declaration(transform, "supports_static"):
        return None, None
    columns = () if rule.x is None else ("x",)
    writes = (*EDGES, *rule.reads) if rule.writes is None else rule.writes
    added = (*rule.node, *rule.edge, *rule.shared, *columns)
    return rule.reads, tuple(dict.fromkeys((*writes, *added)))


def is_precomputed(transform: Any, sample: StaticData) -> bool:
    r"""Returns whether the samples of a data set share all attributes that a transform writes. The
    transform then need not be applied again.
    """
    _, writes = attribute_access(transform)
    if writes is None or "x" in writes:
        return False
    return all(key not in sample or sample.is_shared(key) for key in writes)
