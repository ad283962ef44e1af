r"""Transforms and models as plain data, and built of it: their class by its name, their arguments
and their state.

Only classes that :mod:`classes` lists are built. Any other is a user's own: its name, its text
(:obj:`repr`) and its tensors are written, and the object is given again when the file is read.
"""

import copy
import inspect
import json
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.nn import Module
from torch_geometric.transforms import BaseTransform, Compose

from torch_geometric_tactile._checks import need
from torch_geometric_tactile._removed import ENCODER_CLASSES, LAST_READER
from torch_geometric_tactile.data._allocation_limit import AllocationLimit
from torch_geometric_tactile.data._transform_rules import ATTRIBUTE_NAMES, flat
from torch_geometric_tactile.predictor.average_model import AverageModel
from torch_geometric_tactile.predictor.classes import model_classes, transform_classes
from torch_geometric_tactile.predictor.missing_own_error import MissingOwnError
from torch_geometric_tactile.sensors import HandKinematics, TaxelLayout
from torch_geometric_tactile.transforms import FittedTransform


def _describe_own(value: Any) -> dict[str, Any]:
    r"""Returns the name and the text of a user's own transform or model."""
    kind = type(value).__name__
    if inspect.isroutine(value):
        return {"own": kind, "text": value.__qualname__}
    is_told = type(value).__repr__ is not object.__repr__  # which tells an address
    return {"own": kind, "text": repr(value) if is_told else kind}


def _check_not_removed(name: Any) -> None:
    r"""Checks that a class was not removed with the pretrained encoders."""
    need(name not in ENCODER_CLASSES, f"{name} was removed: {LAST_READER}")


def _is_own_average(described: Mapping[str, Any], name: str) -> bool:
    r"""Tells whether a description is that of an average of models of a user's own class."""
    arguments = described.get("arguments")
    members = arguments.get("models") if isinstance(arguments, Mapping) else None
    if described.get("class") != "AverageModel" or not isinstance(members, list):
        return False
    member = members[0].get("$model") if members and isinstance(members[0], Mapping) else None
    return isinstance(member, Mapping) and member.get("own") == name


class Builder:
    r"""Builds transforms and models from what :class:`Describer` returned."""

    def __init__(
        self,
        layout: TaxelLayout | None,
        tensors: Mapping[str, Tensor],
        own: Sequence[Any] | None = None,
    ) -> None:
        self.layout = layout
        self.tensors = tensors
        self._own = [part for transform in own or () for part in flat(transform)]
        self._limit = AllocationLimit(tensors.values())  # of all that is built
        self._is_limited = False
        self._given_model: Module | None = None

    @contextmanager
    def _limited(self) -> Iterator[None]:
        if self._is_limited:  # inside another part
            yield
            return
        self._is_limited = True
        try:
            with self._limit:
                yield
        finally:
            self._is_limited = False

    def transform(self, described: Any) -> Any:
        r"""Returns a transform, with its state."""
        with self._limited():
            return self._transform(described)

    def _transform(self, described: Any) -> Any:
        state = None if "state" not in described else self.value(described["state"])
        if "own" in described:
            transform = self._given(described)
            transform = copy.deepcopy(transform)  # its state is that of the file from now on
        else:
            classes = transform_classes()
            transform = self._object(described, classes, "transform")
            for part in flat(transform):
                if not callable(part):
                    raise ValueError(f"'transforms' must hold transforms (got {part!r:.100})")
        if state is not None:
            if isinstance(transform, FittedTransform):
                _check_state(transform, state)
            transform.load_state_dict(state)
        return transform

    def model(self, described: Any, given: Module | None = None) -> Module:
        r"""Returns a model, with weights that are still to be loaded."""
        is_described = given is None or _is_own_average(described, type(given).__name__)
        self._given_model = given
        with torch.random.fork_rng(devices=[]):  # some layers draw weights when they are copied
            if not is_described:
                return self._copy_of_given(described.get("own", described.get("class")))
            with self._limited():
                return self._built(described)

    def _copy_of_given(self, name: Any) -> Module:
        model = self._given_model
        if model is None:
            _check_not_removed(name)
            raise MissingOwnError(
                f"'model' must be given: the file has the weights of a {name}, which is not built "
                "by name",
                "model",
            )
        need(type(model).__name__ == name, f"'model' must be a {name}", type(model).__name__)
        return copy.deepcopy(model)

    def _built(self, described: Any) -> Module:
        if isinstance(described, Mapping) and "own" in described:
            return self._copy_of_given(described["own"])
        if not isinstance(described, Mapping) or "class" not in described:
            raise ValueError(f"a model must have a class (got {described!r:.80})")
        model: Module = self._object(described, model_classes(), "model")
        return model

    def _given(self, described: Mapping[str, Any]) -> Any:
        for i, transform in enumerate(self._own):
            if all(described.get(key) == value for key, value in _describe_own(transform).items()):
                return self._own.pop(i)
        _check_not_removed(described["own"])
        given = [_describe_own(transform)["text"] for transform in self._own]
        raise MissingOwnError(
            f"'transforms' must hold the transform of your own '{described.get('text')}', which is "
            f"not built by name (got {given})",
            "transforms",
        )

    def _object(self, described: Any, classes: Mapping[str, type], what: str) -> Any:
        name = described.get("class")
        _check_not_removed(name)
        if name not in classes:
            raise ValueError(
                f"there is no {what} '{name}' in this version; known are {', '.join(classes)}"
            )
        arguments = self.value(described["arguments"])
        try:
            return classes[name](**arguments)
        except ValueError:
            raise
        except Exception as error:  # whatever a constructor makes of arguments that it cannot take
            raise ValueError(f"{what} '{name}' does not take its arguments ({error})") from error

    def value(self, value: Any) -> Any:
        r"""Returns an argument or a state."""
        if isinstance(value, list):
            return [self.value(item) for item in value]
        if not isinstance(value, dict):
            return value
        if len(value) == 1:
            (key, item) = next(iter(value.items()))
            if key in _READERS:
                return _READERS[key](self, item)
        return {key: self.value(item) for key, item in value.items()}

    def tensor(self, name: Any) -> Tensor:
        r"""Returns a tensor by its name."""
        need(name in self.tensors, f"it must hold the tensor '{name}' (got none)")
        return self._limit.count_reference(self.tensors[name])


