r"""What transforms declare, what is known of PyG's, and which of these are read from files."""

from collections.abc import Callable
from typing import Any

from torch_geometric import transforms as T

from torch_geometric_tactile._typing import Transform
from torch_geometric_tactile.data.static_rule import StaticRule

_UNKNOWN = StaticRule()
_EDGES = ("edge_index", "edge_attr", "edge_weight")
_Rule = Callable[[Any], StaticRule]


def _features(*names: str) -> _Rule:
    return lambda transform: StaticRule((*names, *_EDGES), writes=("edge_attr",))


def _places(*names: str) -> _Rule:
    return lambda transform: StaticRule(names, writes=names)


def _columns(*names: str) -> _Rule:
    return lambda transform: StaticRule(
        names, x="append" if getattr(transform, "cat", True) else "replace", writes=()
    )


def _named_edge_attr(transform: Any) -> StaticRule:
    name = transform.attr
    added = () if name in _EDGES else (name,)
    return StaticRule(("edge_index", name), edge=added, writes=("edge_index", name))


def _encoding(*names: str) -> _Rule:
    def rule(transform: Any) -> StaticRule:
        name = transform.attr_name
        node = (name,) if name else ()
        return StaticRule(names or None, node, x=None if name else "append", writes=())

    return rule


def _rotation(transform: Any) -> StaticRule:
    draws = transform.max_points > 0  # which points are used
    return StaticRule(None if draws else ("pos", "normal"))


# PyG's transforms whose result follows from the topology and the positions: these classes only,
# since a subclass may do something else.
RULES: dict[type, _Rule] = {
    T.AddLaplacianEigenvectorPE: _encoding(),  # draws signs
    T.AddRandomWalkPE: _encoding("edge_index", "edge_weight"),
    T.AddRemainingSelfLoops: _named_edge_attr,
    T.AddSelfLoops: _named_edge_attr,
    T.Cartesian: _features("pos"),
    T.Center: _places("pos"),
    T.Constant: _columns(),
    T.Distance: _features("pos"),
    T.GCNNorm: _places("edge_index", "edge_weight"),
    T.LinearTransformation: _places("pos"),
    T.LocalCartesian: _features("pos"),
    T.LocalDegreeProfile: _columns("edge_index"),
    T.NormalizeRotation: _rotation,
    T.NormalizeScale: _places("pos"),
    T.OneHotDegree: _columns("edge_index"),
    T.PointPairFeatures: _features("pos", "norm"),
    T.Polar: _features("pos"),
    T.RemoveDuplicatedEdges: _places(*_EDGES),
    T.Spherical: _features("pos"),
    T.TargetIndegree: _features(),
    T.ToUndirected: _places(*_EDGES),
    T.TwoHop: _places(*_EDGES),
}
if hasattr(T, "RemoveSelfLoops"):  # not in every PyG that we support
    RULES[T.RemoveSelfLoops] = _named_edge_attr

# Deterministic ones that need no compiled package and keep the number of taxels.
IN_FILES = (
    "AddRemainingSelfLoops",
    "AddSelfLoops",
    "Cartesian",
    "Center",
    "Compose",
    "Constant",
    "Distance",
    "LocalCartesian",
    "LocalDegreeProfile",
    "NormalizeFeatures",
    "NormalizeScale",
    "OneHotDegree",
    "RemoveDuplicatedEdges",
    "RemoveSelfLoops",
    "Spherical",
    "TargetIndegree",
    "ToUndirected",
)
# Arguments that they keep by another name.
KEPT_AS = {"max_value": "max", "key": "keys"}


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
