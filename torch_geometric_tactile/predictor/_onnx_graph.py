r"""All that a reading goes through as one module, to be exported."""

import copy
from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any

import torch
from torch import Tensor
from torch.nn import Module

from torch_geometric_tactile._checks import need
from torch_geometric_tactile.data import StaticData, join_frames
from torch_geometric_tactile.predictor._computed_once import access
from torch_geometric_tactile.predictor._onnx_steps import GivenRest, is_framewise, lowered
from torch_geometric_tactile.predictor.predictor import Predictor
from torch_geometric_tactile.transforms import FillMissing

_MOST_CHANNELS = 32
_CHUNK = 256


class OnnxGraph(Module):
    r"""A predictor as one module of tensors: raw readings, the rest, joint angles and the state of
    a recurrent model in, probabilities and the next state out.
    """

    def __init__(self, predictor: Predictor, num_channels: int | None = None) -> None:
        super().__init__()
        preparation = predictor.preparation
        self.model = predictor.model
        self.layout = predictor.layout
        self.window = preparation.window
        self._predictor = [predictor]  # no submodule of the weights a second time
        self._constant = preparation.constant
        changing = {"x", "joint"}
        frame_parts = preparation.frame_parts
        window_parts = preparation.last_parts
        known = copy.copy(self._constant)
        is_windowed = self.window is not None
        if self.window is not None:
            known.num_frames = self.window.length
        self._frame_steps, known = lowered(frame_parts, known, changing, False)
        self._steps, known = lowered(window_parts, known, changing, is_windowed)
        # What is traced, for messages; no attribute of the module, which an export sets back.
        self._at = SimpleNamespace(name="")
        steps = [step for _, step in (*self._frame_steps, *self._steps)]
        rests = [step for step in steps if isinstance(step, GivenRest)]
        if len(rests) > 1:
            raise NotImplementedError(
                "only one transform that measures sessions can be exported (got "
                f"{' and '.join(repr(rest.part) for rest in rests)})"
            )
        self.rest = rests[0] if rests else None
        self.num_joints = _count_joints(predictor)
        self.joint_of_frames = is_windowed and any(
            "joint" in (access(part)[0] or ()) for part in frame_parts
        )
        self._seen: Tensor | None = None
        self.is_stepped = False
        self.num_channels = num_channels or preparation.num_channels or self._find_channels()
        self.is_stepped = self._may_step(window_parts)
        self.state = self._initial_state()
        self.eval()
        is_filled = [isinstance(part, FillMissing) for part in window_parts if _changes(part)]
        if is_filled[-1:] != [True]:
            self._seen = _which_are_seen(self)
            self._seen_places = self._seen.flatten().nonzero().view(-1)
            self._sees_all = bool(self._seen.all())

    @property
    def needs_all_readings(self) -> bool:
        r"""Whether the answer is NaN if any reading is missing, whatever the layers do with it."""
        return not self.is_stepped and self._seen is not None and self._sees_all

    def _may_step(self, window_parts: Sequence[Any]) -> bool:
        model, window = self.model, self.window
        if window is None or not hasattr(model, "step") or not hasattr(model, "initial_state"):
            return False
        if not getattr(model, "can_step", True):
            return False
        if not all(is_framewise(part) for part in window_parts):
            return False
        whole = window.is_trial and window.ragged in ("error", "pad")
        return whole or window.length >= getattr(model, "receptive_field", window.length + 1)

    def _initial_state(self) -> tuple[Tensor, ...]:
        # That of the model, and for how many frames a missing reading still counts.
        model: Any = self.model
        return (*model.initial_state(1), torch.zeros(1)) if self.is_stepped else ()

    def _joint(self, data: StaticData) -> dict[str, Tensor]:
        return {"joint": data.joint} if "joint" in self._predictor[0].network.modalities else {}

    def _find_channels(self) -> int:
        # By trying: a predictor that was built by hand need not say.
        fitting = []
        for count in range(1, _MOST_CHANNELS + 1):
            self.num_channels = count
            try:
                with torch.no_grad():
                    self.run_window(self.blank())
            except Exception:
                continue
            fitting.append(count)
        if len(fitting) != 1:
            raise ValueError(
                "'num_channels' must be given: the predictor does not say how many channels a "
                f"taxel has (it takes {fitting or 'none'} of 1 to {_MOST_CHANNELS})"
            )
        return fitting[0]

    @property
    def at(self) -> str:
        r"""The transform or model that was traced last."""
        return str(self._at.name)

    @property
    def length(self) -> int:
        r"""Number of frames of a window, one for a model of single frames."""
        return 1 if self.window is None else self.window.length

    def blank(self) -> dict[str, Tensor]:
        r"""Returns inputs of zeros, by name, without the state."""
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
        r"""Returns the shape of the rest: that of what was fitted, if it was."""
        assert self.rest is not None
        part = self.rest.part
        if part.center is not None:
            return tuple(part.center.shape[1:])
        frames = self.length if self.rest.of_windows and part.per != "signal" else 1
        rows = 1 if part.per == "channel" else self.layout.num_taxels
        return rows, self.num_channels * frames

    @property
    def input_names(self) -> list[str]:
        r"""The names of the inputs, in their order."""
        return [*self.blank(), *(f"state_{i}" for i in range(len(self.state)))]

    @property
    def shows_rest(self) -> bool:
        r"""Whether what the rest is measured on is an output: readings that steps have changed."""
        return self.rest is not None and self.rest.reads_changed

    @property
    def output_names(self) -> list[str]:
        r"""The names of the outputs, in their order."""
        states = [f"next_state_{i}" for i in range(len(self.state))]
        return ["probability", *states, *(["before_rest"] if self.shows_rest else [])]

    def forward(self, *inputs: Tensor) -> tuple[Tensor, ...]:
        r"""Returns the outputs of :obj:`output_names`."""
        given = dict(zip(self.input_names, inputs, strict=True))
        if self.is_stepped:
            probability, states = self.run_step(given)
        else:
            probability, states = self.run_window(given), ()
        seen = () if not self.shows_rest or self.rest is None else (self.rest.seen,)
        return (probability, *states, *seen)

    def run_window(self, given: dict[str, Tensor]) -> Tensor:
        r"""Returns the probabilities of a frame or window."""
        tactile = given["tactile"]
        frames = tactile if self.window is None else tactile[0]
        data = self._prepared(frames, given)
        self._at.name = type(self.model).__name__
        predictor = self._predictor[0]
        probability = predictor.probability(predictor.logits(data))
        return probability + self._missing(data, given)

    def _missing(self, data: StaticData, given: dict[str, Tensor]) -> Tensor | float:
        # Zero, or NaN if a reading or an angle is missing: what is missing stays so in a product.
        parts = []
        if self._seen is not None and self._sees_all:
            parts.append(data.x.flatten())
        elif self._seen is not None and len(self._seen_places):
            parts.append(data.x.flatten().index_select(0, self._seen_places))
        if "joint" in given:
            parts.append(given["joint"].flatten())
        products = [part.unsqueeze(0) @ torch.zeros(part.numel(), 1) for part in parts]
        return sum(products[1:], products[0]) if products else 0.0

    def run_step(self, given: dict[str, Tensor]) -> tuple[Tensor, tuple[Tensor, ...]]:
        r"""Returns the probabilities after a frame, and the state."""
        data = self._prepared(given["tactile"], given)
        self._at.name = type(self.model).__name__
        model: Any = self.model
        *state, left = (given[f"state_{i}"] for i in range(len(self.state)))
        logits, after = model.step(data.x, data.edge_index, tuple(state), **self._joint(data))
        probability = self._predictor[0].probability(logits)
        left = (left - 1).clamp(min=0)
        if self._seen is not None:
            missing = (data.x.isnan() & self._seen).any()
            left = left.masked_fill(missing, float(model.receptive_field))
            probability = probability.masked_fill(left > 0, torch.nan)
        if "joint" in given:
            probability = probability + given["joint"].unsqueeze(0) @ torch.zeros(
                self.num_joints, 1
            )
        return probability, (*after, left)

    def _prepared(self, frames: Tensor, given: dict[str, Tensor]) -> StaticData:
        if self.rest is not None:
            self.rest.center = given["rest"]
            self.rest.scale = given.get("rest_scale")
        data = copy.copy(self._constant)
        data.x = _finite(frames)
        joint = None if "joint" not in given else _finite(given["joint"])
        if joint is not None:
            rows = joint if joint.dim() == 2 else joint.unsqueeze(0)
            data.joint = rows.expand(len(frames), -1)
        data = self._applied(self._frame_steps, data)
        if self.window is not None:
            x, count = data.x, len(frames)
            if count > 1:
                data = data.index_select(slice(count - 1, None, count))
            data.x = join_frames(x.transpose(0, 1)).unsqueeze(0)
            data.num_frames = count
        return self._applied(self._steps, data)

    def _applied(self, steps: Sequence[tuple[str, Any]], data: StaticData) -> StaticData:
        for name, step in steps:
            self._at.name = name
            data = step(data)
        return data


