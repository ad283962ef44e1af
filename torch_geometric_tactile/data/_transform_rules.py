r"""The attributes that transforms read and add: declarations of transforms, rules for PyG's
transforms, and the names of PyG's transforms that may be read from files.
"""

from collections.abc import Callable
from typing import Any

from torch_geometric import transforms as T

from torch_geometric_tactile._typing import Transform
from torch_geometric_tactile.data._static_rule import StaticRule

_UNKNOWN = StaticRule()
_EDGES = ("edge_index", "edge_attr", "edge_weight")
_Rule = Callable[[Any], StaticRule]


def _edge_attr_rule(*names: str) -> _Rule:
    # Sets 'edge_attr' from the named attributes and the edges.
    return lambda transform: StaticRule((*names, *_EDGES), writes=("edge_attr",))


def _in_place_rule(*names: str) -> _Rule:
    # Replaces the named attributes.
    return lambda transform: StaticRule(names, writes=names)


def _column_rule(*names: str) -> _Rule:
    # Appends columns that depend on the named attributes to 'x', or replaces 'x' by them.
    return lambda transform: StaticRule(
        names, x="append" if getattr(transform, "cat", True) else "replace", writes=()
    )


def _self_loop_rule(transform: Any) -> StaticRule:
    name = transform.attr
    new_attributes = () if name in _EDGES else (name,)
    return StaticRule(("edge_index", name), edge=new_attributes, writes=("edge_index", name))


def _encoding_rule(*names: str) -> _Rule:
    # Adds a node attribute, or columns of 'x'. Without names, the encoding is random.
    def rule(transform: Any) -> StaticRule:
        name = transform.attr_name
        node = (name,) if name else ()
        return StaticRule(names or None, node, x=None if name else "append", writes=())

    return rule


def _rotation_rule(transform: Any) -> StaticRule:
    is_random = transform.max_points > 0  # draws the points that it uses
    return StaticRule(None if is_random else ("pos", "normal"))


# PyG's transforms whose results depend only on the topology and the positions. The rules hold for
# exactly these classes, since a subclass may read other attributes.
RULES: dict[type, _Rule] = {
    T.AddLaplacianEigenvectorPE: _encoding_rule(),  # draws random signs
    T.AddRandomWalkPE: _encoding_rule("edge_index", "edge_weight"),
    T.AddRemainingSelfLoops: _self_loop_rule,
    T.AddSelfLoops: _self_loop_rule,
    T.Cartesian: _edge_attr_rule("pos"),
    T.Center: _in_place_rule("pos"),
    T.Constant: _column_rule(),
    T.Distance: _edge_attr_rule("pos"),
    T.GCNNorm: _in_place_rule("edge_index", "edge_weight"),
    T.LinearTransformation: _in_place_rule("pos"),
    T.LocalCartesian: _edge_attr_rule("pos"),
    T.LocalDegreeProfile: _column_rule("edge_index"),
    T.NormalizeRotation: _rotation_rule,
    T.NormalizeScale: _in_place_rule("pos"),
    T.OneHotDegree: _column_rule("edge_index"),
    T.PointPairFeatures: _edge_attr_rule("pos", "norm"),
    T.Polar: _edge_attr_rule("pos"),
    T.RemoveDuplicatedEdges: _in_place_rule(*_EDGES),
    T.Spherical: _edge_attr_rule("pos"),
    T.TargetIndegree: _edge_attr_rule(),
    T.ToUndirected: _in_place_rule(*_EDGES),
    T.TwoHop: _in_place_rule(*_EDGES),
}
if hasattr(T, "RemoveSelfLoops"):  # not in every supported version of PyG
    RULES[T.RemoveSelfLoops] = _self_loop_rule

# PyG's transforms that a file may name. They are deterministic, need no compiled package, and do
# not change the number of taxels.
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
# Arguments of these transforms that are stored in an attribute with another name.
ATTRIBUTE_NAMES = {"max_value": "max", "key": "keys"}


def static_rule(transform: Transform) -> StaticRule:
    r"""Returns the attributes that a transform reads and adds: its :obj:`static_rule`, or the rule
    for a PyG transform. With the rule for an unknown transform, it is called for each sample.
    """
    declaration = own_declaration(transform, "static_rule")
    if isinstance(declaration, StaticRule):
        return declaration
    rule = RULES.get(type(transform))
    return _UNKNOWN if rule is None else rule(transform)


def own_declaration(transform: Transform, name: str) -> Any:
    r"""Returns the attribute by which a transform declares a property of its :obj:`forward`, or
    :obj:`None` if there is no such declaration.

    A declaration of a parent class is ignored if a subclass overrides :obj:`forward` without
    declaring :obj:`reads`, since the declaration may not apply to the new :obj:`forward`.

    Examples:
        >>> from torch_geometric_tactile.transforms import ZScore
        >>> class Clipped(ZScore):
        ...     def forward(self, data):
        ...         return super().forward(data)
        >>> [own_declaration(transform, "supports_static") for transform in (ZScore(), Clipped())]
        [True, None]
    """
    declares_reads = False
    for namespace in (getattr(transform, "__dict__", {}), *map(vars, type(transform).__mro__)):
        if name in namespace:
            return getattr(transform, name)
        declares_reads = declares_reads or "reads" in namespace
        if ("forward" in namespace or "__call__" in namespace) and not declares_reads:
            return None
    return None


def flat(transform: Any) -> list[Any]:
    r"""Returns the parts of a transform in order, including the parts of nested compositions. A
    subclass of PyG's :class:`Compose` is one part, since it may do more than apply its parts.
    """
    if transform is None:
        return []
    if type(transform) is T.Compose:
        return [part for inner in transform.transforms for part in flat(inner)]
    return [transform]
