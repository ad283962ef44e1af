r"""What of the transforms is the same for all frames, and computed once."""

from collections.abc import Sequence
from typing import Any

from torch_geometric_tactile.data import StaticData, apply_transform
from torch_geometric_tactile.data._transform_rules import own_declaration, static_rule
from torch_geometric_tactile.transforms import TactileTransform
from torch_geometric_tactile.transforms._attributes import EDGES

_Names = tuple[str, ...] | None


def apply_once(shared: StaticData, parts: Sequence[Any]) -> tuple[StaticData, list[Any]]:
    r"""Applies those of some transforms whose result is the same for all frames, and returns what
    frames share then, and the other transforms.
    """
    rest: list[Any] = []
    changing, used = {"x", "joint"}, set[str]()  # what differs, and what later parts may not change
    for i, part in enumerate(parts):
        reads, writes = access(part)
        if reads is None or writes is None:
            return shared, [*rest, *parts[i:]]
        if changing.isdisjoint((*reads, *writes)) and used.isdisjoint(writes):
            shared = apply_transform(part, shared)
        else:
            rest.append(part)
            changing.update(writes)
            used.update(reads)
    return shared, rest


def access(part: Any) -> tuple[_Names, _Names]:
    r"""Returns the attributes that a transform reads, and those that it writes; :obj:`None` where
    they are not known.
    """
    if isinstance(part, TactileTransform):
        return own_declaration(part, "reads"), own_declaration(part, "writes")
    rule = static_rule(part)
    if rule.reads is None or own_declaration(part, "supports_static"):
        return None, None
    columns = () if rule.x is None else ("x",)
    writes = (*EDGES, *rule.reads) if rule.writes is None else rule.writes
    added = (*rule.node, *rule.edge, *rule.shared, *columns)
    return rule.reads, tuple(dict.fromkeys((*writes, *added)))


def is_computed_once(part: Any, sample: StaticData) -> bool:
    r"""Tells whether the results of a transform are among what the samples of a data set share."""
    _, writes = access(part)
    if writes is None or "x" in writes:
        return False
    return all(key not in sample or sample.is_shared(key) for key in writes)