def _finite(values: Tensor) -> Tensor:
    return values.masked_fill(values.isinf(), torch.nan)  # as a predictor takes them


def _count_joints(predictor: Predictor) -> int:
    preparation = predictor.preparation
    if not preparation.needs_joint:
        return 0
    counting = (predictor.model, preparation.hand)
    known = [preparation.num_joints, *(getattr(one, "num_joints", None) for one in counting)]
    found = [number for number in known if number]
    need(found, "the predictor must know 'num_joints' to be exported (got None)")
    return int(found[0])


@torch.no_grad()
def _which_are_seen(graph: OnnxGraph) -> Tensor:
    # The readings (N, F) without which there is no answer. Of a runtime, a maximum or a
    # recurrent layer may lose what is missing, and go on with a number.
    given = graph.blank()
    given["tactile"] = torch.randn_like(given["tactile"])
    data = graph._prepared(given["tactile"].flatten(0, -3), given)
    rows, features = data.x.shape[1:]
    by_row = torch.eye(rows, dtype=torch.bool).unsqueeze(2).expand(-1, -1, features)
    by_feature = torch.eye(features, dtype=torch.bool).unsqueeze(1).expand(-1, rows, -1)
    lost = [
        torch.cat([_is_lost(graph, data, part) for part in missing.split(_CHUNK)])
        for missing in (by_row, by_feature)
    ]
    return lost[0].unsqueeze(1) & lost[1]


def _is_lost(graph: OnnxGraph, data: StaticData, missing: Tensor) -> Tensor:
    many = data.index_select(torch.zeros(len(missing), dtype=torch.long))
    many.x = many.x.masked_fill(missing, torch.nan)
    if not graph.is_stepped:
        return graph._predictor[0].logits(many).isnan().any(dim=1)
    model: Any = graph.model
    state = model.initial_state(len(missing))
    logits, _ = model.step(many.x, many.edge_index, state, **graph._joint(many))
    lost: Tensor = logits.isnan().any(dim=1)
    return lost


def _changes(part: Any) -> bool:
    writes = access(part)[1]
    return writes is None or "x" in writes
