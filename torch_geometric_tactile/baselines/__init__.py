r"""Baselines as scikit-learn estimators, from the papers and for comparison."""

from torch_geometric_tactile._removed import removed_names
from torch_geometric_tactile.baselines.descriptor_features import DescriptorFeatures
from torch_geometric_tactile.baselines.flat_readings import FlatReadings
from torch_geometric_tactile.baselines.grasp_svm import GraspSVM
from torch_geometric_tactile.baselines.minirocket import minirocket
from torch_geometric_tactile.baselines.pipelines import (
    constant,
    descriptor_forest,
    descriptor_svm,
    flat_forest,
    linear_svm,
    posed_forest,
    posed_ridge,
    rbf_svm,
    signal_svm,
)
from torch_geometric_tactile.baselines.posed_summary import PosedSummary, posed_summary
from torch_geometric_tactile.baselines.sift_svm import SIFTSVM
from torch_geometric_tactile.baselines.surf_svm import SURFSVM
from torch_geometric_tactile.baselines.temperature_scaling import TemperatureScaling

__all__ = [
    "SIFTSVM",
    "SURFSVM",
    "DescriptorFeatures",
    "FlatReadings",
    "GraspSVM",
    "PosedSummary",
    "TemperatureScaling",
    "constant",
    "descriptor_forest",
    "descriptor_svm",
    "flat_forest",
    "linear_svm",
    "minirocket",
    "posed_forest",
    "posed_ridge",
    "posed_summary",
    "rbf_svm",
    "signal_svm",
]

__getattr__ = removed_names(__name__)
