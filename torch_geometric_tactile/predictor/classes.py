r"""Transforms and models that may be built from a file, by their names."""

import inspect

import torch_geometric.transforms

from torch_geometric_tactile import transforms
from torch_geometric_tactile.data._transform_rules import IN_FILES
from torch_geometric_tactile.nn import models
from torch_geometric_tactile.predictor.average_model import AverageModel
from torch_geometric_tactile.predictor.estimator_model import EstimatorModel


def transform_classes() -> dict[str, type]:
    r"""Returns the transforms that are built by name: those of this package, and some of PyG's."""
    exports = {name: getattr(transforms, name) for name in transforms.__all__}
    package_classes = {name: cls for name, cls in exports.items() if inspect.isclass(cls)}
    del package_classes["TactileTransform"]  # the base class
    pyg_classes = {name: getattr(torch_geometric.transforms, name) for name in IN_FILES}
    return pyg_classes | package_classes


def model_classes() -> dict[str, type]:
    r"""Returns the models that are built by name, all of this package."""
    exports = {name: getattr(models, name) for name in models.__all__}
    package_classes = {name: cls for name, cls in exports.items() if inspect.isclass(cls)}
    return package_classes | {"AverageModel": AverageModel, "EstimatorModel": EstimatorModel}
