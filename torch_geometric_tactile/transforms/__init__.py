r"""Transforms: from data to data, one per file."""

from torch_geometric_tactile.transforms.base import FittedTransform, fit_transform, fitted_parts
from torch_geometric_tactile.transforms.knn_graph import KNNGraph
from torch_geometric_tactile.transforms.session_z_score import SessionZScore
from torch_geometric_tactile.transforms.tare import Tare
from torch_geometric_tactile.transforms.z_score import ZScore

__all__ = [
    "FittedTransform",
    "KNNGraph",
    "SessionZScore",
    "Tare",
    "ZScore",
    "fit_transform",
    "fitted_parts",
]
