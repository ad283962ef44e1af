r"""What of the transforms is the same for all frames, and computed once."""

from collections.abc import Sequence
from typing import Any

from torch_geometric.transforms import AddSelfLoops, Cartesian, Distance, ToUndirected

from torch_geometric_tactile import transforms as T
from torch_geometric_tactile.data import StaticData, apply_transform
from torch_geometric_tactile.transforms import FittedTransform

_EDGES = ("edge_index", "edge_attr", "edge_weight")
_FRAMES = ("num_frames", "valid_frames")
_GEOMETRY = ("pos", "edge_index", "edge_attr"), ("edge_attr",)
# Which attributes these transforms read and write. If all that a transform reads is the same for
# every frame, its result is computed once. A transform that is not listed is applied to every
# frame, and so is everything after it.
_ACCESS: dict[type, tuple[tuple[str, ...], tuple[str, ...]]] = {
    T.AbsoluteMorphology: (("pos",), ("absolute",)),
    T.CommonMode: (("x",), ("x",)),
    T.ContactCrop: (("x", *_FRAMES), ("x", "valid_frames", "contact_frame")),
    T.DropPatches: (("x", "dropped"), ("x", "dropped")),
    T.DropTaxels: (("x", "dropped"), ("x", "dropped")),
    T.FillMissing: (("x", "missing", *_FRAMES), ("x", "missing")),
    T.GeometricEdgeAttr: _GEOMETRY,
    T.KNNGraph: (("pos", *_EDGES), _EDGES),
    T.Resample: (("x", *_FRAMES), ("x", *_FRAMES)),
    T.SelectChannels: (("x", *_FRAMES), ("x",)),
    T.SectorGraph: ((), (*_EDGES, "edge_sector", "edge_type", "edge_is_within")),
    T.RandomContrast: (("x",), ("x",)),
    T.RandomInversion: (("x",), ("x",)),
    T.RandomGain: (("x", *_FRAMES), ("x",)),
    T.RandomMirror: (("x", *_FRAMES), ("x",)),
    T.RandomNoise: (("x",), ("x",)),
    T.RandomOffset: (("x", *_FRAMES), ("x",)),
    T.RandomShift: (("x",), ("x",)),
    T.RandomTimeShift: (("x", *_FRAMES), ("x",)),
    T.TaxelPose: (("x", "joint"), ("pos", "normal", "tangent")),
    T.TopologicalSegmentation: (
        (*_EDGES, "edge_is_within"),
        (*_EDGES, "segment_batch", "edge_is_within"),
    ),
    Cartesian: _GEOMETRY,
    Distance: _GEOMETRY,
    AddSelfLoops: (_EDGES, _EDGES),
    ToUndirected: (_EDGES, _EDGES),
}


def settle(shared: StaticData, parts: Sequence[Any]) -> tuple[StaticData, list[Any]]:
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


def access(part: Any) -> tuple[tuple[str, ...] | None, tuple[str, ...] | None]:
    r"""Returns the attributes that a transform reads, and those that it writes; :obj:`None` where
    they are not known.
    """
    if shifts_and_scales(part):
        frames = _FRAMES if part.per == "signal" else ()
        return (part.attr, *((part.key, "x") if part.key else ()), *frames), (part.attr,)
    reads, writes = _ACCESS.get(type(part), (None, None))
    if type(part) is T.TaxelForce:
        return ("x", "tangent", "normal"), (part.out,)
    if type(part) is T.AbsoluteMorphology and part.cat:
        return ("pos", "x"), ("x",)
    return reads, writes


def shifts_and_scales(part: Any) -> bool:
    r"""Tells whether a transform does what :class:`FittedTransform` does; a subclass with its own
    :obj:`forward` may do anything.
    """
    return isinstance(part, FittedTransform) and type(part).forward is FittedTransform.forward


def is_settled(part: Any, sample: StaticData) -> bool:
    r"""Tells whether the results of a transform are among what the samples of a data set share."""
    _, writes = access(part)
    if writes is None or "x" in writes:
        return False
    return all(key not in sample or sample.is_shared(key) for key in writes)
