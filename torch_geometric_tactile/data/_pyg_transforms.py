r"""PyG's transforms: what they read and add, and which of them a predictor file may name."""

from collections.abc import Callable
from typing import Any

from torch_geometric import transforms as T

from torch_geometric_tactile.data.static_rule import StaticRule

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