_READERS: dict[str, Callable[[Builder, Any], Any]] = {
    "$float": lambda builder, item: float(item),
    "$tensor": lambda builder, item: builder.tensor(item),
    "$layout": lambda builder, item: (
        builder.layout if item is None else TaxelLayout.from_dict(item)
    ),
    "$kinematics": lambda builder, item: HandKinematics.from_dict(item),
    "$transform": lambda builder, item: builder.transform(item),
    "$model": lambda builder, item: builder._built(item),
}


def load_weights(model: Module, weights: Mapping[str, Tensor]) -> None:
    r"""Loads weights into a model of the same names and shapes."""
    own = {name: tuple(value.shape) for name, value in model.state_dict().items()}
    kinds = {name: _kind(value) for name, value in model.state_dict().items()}
    for name in [*weights, *own]:
        if name not in own or name not in weights:
            where = "file" if name in weights else "model"
            raise ValueError(f"'model' must have the weights of the file ('{name}': {where} only)")
        shape = tuple(weights[name].shape)
        if own[name] != shape:
            raise ValueError(
                f"'model' must have '{name}' of shape {shape}, as the file (got {own[name]})"
            )
        if kinds[name] != _kind(weights[name]):
            raise ValueError(
                f"'{name}' must hold {kinds[name]}, as the model (got {_kind(weights[name])} of "
                f"{weights[name].dtype})"
            )
    precisions = [_precisions(state) for state in (model.state_dict(), weights)]
    if len(precisions[0]) == 1 < len(precisions[1]):
        raise ValueError(
            f"its weights must have one precision, as those of the model (got {precisions[1]})"
        )
    # Takes over the numbers in the precision in which they were saved.
    model.load_state_dict(dict(weights), assign=True)


def _precisions(state: Mapping[str, Tensor]) -> list[str]:
    return sorted({str(value.dtype) for value in state.values() if value.is_floating_point()})


def _kind(tensor: Tensor) -> str:
    if tensor.layout != torch.strided:
        return f"a {tensor.layout} tensor"
    if tensor.is_complex():
        return "complex numbers"
    return "real numbers" if tensor.is_floating_point() else "integers"


def _check_state(transform: FittedTransform, state: Any) -> None:
    if state == {}:  # of one that was not fitted
        return
    found = {key: state.get(key) for key in ("center", "scale", "key_values")}
    center, scale, values = found.values()
    num_dims = 3 if transform.attr == "x" else 1 + (transform.per == "channel")
    if (
        not all(isinstance(value, Tensor) for value in found.values())
        or values.dim() != 1
        or center.dim() < num_dims
        or center.shape[:1] != values.shape
        or scale.shape != center.shape
        or not (center.is_floating_point() and scale.is_floating_point())
    ):
        raise ValueError(f"the state of {transform!r} must be a centre and a scale for each key")


class _NotPlainError(ValueError):
    r"""A value that cannot be written as plain data."""


