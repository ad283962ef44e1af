r"""The transforms and models that may be built from a file by their names.

Names are never removed: files written by an earlier version must still open.
"""

import torch_geometric.transforms

from torch_geometric_tactile import transforms
from torch_geometric_tactile.data._transform_rules import IN_FILES
from torch_geometric_tactile.nn import models
from torch_geometric_tactile.predictor.average_model import AverageModel
from torch_geometric_tactile.predictor.estimator_model import EstimatorModel

_TRANSFORMS = (
    "AbsoluteMorphology",
    "Calibrate",
    "CommonMode",
    "ContactCrop",
    "DropPatches",
    "DropTaxels",
    "FillMissing",
    "FittedTransform",
    "GeometricEdgeAttr",
    "KNNGraph",
    "Normalize",
    "NormalizeRMS",
    "RandomContrast",
    "RandomGain",
    "RandomInversion",
    "RandomMirror",
    "RandomNoise",
    "RandomOffset",
    "RandomShift",
    "RandomTimeShift",
    "Resample",
    "SectorGraph",
    "SelectChannels",
    "SessionZScore",
    "SquareRoot",
    "Tare",
    "TaxelDescriptors",
    "TaxelForce",
    "TaxelPose",
    "TopologicalSegmentation",
    "ZScore",
)
_MODELS = (
    "BMFCNN",
    "CNNThread",
    "GCNThread",
    "GraspGCN",
    "GraspLSTM",
    "HandCNN",
    "MSCNN",
    "MTCNN",
    "MTGCN",
    "PooledMLP",
    "PosedTaxelNet",
    "SegmentedThread",
    "SmallCNN",
    "TactileFNN",
    "TactileGCN",
    "TactileModel",
    "TaxelNet",
    "TemporalCNN",
    "TemporalTaxelNet",
    "Thread",
)


def transform_classes() -> dict[str, type]:
    r"""Returns the transforms that are built by name: those of this package, and some of PyG."""
    package_classes = {name: getattr(transforms, name) for name in _TRANSFORMS}
    return {name: getattr(torch_geometric.transforms, name) for name in IN_FILES} | package_classes


def model_classes() -> dict[str, type]:
    r"""Returns the models of this package, which are built by name."""
    package_classes = {name: getattr(models, name) for name in _MODELS}
    return package_classes | {"AverageModel": AverageModel, "EstimatorModel": EstimatorModel}
