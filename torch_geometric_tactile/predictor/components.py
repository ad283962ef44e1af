r"""Transforms and models as plain data: their class by its name, their arguments and their state.

Only classes listed here are ever built from a file. Any other is a user's own: its name, its text
(:obj:`repr`) and its tensors are written, and the object is given again when the file is read.
"""

import copy
import inspect
import json
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import torch
import torch_geometric.transforms
from torch import Tensor
from torch.nn import Module
from torch.overrides import TorchFunctionMode
from torch_geometric.transforms import BaseTransform, Compose

from torch_geometric_tactile import transforms
from torch_geometric_tactile.nn import models
from torch_geometric_tactile.predictor.preparation import flat
from torch_geometric_tactile.sensors import HandKinematics, TaxelLayout
from torch_geometric_tactile.transforms import FittedTransform

# Deterministic transforms of PyG that need no compiled package and keep the number of taxels.
_PYG_TRANSFORMS = (
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
    "Polar",
    "RemoveDuplicatedEdges",
    "RemoveSelfLoops",
    "Spherical",
    "TargetIndegree",
    "ToUndirected",
)
# Arguments that PyG keeps by another name.
_KEPT_AS = {"max_value": "max", "key": "keys"}
_ROOM = 2**28  # bytes that building a model may ask for beside its own


def transform_classes() -> dict[str, type]:
    r"""Returns the transforms that are built by name: ours, and some of PyG's."""
    ours = {name: getattr(transforms, name) for name in transforms.__all__}
    classes = {name: getattr(torch_geometric.transforms, name) for name in _PYG_TRANSFORMS}
    return classes | {name: cls for name, cls in ours.items() if inspect.isclass(cls)}


def model_classes() -> dict[str, type]:
    r"""Returns the models that are built by name."""
    classes = {name: getattr(models, name) for name in models.__all__}
    return {name: cls for name, cls in classes.items() if inspect.isclass(cls)}


class NotPlainError(ValueError):
    r"""A value that cannot be written as plain data."""


class MissingOwnError(ValueError):
    r"""A model or transform of the user's own that must be given and was not.

    Args:
        text (str): The message.
        argument (str): What must be given: :obj:`"model"` or :obj:`"transforms"`.
    """

    def __init__(self, text: str, argument: str) -> None:
        super().__init__(text)
        self.argument = argument


