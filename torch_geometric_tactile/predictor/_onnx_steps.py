r"""Which step of a graph a transform becomes, without what depends on values."""

import copy
from collections.abc import Callable, Sequence
from typing import Any

import torch
from torch import Tensor

from torch_geometric_tactile.data import StaticData, apply_transform
from torch_geometric_tactile.data._transform_rules import own_declaration, static_rule
from torch_geometric_tactile.predictor._computed_once import access
from torch_geometric_tactile.transforms import FittedTransform, TactileTransform
from torch_geometric_tactile.transforms._windows import repeat_frames

_ALL = ("x", "joint", "pos", "normal", "tangent", "edge_index", "edge_attr", "edge_weight")
Step = Callable[[StaticData], StaticData]


class GivenRest:
    r"""A transform that measures sessions, with what it measured as an input of the graph."""

    def __init__(self, part: FittedTransform, of_windows: bool) -> None:
        if part.attr != "x":
            raise NotImplementedError(
                f"{part!r} cannot be exported: only readings may be measured by session (got "
                f"attr='{part.attr}')"
            )
        self.part = part
        self.of_windows = of_windows
        self.reads_changed = False  # whether steps before it change the readings
        self.center: Tensor | None = None
        self.scale: Tensor | None = None
        self.seen: Tensor | None = None

    @property
    def has_scale(self) -> bool:
        r"""Whether it divides by a scale as well."""
        return not self.part.unit_scale

    def __call__(self, data: StaticData) -> StaticData:
        r"""Subtracts and divides."""
        assert self.center is not None
        self.seen = x = data.x
        center, scale = self.center, self.scale
        if self.part.per == "signal":
            center = repeat_frames(center, data.num_frames)
            scale = None if scale is None else repeat_frames(scale, data.num_frames)
        # Raw counts are large and vary little.
        x = (x.double() - center).to(x.dtype)
        data.x = x if scale is None else x / scale
        return data


class GivenAttributes:
    r"""Attributes that are the same for all frames, and columns of the readings."""

    def __init__(self, before: StaticData, after: StaticData, replaces: bool) -> None:
        self.replaces = replaces
        old, new = before.to_dict(), after.to_dict()
        self.removed = [key for key in old if key not in new]
        self.values = {
            key: value for key, value in new.items() if key != "x" and value is not old.get(key)
        }
        self.schema = after
        columns = after.x.size(-1)
        self.columns = after.x if columns else None

    def __call__(self, data: StaticData) -> StaticData:
        r"""Applies it."""
        schema: Any = self.schema.schema
        data = data.declare(**schema)
        for key in self.removed:
            if key in data:
                del data[key]
        for key in sorted(self.values, key=lambda key: key != "edge_index"):
            data[key] = self.values[key]
        if self.columns is not None:
            columns = self.columns.to(data.x).expand(data.x.size(0), -1, -1)
            data.x = columns if self.replaces else torch.cat([data.x, columns], dim=-1)
        return data


def is_framewise(part: Any) -> bool:
    r"""Tells whether a transform of windows does the same to each frame by itself."""
    return isinstance(part, TactileTransform) and bool(own_declaration(part, "per_frame"))


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
        if own_declaration(part, "reads") is None:
            raise NotImplementedError(
                f"{part!r} cannot be exported: it measures sessions and has a 'forward' of its own"
            )
        rest = GivenRest(part, of_windows)
        rest.reads_changed = "$x" in changing
        changing.add("$x")
        return rest, known
    is_ours = isinstance(part, TactileTransform)
    if is_ours and own_declaration(part, "is_random"):
        if _is_identity(part, known):
            return None, known
        raise NotImplementedError(
            f"{part!r} cannot be exported: it draws random numbers; leave it out of the predictor"
        )
    reads, writes = access(part)
    columns = static_rule(part).x
    if columns is not None and reads is not None and writes is not None and "x" not in reads:
        writes = tuple(key for key in writes if key != "x")  # columns of readings are set apart
    if reads is not None and writes is not None and changing.isdisjoint((*reads, *writes)):
        after = apply_transform(part, known)
        given = GivenAttributes(known, after, columns == "replace")
        if after.x.size(-1):
            changing.add("$x")
            after = copy.copy(after)
            after.x = known.x
        return given, after
    step: Step = part.graph_step(known, changing) if is_ours and writes else _per_sample(part)
    if getattr(step, "is_same_for_all", False):
        return step, step(copy.copy(known))
    changing.update(_ALL if writes is None else writes)
    if writes is None or "x" in writes:
        changing.add("$x")
    return step, known


def _per_sample(part: Any) -> Step:
    if own_declaration(part, "supports_static"):
        step: Step = part
        return step
    return lambda data: apply_transform(part, data)


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
