r"""The transforms and models that may be built from a file, by their names."""

import inspect
from typing import Any

import torch_geometric.transforms

from torch_geometric_tactile import transforms
from torch_geometric_tactile.data._pyg_transforms import IN_FILES
from torch_geometric_tactile.data.apply_transform import flat as flat
from torch_geometric_tactile.nn import models


def transform_classes() -> dict[str, type]:
    r"""Returns the transforms that are built by name: ours, and some of PyG's."""
    ours = {name: getattr(transforms, name) for name in transforms.__all__}
    classes = {name: getattr(torch_geometric.transforms, name) for name in IN_FILES}
    is_class = {
        name: inspect.isclass(cls) and not inspect.isabstract(cls) for name, cls in ours.items()
    }
    return classes | {name: cls for name, cls in ours.items() if is_class[name]}


def model_classes() -> dict[str, type]:
    r"""Returns the models that are built by name."""
    classes = {name: getattr(models, name) for name in models.__all__}
    return {name: cls for name, cls in classes.items() if inspect.isclass(cls)}


def describe_own(value: Any) -> dict[str, Any]:
    r"""Returns the name and the text of a user's own transform or model."""
    kind = type(value).__name__
    if inspect.isroutine(value):
        return {"own": kind, "text": value.__qualname__}
    is_told = type(value).__repr__ is not object.__repr__  # which tells an address
    return {"own": kind, "text": repr(value) if is_told else kind}
