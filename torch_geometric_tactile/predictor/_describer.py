r"""Transforms and models as plain data: their class by its name, their arguments and their state.

Any class that is not in :mod:`classes` is a user's own: its name, its text (:obj:`repr`) and its
tensors are written, and the object is given again when the file is read.
"""

import inspect
import json
import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.nn import Module
from torch_geometric.transforms import BaseTransform, Compose

from torch_geometric_tactile.data._pyg_transforms import KEPT_AS
from torch_geometric_tactile.predictor._builder import Builder, describe_own
from torch_geometric_tactile.predictor.classes import model_classes, transform_classes
from torch_geometric_tactile.sensors import HandKinematics, TaxelLayout


class NotPlainError(ValueError):
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
                    arguments = self.value(transform_arguments(transform))
                described = {"class": kind, "arguments": arguments}
                self._check(described, transform)
            except NotPlainError:
                self._forget(mark)
                described = describe_own(transform)
        else:
            described = describe_own(transform)
        if hasattr(transform, "state_dict"):
            described["state"] = self.value(transform.state_dict())
        return described

    def model(self, model: Module) -> dict[str, Any]:
        r"""Describes a model, without its weights."""
        kind = type(model).__name__
        arguments = getattr(model, "_hub_arguments", None)
        if model_classes().get(kind) is not type(model) or arguments is None:
            return describe_own(model)
        mark = len(self.tensors)
        try:
            return {"class": kind, "arguments": self.value(arguments)}
        except NotPlainError:  # an encoder of edge features, for example
            self._forget(mark)
            return describe_own(model)

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
                raise NotPlainError(f"the keys of a mapping must be texts (got {list(value)})")
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


def transform_arguments(transform: Any) -> dict[str, Any]:
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
        kept = name if hasattr(transform, name) else KEPT_AS.get(name, name)
        if not hasattr(transform, kept):
            raise NotPlainError(f"{type(transform).__name__} keeps no '{name}'")
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
