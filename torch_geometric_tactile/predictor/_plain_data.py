r"""Descriptions of transforms and models as plain data: class name, arguments and state. Objects
are described when a predictor is saved, and built from their description when it is loaded.

Only classes listed in :mod:`classes` are built, and only if their arguments are plain values. For
other objects, only the name, the :obj:`repr` and the tensors are saved; the user passes the object
when the file is read.
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
from torch_geometric_tactile.predictor._classes import model_classes, transform_classes
from torch_geometric_tactile.predictor.average_model import AverageModel
from torch_geometric_tactile.predictor.missing_own_error import MissingOwnError
from torch_geometric_tactile.sensors import HandKinematics, TaxelLayout
from torch_geometric_tactile.transforms import FittedTransform


def _describe_user_object(value: Any) -> dict[str, Any]:
    r"""Returns the class name and the text of the user's transform or model."""
    class_name = type(value).__name__
    if inspect.isroutine(value):
        return {"own": class_name, "text": value.__qualname__}
    # The default representation contains a memory address.
    has_custom_repr = type(value).__repr__ is not object.__repr__
    return {"own": class_name, "text": repr(value) if has_custom_repr else class_name}


def _check_not_removed(name: Any) -> None:
    r"""Raises a :class:`ValueError` if a class was removed with the pretrained encoders."""
    need(name not in ENCODER_CLASSES, f"{name} was removed: {LAST_READER}")


def _is_average_of(described: Mapping[str, Any], name: str) -> bool:
    r"""Returns whether a description is for an :class:`AverageModel` of the user's models of the
    class with the given name.
    """
    arguments = described.get("arguments")
    models = arguments.get("models") if isinstance(arguments, Mapping) else None
    if described.get("class") != "AverageModel" or not isinstance(models, list):
        return False
    model = models[0].get("$model") if models and isinstance(models[0], Mapping) else None
    return isinstance(model, Mapping) and model.get("own") == name


class Builder:
    r"""A builder of transforms and models from descriptions by :class:`Describer`.

    Args:
        layout (TaxelLayout, optional): The layout to which descriptions refer.
        tensors (Mapping of str to torch.Tensor): The tensors to which descriptions refer.
        user_transforms (sequence of callable, optional): The user's transforms.
    """

    def __init__(
        self,
        layout: TaxelLayout | None,
        tensors: Mapping[str, Tensor],
        user_transforms: Sequence[Any] | None = None,
    ) -> None:
        self.layout = layout
        self.tensors = tensors
        self._user_transforms = [
            part for transform in user_transforms or () for part in flat(transform)
        ]
        self._limit = AllocationLimit(tensors.values())  # a common limit for all parts
        self._has_limit = False
        self._user_model: Module | None = None

    @contextmanager
    def _limit_allocation(self) -> Iterator[None]:
        if self._has_limit:  # this part belongs to another part, which has set the limit
            yield
            return
        self._has_limit = True
        try:
            with self._limit:
                yield
        finally:
            self._has_limit = False

    def transform(self, described: Any) -> Any:
        r"""Returns a transform with its fitted state."""
        with self._limit_allocation():
            return self._transform(described)

    def _transform(self, described: Any) -> Any:
        state = None if "state" not in described else self.value(described["state"])
        if "own" in described:
            transform = self._pop_user_transform(described)
            transform = copy.deepcopy(transform)  # the user's object keeps its state
        else:
            classes = transform_classes()
            transform = self._build_object(described, classes, "transform")
            for part in flat(transform):
                if not callable(part):
                    raise ValueError(f"'transforms' must hold transforms (got {part!r:.100})")
        if state is not None:
            if isinstance(transform, FittedTransform):
                _check_state(transform, state)
            transform.load_state_dict(state)
        return transform

    def model(self, described: Any, user_model: Module | None = None) -> Module:
        r"""Returns a model, whose weights must be loaded separately."""
        is_described = user_model is None or _is_average_of(described, type(user_model).__name__)
        self._user_model = user_model
        with torch.random.fork_rng(devices=[]):  # drawing weights must not change later results
            if not is_described:
                return self._copy_user_model(described.get("own", described.get("class")))
            with self._limit_allocation():
                return self._build_model(described)

    def _copy_user_model(self, name: Any) -> Module:
        model = self._user_model
        if model is None:
            _check_not_removed(name)
            raise MissingOwnError(
                f"'model' must be given: your model '{name}' cannot be built from the file",
                "model",
            )
        need(type(model).__name__ == name, f"'model' must be of class {name}", type(model).__name__)
        return copy.deepcopy(model)

    def _build_model(self, described: Any) -> Module:
        if isinstance(described, Mapping) and "own" in described:
            return self._copy_user_model(described["own"])
        if not isinstance(described, Mapping) or "class" not in described:
            raise ValueError(f"a model must have a class (got {described!r:.80})")
        model: Module = self._build_object(described, model_classes(), "model")
        return model

    def _pop_user_transform(self, described: Mapping[str, Any]) -> Any:
        for i, transform in enumerate(self._user_transforms):
            if all(
                described.get(key) == value
                for key, value in _describe_user_object(transform).items()
            ):
                return self._user_transforms.pop(i)
        _check_not_removed(described["own"])
        user_texts = [
            _describe_user_object(transform)["text"] for transform in self._user_transforms
        ]
        raise MissingOwnError(
            f"'transforms' must contain your transform '{described.get('text')}', which cannot be "
            f"built from the file (got {user_texts})",
            "transforms",
        )

    def _build_object(self, described: Any, classes: Mapping[str, type], kind: str) -> Any:
        name = described.get("class")
        _check_not_removed(name)
        if name not in classes:
            raise ValueError(
                f"there is no {kind} '{name}' in this version; there are {', '.join(classes)}"
            )
        arguments = self.value(described["arguments"])
        try:
            return classes[name](**arguments)
        except ValueError:
            raise
        except Exception as error:  # arguments of a damaged file may raise any error
            raise ValueError(f"{kind} '{name}' rejects its arguments ({error})") from error

    def value(self, value: Any) -> Any:
        r"""Returns an argument or a state from its description."""
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
        r"""Returns the tensor with a given name."""
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
    "$model": lambda builder, item: builder._build_model(item),
}