class Describer:
    r"""Turns transforms and models into JSON values and named tensors.

    Args:
        layout (TaxelLayout): The layout of the sensor, which is written once.
    """

    def __init__(self, layout: TaxelLayout) -> None:
        self.layout = layout
        self.tensors: dict[str, Tensor] = {}

    def transform(self, transform: Any) -> dict[str, Any]:
        r"""Describes a transform, with its fitted state.

        Args:
            transform (BaseTransform): The transform; a user's own may be any callable.
        """
        kind = type(transform).__name__
        if transform_classes().get(kind) is type(transform):
            mark = len(self.tensors)
            try:
                if isinstance(transform, Compose):  # which may hold any callable
                    parts = [{"$transform": self.transform(part)} for part in transform.transforms]
                    arguments: Any = {"transforms": parts}
                else:
                    arguments = self.value(transform_arguments(transform))
                described = {"class": kind, "arguments": arguments}
                self._check(described, transform)
            except NotPlainError:
                self._forget(mark)
                described = _own(transform)
        else:
            described = _own(transform)
        if hasattr(transform, "state_dict"):
            described["state"] = self.value(transform.state_dict())
        return described

    def model(self, model: Module) -> dict[str, Any]:
        r"""Describes a model, without its weights.

        Args:
            model (torch.nn.Module): The model.
        """
        kind = type(model).__name__
        arguments = getattr(model, "_hub_arguments", None)
        if model_classes().get(kind) is not type(model) or arguments is None:
            return _own(model)
        mark = len(self.tensors)
        try:
            return {"class": kind, "arguments": self.value(arguments)}
        except NotPlainError:  # an encoder of edge features, for example
            self._forget(mark)
            return _own(model)

    def value(self, value: Any) -> Any:
        r"""Describes an argument or a state.

        Args:
            value (object): Plain values, tensors, layouts, kinematics and transforms, in lists,
                tuples and mappings.

        Raises:
            NotPlainError: If it is anything else.
        """
        if value is None or isinstance(value, bool | int | str):
            return value
        if isinstance(value, float):
            return value if math.isfinite(value) else {"$float": str(value)}
        if isinstance(value, list | tuple):
            return [self.value(item) for item in value]
        if isinstance(value, Mapping):
            if not all(isinstance(key, str) and not key.startswith("$") for key in value):
                raise NotPlainError(f"the keys of a mapping must be texts (got {list(value)})")
            return {key: self.value(item) for key, item in value.items()}
        if isinstance(value, np.ndarray | np.generic):
            value = torch.as_tensor(value)
        if isinstance(value, Tensor):
            name = f"tensor.{len(self.tensors)}"
            self.tensors[name] = value.detach()
            return {"$tensor": name}
        if isinstance(value, TaxelLayout):
            same = value is self.layout or value.to_dict() == self.layout.to_dict()
            return {"$layout": None if same else value.to_dict()}
        if isinstance(value, HandKinematics):
            return {"$kinematics": value.to_dict()}
        if isinstance(value, BaseTransform):
            return {"$transform": self.transform(value)}
        raise NotPlainError(f"'{type(value).__name__}' is no plain value")

    def _check(self, described: dict[str, Any], transform: Any) -> None:
        # What is built from the description must be the transform again, or its arguments are not
        # the attributes of the same names.
        if isinstance(transform, Compose):  # whose parts were checked one by one
            return
        again = Builder(self.layout, self.tensors).transform(described)
        other = Describer(self.layout)
        arguments = other.value(transform_arguments(again))
        if repr(again) != repr(transform) or not _equal(
            arguments, other.tensors, described["arguments"], self.tensors
        ):
            raise NotPlainError(f"{transform!r} differs from what its arguments make")

    def _forget(self, mark: int) -> None:
        for name in list(self.tensors)[mark:]:
            del self.tensors[name]


