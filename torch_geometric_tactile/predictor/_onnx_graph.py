r"""A predictor as one module with tensors, for the export to ONNX. The steps of its transforms have
no operations that depend on values.
"""

import copy
from collections.abc import Callable, Sequence
from types import SimpleNamespace
from typing import Any

import torch
from torch import Tensor
from torch.nn import Module

from torch_geometric_tactile._checks import need
from torch_geometric_tactile.data import StaticData, apply_transform, join_frames
from torch_geometric_tactile.data._transform_rules import own_declaration, static_rule
from torch_geometric_tactile.predictor._constant_transforms import attribute_access
from torch_geometric_tactile.predictor.predictor import Predictor
from torch_geometric_tactile.transforms import FillMissing, FittedTransform, TactileTransform
from torch_geometric_tactile.transforms._windows import repeat_frames

_MAX_CHANNELS = 32
_CHUNK_SIZE = 256
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
    r"""The step of a transform that measures sessions. The centre and the scale of the session are
    inputs of the graph.

    Args:
        transform (FittedTransform): The transform.
        measures_windows (bool): Whether it measures windows instead of single frames.

    Raises:
        NotImplementedError: If it measures an attribute other than the readings.
    """

    def __init__(self, transform: FittedTransform, measures_windows: bool) -> None:
        if transform.attr != "x":
            raise NotImplementedError(
                f"{transform!r} cannot be exported: only readings may be measured per session (got "
                f"attr='{transform.attr}')"
            )
        self.part = transform
        self.measures_windows = measures_windows
        self.reads_changed_readings = False  # whether earlier steps change the readings
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
            center = repeat_frames(center, data.num_frames)
            scale = None if scale is None else repeat_frames(scale, data.num_frames)
        # Raw counts are large and vary little: a difference in single precision would lose digits.
        x = (x.double() - center).to(x.dtype)
        data.x = x if scale is None else x / scale
        return data


