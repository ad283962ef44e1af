r"""Which step of a graph a transform becomes, without what depends on values."""

import copy
from collections.abc import Sequence
from typing import Any

import torch

from torch_geometric_tactile import transforms as T
from torch_geometric_tactile.data import StaticData, apply_transform
from torch_geometric_tactile.data.apply_transform import own_declaration, static_rule
from torch_geometric_tactile.predictor._onnx_steps import (
    Dropped,
    GivenRest,
    Posed,
    Resampled,
    Scaled,
    Segmented,
    Set,
    Step,
)
from torch_geometric_tactile.predictor._settling import access, shifts_and_scales
from torch_geometric_tactile.transforms import FittedTransform

# What they do to a frame of a window does not depend on the others.
_FRAMEWISE = (
    T.AbsoluteMorphology,
    T.CommonMode,
    T.DropPatches,
    T.DropTaxels,
    T.FillMissing,
    T.GeometricEdgeAttr,
    T.KNNGraph,
    T.SectorGraph,
    T.SelectChannels,
    T.TaxelPose,
    T.TopologicalSegmentation,
)
_RANDOM = (
    T.DropPatches,
    T.DropTaxels,
    T.RandomContrast,
    T.RandomGain,
    T.RandomInversion,
    T.RandomMirror,
    T.RandomNoise,
    T.RandomOffset,
    T.RandomShift,
    T.RandomTimeShift,
)
_ALL = ("x", "joint", "pos", "normal", "tangent", "edge_index", "edge_attr", "edge_weight")


def is_framewise(part: Any) -> bool:
    r"""Tells whether a transform of windows does the same to each frame by itself."""
    if isinstance(part, FittedTransform) and shifts_and_scales(part):
        return part.attr != "x" or part.per == "signal"
    return type(part) in _FRAMEWISE


def lowered(
    parts: Sequence[Any], known: StaticData, changing: set[str], of_windows: bool
) -> tuple[list[tuple[str, Step]], StaticData]:
    r"""Returns steps with the names of their transforms, and what is known after them."""
    steps: list[tuple[str, Step]] = []
    for part in parts:
        step, known = _lowered(part, known, changing, of_windows)
        if step is not None:
            steps.append((repr(part), step))
    return steps, known


def _lowered(
    part: Any, known: StaticData, changing: set[str], of_windows: bool
) -> tuple[Step | None, StaticData]:
    if isinstance(part, FittedTransform) and part.key is not None:
        if not shifts_and_scales(part):
            raise NotImplementedError(
                f"{part!r} cannot be exported: it measures sessions and has a 'forward' of its own"
            )
        rest = GivenRest(part, of_windows)
        rest.reads_changed = "$x" in changing
        changing.add("$x")
        return rest, known
    if type(part) in _RANDOM and _draws(part):
        if _is_identity(part, known):
            return None, known
        raise NotImplementedError(
            f"{part!r} cannot be exported: it draws random numbers; leave it out of the predictor"
        )
    if type(part) is T.DropTaxels:
        changing.add("$x")
        return Dropped(part, known), known
    if type(part) in (T.ZScore, T.Normalize) and part.attr in changing:
        changing.add("$x" if part.attr == "x" else part.attr)
        return Scaled(part), known
    if type(part) is T.TaxelPose:
        changing.update(("pos", "normal", "tangent"))
        return Posed(part), known
    if isinstance(part, T.ContactCrop):
        raise NotImplementedError(
            f"{part!r} cannot be exported: the length of its windows depends on the readings"
        )
    if type(part) is T.Resample:
        changing.add("$x")
        return Resampled(part), known
    if type(part) is T.TopologicalSegmentation and "edge_index" not in changing:
        step = Segmented(part, known)
        return step, step(copy.copy(known))
    reads, writes = _access(part)
    if reads is not None and writes is not None and changing.isdisjoint((*reads, *writes)):
        after = apply_transform(part, known)
        blank = after.x.size(-1)
        step_set = Set(known, after, static_rule(part).x == "replace")
        if blank:
            changing.add("$x")
            after = copy.copy(after)
            after.x = known.x
        return step_set, after
    if writes is None:
        changing.update(_ALL)
        changing.add("$x")
    else:
        changing.update(writes)
        if "x" in writes:
            changing.add("$x")
    if own_declaration(part, "supports_static"):
        return part, known
    return _per_sample(part), known


def _access(part: Any) -> tuple[tuple[str, ...] | None, tuple[str, ...] | None]:
    reads, writes = access(part)
    if reads is not None or own_declaration(part, "supports_static"):
        return reads, writes
    rule = static_rule(part)
    if rule.reads is None or rule == type(rule)():
        return None, None
    added = (*rule.node, *rule.edge, *rule.shared, "edge_index", "edge_attr", "edge_weight")
    # Columns of readings are set apart; positions, which some change, are what they read.
    return rule.reads, tuple(dict.fromkeys((*added, *rule.reads)))


def _per_sample(part: Any) -> Step:
    def step(data: StaticData) -> StaticData:
        return apply_transform(part, data)

    return step


def _draws(part: Any) -> bool:
    return type(part) not in (T.DropPatches, T.DropTaxels) or part.p is not None


def _is_identity(part: Any, known: StaticData) -> bool:
    # Some are kept from training with nothing left to draw, such as noise of zero.
    for seed in range(3):
        data = copy.copy(known)
        draw = torch.Generator().manual_seed(seed)
        data.x = torch.randn(4, known.num_nodes, 6, generator=draw)
        data.num_frames = 2
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(seed)
            after = copy.deepcopy(part)(copy.copy(data))
        if not torch.allclose(after.x, data.x, rtol=1e-6, atol=1e-6):
            return False
    return True