class Builder:
    r"""Builds transforms and models from what :class:`Describer` returned.

    Args:
        layout (TaxelLayout): The layout of the sensor.
        tensors (Mapping of str to torch.Tensor): The tensors.
        own (sequence, optional): Transforms with the user's own among them.
    """

    def __init__(
        self, layout: TaxelLayout, tensors: Mapping[str, Tensor], own: Sequence[Any] | None = None
    ) -> None:
        self.layout = layout
        self.tensors = tensors
        self._own = [part for transform in own or () for part in flat(transform)]

    def transform(self, described: Any) -> Any:
        r"""Returns a transform, with its state.

        Args:
            described (dict): What :meth:`Describer.transform` returned.

        Raises:
            ValueError: If it is unknown, or the user's own is missing or another one.
        """
        state = None if "state" not in described else self.value(described["state"])
        if "own" in described:
            transform = self._given(described)
            transform = copy.deepcopy(transform)  # its state is that of the file from now on
        else:
            classes = transform_classes()
            transform = self._object(described, classes, "transform")
        if state is not None:
            if isinstance(transform, FittedTransform):
                _check_state(transform, state)
            transform.load_state_dict(state)
        return transform

    def model(self, described: Any, given: Module | None = None) -> Module:
        r"""Returns a model, with weights that are still to be loaded.

        Args:
            described (dict): What :meth:`Describer.model` returned.
            given (torch.nn.Module, optional): The user's own; it is copied.

        Raises:
            ValueError: If it is unknown, or the user's own is missing or another one.
        """
        if given is not None:
            name = described.get("own", described.get("class"))
            if type(given).__name__ != name:
                raise ValueError(f"'model' must be a {name} (got {type(given).__name__})")
            return copy.deepcopy(given)
        if "own" in described:
            raise MissingOwnError(
                f"'model' must be given: the file has the weights of a {described['own']}, which "
                "is not built by name",
                "model",
            )
        most = _ROOM + 4 * sum(
            value.numel() * value.element_size() for value in self.tensors.values()
        )
        with torch.random.fork_rng(devices=[]), _AllocationLimit(most):
            model: Module = self._object(described, model_classes(), "model")
        return model

    def _given(self, described: Mapping[str, Any]) -> Any:
        for i, transform in enumerate(self._own):
            if all(described.get(key) == value for key, value in _own(transform).items()):
                return self._own.pop(i)
        raise MissingOwnError(
            f"'transforms' must hold the transform of your own '{described.get('text')}', which is "
            f"not built by name (got {[_own(transform)['text'] for transform in self._own]})",
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
        r"""Returns an argument or a state.

        Args:
            value (object): What :meth:`Describer.value` returned.
        """
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
        r"""Returns a tensor by its name.

        Args:
            name (str): The name.
        """
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


def transform_arguments(transform: Any) -> dict[str, Any]:
    r"""Returns the arguments of a transform's constructor: what its method :obj:`arguments`
    returns, or else its attributes of the same names.

    Args:
        transform (BaseTransform): The transform.

    Raises:
        NotPlainError: If an argument is no attribute.
    """
    if hasattr(transform, "arguments"):
        arguments: dict[str, Any] = transform.arguments()
        return arguments
    if type(transform).__init__ is object.__init__:
        return {}
    out = {}
    for name in list(inspect.signature(type(transform).__init__).parameters)[1:]:
        kept = name if hasattr(transform, name) else _KEPT_AS.get(name, name)
        if not hasattr(transform, kept):
            raise NotPlainError(f"{type(transform).__name__} keeps no '{name}'")
        out[name] = getattr(transform, kept)
    return out


def load_weights(model: Module, weights: Mapping[str, Tensor]) -> None:
    r"""Loads weights into a model of the same names and shapes.

    Args:
        model (torch.nn.Module): The model.
        weights (Mapping of str to torch.Tensor): Its state.

    Raises:
        ValueError: If a name or a shape differs; the message says which.
    """
    own = {name: tuple(value.shape) for name, value in model.state_dict().items()}
    for name in [*weights, *own]:
        if name not in own or name not in weights:
            where = "file" if name in weights else "model"
            raise ValueError(f"'model' must have the weights of the file ('{name}': {where} only)")
        shape = tuple(weights[name].shape)
        if own[name] != shape:
            raise ValueError(
                f"'model' must have '{name}' of shape {shape}, as the file (got {own[name]})"
            )
    # Takes over the numbers in the precision in which they were saved.
    model.load_state_dict(dict(weights), assign=True)


def _own(value: Any) -> dict[str, Any]:
    kind = type(value).__name__
    if inspect.isroutine(value):
        return {"own": kind, "text": value.__qualname__}
    is_told = type(value).__repr__ is not object.__repr__  # which tells an address
    return {"own": kind, "text": repr(value) if is_told else kind}


def _check_state(transform: FittedTransform, state: Any) -> None:
    if state == {}:  # of one that was not fitted
        return
    found = {key: state.get(key) for key in ("center", "scale", "key_values")}
    center, scale, values = found.values()
    if (
        not all(isinstance(value, Tensor) for value in found.values())
        or values.dim() != 1
        or center.shape[:1] != values.shape
        or scale.shape != center.shape
        or not (center.is_floating_point() and scale.is_floating_point())
    ):
        raise ValueError(f"the state of {transform!r} must be a centre and a scale for each key")


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


class _AllocationLimit(TorchFunctionMode):
    # Tensors are allocated before they are filled, so that a size beyond all measure in a damaged
    # or hostile file is found before it takes the memory.
    def __init__(self, most: int) -> None:
        super().__init__()
        self.most = most
        self.used = 0

    def __torch_function__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        out = func(*args, **(kwargs or {}))
        if isinstance(out, Tensor) and func in _FACTORIES:
            self.used += out.numel() * out.element_size()
            if self.used > self.most:
                raise ValueError(
                    f"the model must not be larger than its weights in the file (got more than "
                    f"{self.most} bytes)"
                )
        return out


_FACTORIES = (
    torch.empty,
    torch.zeros,
    torch.ones,
    torch.rand,
    torch.randn,
    torch.full,
    torch.arange,
)