def load_weights(model: Module, weights: Mapping[str, Tensor]) -> None:
    r"""Loads weights into a model.

    Raises:
        ValueError: If names, shapes or number types do not match the model.
    """
    model_shapes = {name: tuple(value.shape) for name, value in model.state_dict().items()}
    kinds = {name: _number_kind(value) for name, value in model.state_dict().items()}
    for name in [*weights, *model_shapes]:
        if name not in model_shapes or name not in weights:
            location = "file" if name in weights else "model"
            raise ValueError(
                f"'model' must have the weights of the file ('{name}': {location} only)"
            )
        shape = tuple(weights[name].shape)
        if model_shapes[name] != shape:
            raise ValueError(
                f"'model' must have '{name}' of shape {shape}, like the file (got "
                f"{model_shapes[name]})"
            )
        if kinds[name] != _number_kind(weights[name]):
            raise ValueError(
                f"'{name}' must hold {kinds[name]}, like the model (got "
                f"{_number_kind(weights[name])} of {weights[name].dtype})"
            )
    precisions = [_float_dtypes(state) for state in (model.state_dict(), weights)]
    if len(precisions[0]) == 1 < len(precisions[1]):
        raise ValueError(
            f"its weights must have one precision, like the model (got {precisions[1]})"
        )
    # Weights are assigned, not copied, so that the model gets the precision of the saved weights.
    model.load_state_dict(dict(weights), assign=True)


def _float_dtypes(state: Mapping[str, Tensor]) -> list[str]:
    return sorted({str(value.dtype) for value in state.values() if value.is_floating_point()})


def _number_kind(tensor: Tensor) -> str:
    if tensor.layout != torch.strided:
        return f"a {tensor.layout} tensor"
    if tensor.is_complex():
        return "complex numbers"
    return "real numbers" if tensor.is_floating_point() else "integers"


def _check_state(transform: FittedTransform, state: Any) -> None:
    if state == {}:  # the transform was not fitted
        return
    tensors = {key: state.get(key) for key in ("center", "scale", "key_values")}
    center, scale, values = tensors.values()
    num_dims = 3 if transform.attr == "x" else 1 + (transform.per == "channel")
    if (
        not all(isinstance(value, Tensor) for value in tensors.values())
        or values.dim() != 1
        or center.dim() < num_dims
        or center.shape[:1] != values.shape
        or scale.shape != center.shape
        or not (center.is_floating_point() and scale.is_floating_point())
    ):
        raise ValueError(f"the state of {transform!r} must have a centre and a scale for each key")


class _NotPlainError(ValueError):
    r"""A value that cannot be written as plain data."""