class Describer:
    r"""Turns transforms and models into JSON values and named tensors."""

    def __init__(self, layout: TaxelLayout | None) -> None:
        self.layout = layout
        self.tensors: dict[str, Tensor] = {}

    def transform(self, transform: Any) -> dict[str, Any]:
        r"""Describes a transform, with its fitted state."""
        kind = type(transform).__name__
        if transform_classes().get(kind) is type(transform):
            mark = len(self.tensors)
            try:
                if isinstance(transform, Compose):  # which may hold any callable
                    parts = [{"$transform": self.transform(part)} for part in transform.transforms]
                    arguments: Any = {"transforms": parts}
                else:
                    arguments = self.value(_arguments_of(transform))
                described = {"class": kind, "arguments": arguments}
                self._check(described, transform)
            except _NotPlainError:
                self._forget(mark)
                described = _describe_own(transform)
        else:
            described = _describe_own(transform)
        if hasattr(transform, "state_dict"):
            described["state"] = self.value(transform.state_dict())
        return described

    def model(self, model: Module) -> dict[str, Any]:
        r"""Describes a model, without its weights."""
        kind = type(model).__name__
        arguments = getattr(model, "init_arguments", None)
        if model_classes().get(kind) is not type(model) or arguments is None:
            return _describe_own(model)
        mark = len(self.tensors)
        try:
            if isinstance(model, AverageModel):
                members = [{"$model": self.model(one)} for one in model.models]
                rest = {key: value for key, value in arguments.items() if key != "models"}
                return {"class": kind, "arguments": {"models": members, **self.value(rest)}}
            return {"class": kind, "arguments": self.value(arguments)}
        except _NotPlainError:  # an encoder of edge features, for example
            self._forget(mark)
            return _describe_own(model)

    def value(self, value: Any) -> Any:
        r"""Describes an argument or a state."""
        if value is None or isinstance(value, bool | int | str):
            return value
        if isinstance(value, float):
            return value if math.isfinite(value) else {"$float": str(value)}
        if isinstance(value, list | tuple):
            return [self.value(item) for item in value]
        if isinstance(value, Mapping):
            if not all(isinstance(key, str) and not key.startswith("$") for key in value):
                raise _NotPlainError(f"the keys of a mapping must be texts (got {list(value)})")
            return {key: self.value(item) for key, item in value.items()}
        if isinstance(value, np.ndarray | np.generic):
            value = torch.as_tensor(value)
        if isinstance(value, Tensor):
            name = f"tensor.{len(self.tensors)}"
            self.tensors[name] = value.detach()
            return {"$tensor": name}
        if isinstance(value, TaxelLayout):
            own = self.layout
            same = own is not None and (value is own or value.to_dict() == own.to_dict())
            return {"$layout": None if same else value.to_dict()}
        if isinstance(value, HandKinematics):
            return {"$kinematics": value.to_dict()}
        if isinstance(value, BaseTransform):
            return {"$transform": self.transform(value)}
        raise _NotPlainError(f"'{type(value).__name__}' is no plain value")

    def _check(self, described: dict[str, Any], transform: Any) -> None:
        # What is built from the description must be the transform again, or its arguments are not
        # the attributes of the same names.
        if isinstance(transform, Compose):  # whose parts were checked one by one
            return
        again = Builder(self.layout, self.tensors).transform(described)
        other = Describer(self.layout)
        arguments = other.value(_arguments_of(again))
        if repr(again) != repr(transform) or not _equal(
            arguments, other.tensors, described["arguments"], self.tensors
        ):
            raise _NotPlainError(f"{transform!r} differs from what its arguments make")

    def _forget(self, mark: int) -> None:
        for name in list(self.tensors)[mark:]:
            del self.tensors[name]


def _arguments_of(transform: Any) -> dict[str, Any]:
    r"""Returns the arguments of a transform's constructor: what its method :obj:`arguments`
    returns, or else its attributes of the same names.
    """
    if hasattr(transform, "arguments"):
        arguments: dict[str, Any] = transform.arguments()
        return arguments
    if type(transform).__init__ is object.__init__:
        return {}
    out = {}
    for name in list(inspect.signature(type(transform).__init__).parameters)[1:]:
        kept = name if hasattr(transform, name) else ATTRIBUTE_NAMES.get(name, name)
        if not hasattr(transform, kept):
            raise _NotPlainError(f"{type(transform).__name__} keeps no '{name}'")
        out[name] = getattr(transform, kept)
    return out


def _equal(
    a: Any, a_tensors: Mapping[str, Tensor], b: Any, b_tensors: Mapping[str, Tensor]
) -> bool:
    # Descriptions with the numbers of their tensors in place of the tensors' names.
    def text(value: Any, tensors: Mapping[str, Tensor]) -> str:
        def filled(item: Any) -> Any:
            if isinstance(item, list):
                return [filled(one) for one in item]
            if isinstance(item, dict):
                if "$tensor" in item:
                    return tensors[item["$tensor"]].tolist()
                return {key: filled(one) for key, one in item.items() if key != "state"}
            return item

        return json.dumps(filled(value))

    return text(a, a_tensors) == text(b, b_tensors)
