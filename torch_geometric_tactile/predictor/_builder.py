r"""Transforms and models from plain data. Only classes that :mod:`classes` lists are built."""

import copy
import inspect
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import torch
from torch import Tensor
from torch.nn import Module

from torch_geometric_tactile.data._allocation_limit import AllocationLimit
from torch_geometric_tactile.data._transform_rules import flat
from torch_geometric_tactile.predictor.classes import model_classes, transform_classes
from torch_geometric_tactile.predictor.missing_own_error import MissingOwnError
from torch_geometric_tactile.sensors import HandKinematics, TaxelLayout
from torch_geometric_tactile.transforms import FittedTransform


def describe_own(value: Any) -> dict[str, Any]:
    r"""Returns the name and the text of a user's own transform or model."""
    kind = type(value).__name__
    if inspect.isroutine(value):
        return {"own": kind, "text": value.__qualname__}
    is_told = type(value).__repr__ is not object.__repr__  # which tells an address
    return {"own": kind, "text": repr(value) if is_told else kind}


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

    def transform(self, described: Any) -> Any:
        r"""Returns a transform, with its state."""
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
        if given is not None:
            name = described.get("own", described.get("class"))
            if type(given).__name__ != name:
                raise ValueError(f"'model' must be a {name} (got {type(given).__name__})")
            with torch.random.fork_rng(devices=[]):  # some layers draw weights when they are copied
                return copy.deepcopy(given)
        if "own" in described:
            raise MissingOwnError(
                f"'model' must be given: the file has the weights of a {described['own']}, which "
                "is not built by name",
                "model",
            )
        with torch.random.fork_rng(devices=[]), AllocationLimit(self.tensors.values()):
            model: Module = self._object(described, model_classes(), "model")
        return model

    def _given(self, described: Mapping[str, Any]) -> Any:
        for i, transform in enumerate(self._own):
            if all(described.get(key) == value for key, value in describe_own(transform).items()):
                return self._own.pop(i)
        given = [describe_own(transform)["text"] for transform in self._own]
        raise MissingOwnError(
            f"'transforms' must hold the transform of your own '{described.get('text')}', which is "
            f"not built by name (got {given})",
            "transforms",
        )

    def _object(self, described: Any, classes: Mapping[str, type], what: str) -> Any:
        name = described.get("class")
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
        if name not in self.tensors:
            raise ValueError(f"it must hold the tensor '{name}' (got none)")
        return self.tensors[name]


_READERS: dict[str, Callable[[Builder, Any], Any]] = {
    "$float": lambda builder, item: float(item),
    "$tensor": lambda builder, item: builder.tensor(item),
    "$layout": lambda builder, item: (
        builder.layout if item is None else TaxelLayout.from_dict(item)
    ),
    "$kinematics": lambda builder, item: HandKinematics.from_dict(item),
    "$transform": lambda builder, item: builder.transform(item),
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