class Describer:
    r"""A converter of transforms and models to JSON values and named tensors.

    Args:
        layout (TaxelLayout, optional): The layout that is saved elsewhere. Arguments that are equal
            to this layout are described by a reference.
    """

    def __init__(self, layout: TaxelLayout | None) -> None:
        self.layout = layout
        self.tensors: dict[str, Tensor] = {}

    def transform(self, transform: Any) -> dict[str, Any]:
        r"""Returns the description of a transform with its fitted state."""
        class_name = type(transform).__name__
        if transform_classes().get(class_name) is type(transform):
            num_tensors_before = len(self.tensors)
            try:
                if isinstance(transform, Compose):  # its items may be any callables
                    parts = [{"$transform": self.transform(part)} for part in transform.transforms]
                    arguments: Any = {"transforms": parts}
                else:
                    arguments = self.value(_constructor_arguments(transform))
                described = {"class": class_name, "arguments": arguments}
                self._check_round_trip(described, transform)
            except _NotPlainError:
                self._drop_tensors(num_tensors_before)
                described = _describe_user_object(transform)
        else:
            described = _describe_user_object(transform)
        if hasattr(transform, "state_dict"):
            described["state"] = self.value(transform.state_dict())
        return described

    def model(self, model: Module) -> dict[str, Any]:
        r"""Returns the description of a model without its weights."""
        class_name = type(model).__name__
        arguments = getattr(model, "init_arguments", None)
        if model_classes().get(class_name) is not type(model) or arguments is None:
            return _describe_user_object(model)
        num_tensors_before = len(self.tensors)
        try:
            if isinstance(model, AverageModel):
                members = [{"$model": self.model(member)} for member in model.models]
                options = {key: value for key, value in arguments.items() if key != "models"}
                return {
                    "class": class_name,
                    "arguments": {"models": members, **self.value(options)},
                }
            return {"class": class_name, "arguments": self.value(arguments)}
        except _NotPlainError:  # for example, an argument is an encoder of edge features
            self._drop_tensors(num_tensors_before)
            return _describe_user_object(model)

    def value(self, value: Any) -> Any:
        r"""Returns the description of an argument or a state."""
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
            layout = self.layout
            is_same_layout = layout is not None and (
                value is layout or value.to_dict() == layout.to_dict()
            )
            return {"$layout": None if is_same_layout else value.to_dict()}
        if isinstance(value, HandKinematics):
            return {"$kinematics": value.to_dict()}
        if isinstance(value, BaseTransform):
            return {"$transform": self.transform(value)}
        raise _NotPlainError(f"'{type(value).__name__}' is not a plain value")

    def _check_round_trip(self, described: dict[str, Any], transform: Any) -> None:
        # Arguments are read from attributes with the same names, which may hold other values. Only
        # building a transform from them shows whether they do.
        if isinstance(transform, Compose):  # its items were checked one by one
            return
        rebuilt = Builder(self.layout, self.tensors).transform(described)
        describer = Describer(self.layout)
        arguments = describer.value(_constructor_arguments(rebuilt))
        if repr(rebuilt) != repr(transform) or not _are_equal_descriptions(
            arguments, describer.tensors, described["arguments"], self.tensors
        ):
            raise _NotPlainError(f"{transform!r} differs from a transform with its arguments")

    def _drop_tensors(self, num_tensors: int) -> None:
        for name in list(self.tensors)[num_tensors:]:
            del self.tensors[name]


def _constructor_arguments(transform: Any) -> dict[str, Any]:
    r"""Returns the constructor arguments of a transform, from its method :obj:`arguments` or
    otherwise from attributes with the same names.
    """
    if hasattr(transform, "arguments"):
        arguments: dict[str, Any] = transform.arguments()
        return arguments
    if type(transform).__init__ is object.__init__:
        return {}
    out = {}
    for name in list(inspect.signature(type(transform).__init__).parameters)[1:]:
        attribute = name if hasattr(transform, name) else ATTRIBUTE_NAMES.get(name, name)
        if not hasattr(transform, attribute):
            raise _NotPlainError(f"{type(transform).__name__} has no attribute '{name}'")
        out[name] = getattr(transform, attribute)
    return out


def _are_equal_descriptions(
    a: Any, a_tensors: Mapping[str, Tensor], b: Any, b_tensors: Mapping[str, Tensor]
) -> bool:
    # The names of tensors may differ, so the numbers are compared instead.
    def to_text(value: Any, tensors: Mapping[str, Tensor]) -> str:
        def with_numbers(item: Any) -> Any:
            if isinstance(item, list):
                return [with_numbers(element) for element in item]
            if isinstance(item, dict):
                if "$tensor" in item:
                    return tensors[item["$tensor"]].tolist()
                return {key: with_numbers(entry) for key, entry in item.items() if key != "state"}
            return item

        return json.dumps(with_numbers(value))

    return to_text(a, a_tensors) == to_text(b, b_tensors)
