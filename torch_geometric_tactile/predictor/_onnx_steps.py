r"""Steps of an ONNX graph for transforms, without operations that depend on values."""

import copy
from collections.abc import Callable, Sequence
from typing import Any

import torch
from torch import Tensor

from torch_geometric_tactile.data import StaticData, apply_transform
from torch_geometric_tactile.data._transform_rules import own_declaration, static_rule
from torch_geometric_tactile.predictor._constant_transforms import attribute_access
from torch_geometric_tactile.transforms import FittedTransform, TactileTransform
from torch_geometric_tactile.transforms._windows import repeated

_ALL_ATTRIBUTES = (
    "x",
    "joint",
    "pos",
    "normal",
    "tangent",
    "edge_index",
    "edge_attr",
    "edge_weight",
)
Step = Callable[[StaticData], StaticData]


class RestInput:
    r"""Step of a transform that measures sessions. The centre and scale of the session are inputs
    of the graph.

    Args:
        transform (FittedTransform): The transform.
        measures_windows (bool): Whether it measures windows, not single frames.

    Raises:
        NotImplementedError: If it measures another attribute than the readings.
    """

    def __init__(self, transform: FittedTransform, measures_windows: bool) -> None:
        if transform.attr != "x":
            raise NotImplementedError(
                f"{transform!r} cannot be exported: only readings may be measured by session (got "
                f"attr='{transform.attr}')"
            )
        self.part = transform
        self.measures_windows = measures_windows
        self.reads_changed_readings = False  # whether steps before it change the readings
        self.center: Tensor | None = None
        self.scale: Tensor | None = None
        self.readings: Tensor | None = None

    @property
    def has_scale(self) -> bool:
        r"""Whether the transform also divides by a scale."""
        return not self.part.unit_scale

    def __call__(self, data: StaticData) -> StaticData:
        r"""Returns data with the centre subtracted and divided by the scale."""
        assert self.center is not None
        self.readings = x = data.x
        center, scale = self.center, self.scale
        if self.part.per == "signal":
            center = repeated(center, data.num_frames)
            scale = None if scale is None else repeated(scale, data.num_frames)
        # Raw counts are large and vary little: the difference of single precisions loses digits.
        x = (x.double() - center).to(x.dtype)
        data.x = x if scale is None else x / scale
        return data


class SetAttributes:
    r"""Step that sets attributes and columns of readings that are the same for all frames.

    Args:
        before (StaticData): Shared attributes before the transform.
        after (StaticData): Shared attributes after it; its readings hold the new columns.
        replaces (bool): Whether the columns replace the readings, and are not appended to them.
    """

    def __init__(self, before: StaticData, after: StaticData, replaces: bool) -> None:
        self.replaces = replaces
        old_values, new_values = before.to_dict(), after.to_dict()
        self.removed = [key for key in old_values if key not in new_values]
        self.values = {
            key: value
            for key, value in new_values.items()
            if key != "x" and value is not old_values.get(key)
        }
        self.schema = after
        columns = after.x.size(-1)
        self.columns = after.x if columns else None

    def __call__(self, data: StaticData) -> StaticData:
        r"""Returns data with the attributes and columns."""
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


def is_framewise(transform: Any) -> bool:
    r"""Returns whether a transform of windows treats each frame separately and equally."""
    return isinstance(transform, TactileTransform) and bool(own_declaration(transform, "per_frame"))


def transforms_to_steps(
    transforms: Sequence[Any], constant: StaticData, varying: set[str], is_windowed: bool
) -> tuple[list[tuple[str, Step]], StaticData]:
    r"""Returns the steps of transforms with their names, and the attributes that all frames share
    afterwards. Adds the attributes that differ between frames to :obj:`varying`.
    """
    steps: list[tuple[str, Step]] = []
    for transform in transforms:
        step, constant = _transform_to_step(transform, constant, varying, is_windowed)
        if step is not None:
            steps.append((repr(transform), step))
    return steps, constant


def _transform_to_step(
    transform: Any, constant: StaticData, varying: set[str], is_windowed: bool
) -> tuple[Step | None, StaticData]:
    if isinstance(transform, FittedTransform) and transform.key is not None:
        if own_declaration(transform, "reads") is None:
            raise NotImplementedError(
                f"{transform!r} cannot be exported: it measures sessions and overrides 'forward'"
            )
        rest = RestInput(transform, is_windowed)
        rest.reads_changed_readings = "$x" in varying
        varying.add("$x")
        return rest, constant
    is_ours = isinstance(transform, TactileTransform)
    if is_ours and own_declaration(transform, "is_random"):
        if _is_identity(transform, constant):
            return None, constant
        raise NotImplementedError(
            f"{transform!r} cannot be exported: it draws random numbers; leave it out of the "
            "predictor"
        )
    reads, writes = attribute_access(transform)
    columns = static_rule(transform).x
    if columns is not None and reads is not None and writes is not None and "x" not in reads:
        writes = tuple(key for key in writes if key != "x")  # "$x": see below
    if reads is not None and writes is not None and varying.isdisjoint((*reads, *writes)):
        transformed = apply_transform(transform, constant)
        attributes = SetAttributes(constant, transformed, columns == "replace")
        if transformed.x.size(-1):  # "$x" says that a step has changed the raw readings
            varying.add("$x")
            transformed = copy.copy(transformed)
            transformed.x = constant.x
        return attributes, transformed
    step: Step = (
        transform.graph_step(constant, varying) if is_ours and writes else _sample_step(transform)
    )
    if getattr(step, "is_same_for_all", False):
        return step, step(copy.copy(constant))
    varying.update(_ALL_ATTRIBUTES if writes is None else writes)
    if writes is None or "x" in writes:
        varying.add("$x")
    return step, constant


def _sample_step(transform: Any) -> Step:
    if own_declaration(transform, "supports_static"):
        step: Step = transform
        return step
    return lambda data: apply_transform(transform, data)


def _is_identity(transform: Any, constant: StaticData) -> bool:
    # A predictor may hold a random transform of training without effect, such as noise of zero.
    for seed in range(3):
        data = copy.copy(constant)
        draw = torch.Generator().manual_seed(seed)
        data.x = torch.randn(4, constant.num_nodes, 6, generator=draw)
        data.num_frames = 2
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(seed)
            noisy = copy.deepcopy(transform)(copy.copy(data))
        if not torch.allclose(noisy.x, data.x, rtol=1e-6, atol=1e-6):
            return False
    return True