class SetAttributes:
    r"""A step that sets attributes and columns of readings that are the same for all frames.

    Args:
        before (StaticData): Shared attributes before the transform.
        after (StaticData): Shared attributes after the transform; the readings hold the new
            columns.
        replaces (bool): Whether the columns replace the readings instead of being appended.
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


class OnnxGraph(Module):
    r"""A predictor as one module with tensors. The inputs are raw readings, the readings at rest,
    joint angles and the state of a recurrent model. The outputs are probabilities and the next
    state.

    Args:
        predictor (Predictor): The predictor.
        num_channels (int, optional): Number of channels per taxel, if the predictor does not store
            it.

    Raises:
        NotImplementedError: If a transform cannot be exported.
        ValueError: If the number of channels or joints is unknown.
    """

    def __init__(self, predictor: Predictor, num_channels: int | None = None) -> None:
        super().__init__()
        preparation = predictor.preparation
        self.model = predictor.model
        self.layout = predictor.layout
        self.window = preparation.window
        self._predictor = [predictor]  # in a list: a submodule would store the weights twice
        self._constant = preparation.constant
        varying = {"x", "joint"}
        frame_transforms = preparation.frame_transforms
        sample_transforms = preparation.sample_transforms
        shared = copy.copy(self._constant)
        is_windowed = self.window is not None
        if self.window is not None:
            shared.num_frames = self.window.length
        self._frame_steps, shared = transforms_to_steps(frame_transforms, shared, varying, False)
        self._steps, shared = transforms_to_steps(sample_transforms, shared, varying, is_windowed)
        # The step that is traced, for messages. An export resets attributes of the module itself.
        self._current_step = SimpleNamespace(name="")
        steps = [step for _, step in (*self._frame_steps, *self._steps)]
        rests = [step for step in steps if isinstance(step, RestInput)]
        if len(rests) > 1:
            raise NotImplementedError(
                "only one transform that measures sessions can be exported (got "
                f"{' and '.join(repr(rest.part) for rest in rests)})"
            )
        self.rest = rests[0] if rests else None
        self.num_joints = _count_joints(predictor)
        self.joint_of_frames = is_windowed and any(
            "joint" in (attribute_access(part)[0] or ()) for part in frame_transforms
        )
        self._required: Tensor | None = None
        self.is_stepped = False
        self.num_channels = num_channels or preparation.num_channels or self._find_channels()
        self.is_stepped = self._can_step(sample_transforms)
        self.state = self._initial_state()
        self.eval()
        is_filled = [
            isinstance(part, FillMissing) for part in sample_transforms if _changes_readings(part)
        ]
        if is_filled[-1:] != [True]:
            self._required = _required_readings(self)
            self._required_places = self._required.flatten().nonzero().view(-1)
            self._requires_all = bool(self._required.all())

    @property
    def needs_all_readings(self) -> bool:
        r"""Whether the probabilities are NaN if any reading is missing."""
        return not self.is_stepped and self._required is not None and self._requires_all

    def _can_step(self, sample_transforms: Sequence[Any]) -> bool:
        model, window = self.model, self.window
        if window is None or not hasattr(model, "step") or not hasattr(model, "initial_state"):
            return False
        if not getattr(model, "can_step", True):
            return False
        if not all(is_framewise(part) for part in sample_transforms):
            return False
        is_complete_trial = window.is_trial and window.ragged in ("error", "pad")
        return is_complete_trial or window.length >= getattr(
            model, "receptive_field", window.length + 1
        )

    def _initial_state(self) -> tuple[Tensor, ...]:
        # The last entry counts the frames for which a missing reading still affects the output.
        model: Any = self.model
        return (*model.initial_state(1), torch.zeros(1)) if self.is_stepped else ()

    def _joint_input(self, data: StaticData) -> dict[str, Tensor]:
        return {"joint": data.joint} if "joint" in self._predictor[0].network.modalities else {}

    def _find_channels(self) -> int:
        # Tries each number, because a predictor that was built by hand may not store it.
        accepted_counts = []
        for count in range(1, _MAX_CHANNELS + 1):
            self.num_channels = count
            try:
                with torch.no_grad():
                    self.run_window(self.zero_inputs())
            except Exception:
                continue
            accepted_counts.append(count)
        if len(accepted_counts) != 1:
            raise ValueError(
                "'num_channels' must be given: the predictor does not store the number of channels "
                f"per taxel (of 1 to {_MAX_CHANNELS}, it accepts {accepted_counts or 'none'})"
            )
        return accepted_counts[0]

    @property
    def current_step(self) -> str:
        r"""The name of the transform or model that was traced last."""
        return str(self._current_step.name)

    @property
    def length(self) -> int:
        r"""The number of frames per window; one for a model that reads single frames."""
        return 1 if self.window is None else self.window.length

    def zero_inputs(self) -> dict[str, Tensor]:
        r"""Returns the inputs by name, except the state. All readings and angles are zero."""
        size: tuple[int, ...] = (1, self.layout.num_taxels, self.num_channels)
        if self.window is not None and not self.is_stepped:
            size = (1, self.length, *size[1:])
        inputs = {"tactile": torch.zeros(size)}
        if self.rest is not None:
            shape = self.rest_shape()
            inputs["rest"] = torch.zeros(shape, dtype=torch.double)
            if self.rest.has_scale:
                inputs["rest_scale"] = torch.ones(shape)
        if self.num_joints:
            lead = (self.length,) if self.joint_of_frames and not self.is_stepped else ()
            inputs["joint"] = torch.zeros(*lead, self.num_joints)
        return inputs

    def rest_shape(self) -> tuple[int, ...]:
        r"""Returns the shape of the readings at rest: the shape of the fitted centre, or the shape
        that fitting would give.
        """
        assert self.rest is not None
        part = self.rest.part
        if part.center is not None:
            return tuple(part.center.shape[1:])
        frames = self.length if self.rest.measures_windows and part.per != "signal" else 1
        rows = 1 if part.per == "channel" else self.layout.num_taxels
        return rows, self.num_channels * frames

    @property
    def input_names(self) -> list[str]:
        r"""The names of the inputs, in their order."""
        return [*self.zero_inputs(), *(f"state_{i}" for i in range(len(self.state)))]

    @property
    def outputs_rest_readings(self) -> bool:
        r"""Whether the readings on which the rest is measured are an output, because earlier steps
        change them.
        """
        return self.rest is not None and self.rest.reads_changed_readings

    @property
    def output_names(self) -> list[str]:
        r"""The names of the outputs, in their order."""
        states = [f"next_state_{i}" for i in range(len(self.state))]
        return ["probability", *states, *(["before_rest"] if self.outputs_rest_readings else [])]

    def forward(self, *inputs: Tensor) -> tuple[Tensor, ...]:
        r"""Returns the outputs in the order of :obj:`output_names`."""
        values = dict(zip(self.input_names, inputs, strict=True))
        if self.is_stepped:
            probability, states = self.run_step(values)
        else:
            probability, states = self.run_window(values), ()
        rest_outputs = (
            () if not self.outputs_rest_readings or self.rest is None else (self.rest.readings,)
        )
        return (probability, *states, *rest_outputs)

    def run_window(self, values: dict[str, Tensor]) -> Tensor:
        r"""Returns the probabilities of a frame or window."""
        tactile = values["tactile"]
        frames = tactile if self.window is None else tactile[0]
        data = self._prepare(frames, values)
        self._current_step.name = type(self.model).__name__
        predictor = self._predictor[0]
        probability = predictor.probability(predictor.logits(data))
        return probability + self._missing_to_nan(data, values)

    def _missing_to_nan(self, data: StaticData, values: dict[str, Tensor]) -> Tensor | float:
        # Returns zero, or NaN if a reading or an angle is missing. A product with zeros preserves
        # NaN in every runtime; other operations, such as a maximum, may not.
        parts = []
        if self._required is not None and self._requires_all:
            parts.append(data.x.flatten())
        elif self._required is not None and len(self._required_places):
            parts.append(data.x.flatten().index_select(0, self._required_places))
        if "joint" in values:
            parts.append(values["joint"].flatten())
        products = [part.unsqueeze(0) @ torch.zeros(part.numel(), 1) for part in parts]
        return sum(products[1:], products[0]) if products else 0.0

    def run_step(self, values: dict[str, Tensor]) -> tuple[Tensor, tuple[Tensor, ...]]:
        r"""Returns the probabilities after a frame, and the next state."""
        data = self._prepare(values["tactile"], values)
        self._current_step.name = type(self.model).__name__
        model: Any = self.model
        *state, num_missing_frames = (values[f"state_{i}"] for i in range(len(self.state)))
        logits, next_state = model.step(
            data.x, data.edge_index, tuple(state), **self._joint_input(data)
        )
        probability = self._predictor[0].probability(logits)
        num_missing_frames = (num_missing_frames - 1).clamp(min=0)
        if self._required is not None:
            missing = (data.x.isnan() & self._required).any()
            num_missing_frames = num_missing_frames.masked_fill(
                missing, float(model.receptive_field)
            )
            probability = probability.masked_fill(num_missing_frames > 0, torch.nan)
        if "joint" in values:
            probability = probability + values["joint"].unsqueeze(0) @ torch.zeros(
                self.num_joints, 1
            )
        return probability, (*next_state, num_missing_frames)

    def _prepare(self, frames: Tensor, values: dict[str, Tensor]) -> StaticData:
        if self.rest is not None:
            self.rest.center = values["rest"]
            self.rest.scale = values.get("rest_scale")
        data = copy.copy(self._constant)
        data.x = _infinite_to_nan(frames)
        joint = None if "joint" not in values else _infinite_to_nan(values["joint"])
        if joint is not None:
            rows = joint if joint.dim() == 2 else joint.unsqueeze(0)
            data.joint = rows.expand(len(frames), -1)
        data = self._apply_steps(self._frame_steps, data)
        if self.window is not None:
            x, count = data.x, len(frames)
            if count > 1:
                data = data.index_select(slice(count - 1, None, count))
            data.x = join_frames(x.transpose(0, 1)).unsqueeze(0)
            data.num_frames = count
        return self._apply_steps(self._steps, data)

    def _apply_steps(self, steps: Sequence[tuple[str, Any]], data: StaticData) -> StaticData:
        for name, step in steps:
            self._current_step.name = name
            data = step(data)
        return data


def _infinite_to_nan(values: Tensor) -> Tensor:
    return values.masked_fill(
        values.isinf(), torch.nan
    )  # as `to_float_tensor` does for a predictor


def _count_joints(predictor: Predictor) -> int:
    preparation = predictor.preparation
    if not preparation.needs_joint:
        return 0
    owners = (predictor.model, preparation.hand)
    candidates = [preparation.num_joints, *(getattr(owner, "num_joints", None) for owner in owners)]
    counts = [number for number in candidates if number]
    need(counts, "the predictor must hold 'num_joints' to be exported (got None)")
    return int(counts[0])


@torch.no_grad()
def _required_readings(graph: OnnxGraph) -> Tensor:
    # Marks the readings (N, F) whose absence makes the output NaN. A runtime may drop NaN in a
    # maximum or a recurrent layer and return a number, so the graph adds NaN explicitly.
    inputs = graph.zero_inputs()
    inputs["tactile"] = torch.randn_like(inputs["tactile"])
    data = graph._prepare(inputs["tactile"].flatten(0, -3), inputs)
    rows, features = data.x.shape[1:]
    by_row = torch.eye(rows, dtype=torch.bool).unsqueeze(2).expand(-1, -1, features)
    by_feature = torch.eye(features, dtype=torch.bool).unsqueeze(1).expand(-1, rows, -1)
    is_required = [
        torch.cat([_is_output_missing(graph, data, part) for part in missing.split(_CHUNK_SIZE)])
        for missing in (by_row, by_feature)
    ]
    return is_required[0].unsqueeze(1) & is_required[1]


def _is_output_missing(graph: OnnxGraph, data: StaticData, missing: Tensor) -> Tensor:
    samples = data.index_select(torch.zeros(len(missing), dtype=torch.long))
    samples.x = samples.x.masked_fill(missing, torch.nan)
    if not graph.is_stepped:
        return graph._predictor[0].logits(samples).isnan().any(dim=1)
    model: Any = graph.model
    state = model.initial_state(len(missing))
    logits, _ = model.step(samples.x, samples.edge_index, state, **graph._joint_input(samples))
    is_missing: Tensor = logits.isnan().any(dim=1)
    return is_missing


def _changes_readings(transform: Any) -> bool:
    writes = attribute_access(transform)[1]
    return writes is None or "x" in writes


def is_framewise(transform: Any) -> bool:
    r"""Returns whether a transform of windows treats each frame separately and in the same way."""
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
                f"{transform!r} cannot be exported: it measures sessions but overrides 'forward'"
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
    # A predictor may contain a random training transform without effect, such as zero noise.
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
