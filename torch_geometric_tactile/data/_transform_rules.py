r"""What transforms declare, and what is known of those that declare nothing."""

from typing import Any

from torch_geometric import transforms as T

from torch_geometric_tactile._typing import Transform
from torch_geometric_tactile.data._pyg_transforms import RULES
from torch_geometric_tactile.data.static_rule import StaticRule

_UNKNOWN = StaticRule()


def static_rule(transform: Transform) -> StaticRule:
    r"""Returns which attributes a transform reads and adds: its own :obj:`static_rule`, or what is
    known of PyG's transforms.
    """
    own = own_declaration(transform, "static_rule")
    if isinstance(own, StaticRule):
        return own
    known = RULES.get(type(transform))
    return _UNKNOWN if known is None else known(transform)


def own_declaration(transform: Transform, name: str) -> Any:
    r"""Returns an attribute by which a transform declares what its :obj:`forward` does, or
    :obj:`None`. What a parent class declares does not hold for a subclass with its own, unless that
    says what it reads.

    Examples:
        >>> from torch_geometric_tactile.transforms import ZScore
        >>> class Clipped(ZScore):
        ...     def forward(self, data):
        ...         return super().forward(data)
        >>> [own_declaration(transform, "supports_static") for transform in (ZScore(), Clipped())]
        [True, None]
    """
    declares = False
    for space in (getattr(transform, "__dict__", {}), *map(vars, type(transform).__mro__)):
        if name in space:
            return getattr(transform, name)
        declares = declares or "reads" in space
        if ("forward" in space or "__call__" in space) and not declares:
            return None
    return None


def flat(transform: Any) -> list[Any]:
    r"""Returns the parts of a transform in their order. A subclass of PyG's :class:`Compose` is one
    part, since it may do something else than to run its parts.
    """
    if transform is None:
        return []
    if type(transform) is T.Compose:
        return [part for inner in transform.transforms for part in flat(inner)]
    return [transform]
