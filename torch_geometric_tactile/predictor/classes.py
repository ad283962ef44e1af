r"""The transforms and models that may be built from a file, by their names."""

import inspect

import torch_geometric.transforms

from torch_geometric_tactile import transforms
from torch_geometric_tactile.data._transform_rules import IN_FILES
from torch_geometric_tactile.nn import models
from torch_geometric_tactile.predictor.average_model import AverageModel
from torch_geometric_tactile.predictor.estimator_model import EstimatorModel


def transform_classes() -> dict[str, type]:
    r"""Returns the transforms that are built by name: ours, and some of PyG's."""
    named = {name: getattr(transforms, name) for name in transforms.__all__}
    ours = {name: cls for name, cls in named.items() if inspect.isclass(cls)}
    del ours["TactileTransform"]  # the base class
    classes = {name: getattr(torch_geometric.transforms, name) for name in IN_FILES}
    return classes | ours


def model_classes() -> dict[str, type]:
    r"""Returns the models that are built by name."""
    classes = {name: getattr(models, name) for name in models.__all__}
    ours = {name: cls for name, cls in classes.items() if inspect.isclass(cls)}
    return ours | {"AverageModel": AverageModel, "EstimatorModel": EstimatorModel}
