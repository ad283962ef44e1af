r"""Analysis of trained models (attributions, embeddings, confusion matrices and ROC curves), and
calibration of readings. Plots are in :mod:`torch_geometric_tactile.visualization`.
"""

from torch_geometric_tactile._removed import removed_names
from torch_geometric_tactile.analysis.attribution import (
    IntegratedGradients,
    patch_occlusion,
    taxel_attribution,
)
from torch_geometric_tactile.analysis.calibration import CalibrationFit, fit_calibration
from torch_geometric_tactile.analysis.clustering import SegmentClustering, segment_clustering
from torch_geometric_tactile.analysis.confusion import class_confusion, label_confusion
from torch_geometric_tactile.analysis.embedding import embed_nodes, node_matrix
from torch_geometric_tactile.analysis.encoder_map import (
    EdgeSeparation,
    edge_separation,
    encoder_map,
    untrained_separation,
)
from torch_geometric_tactile.analysis.roc import RocCurve, roc_curves

__all__ = [
    "CalibrationFit",
    "EdgeSeparation",
    "IntegratedGradients",
    "RocCurve",
    "SegmentClustering",
    "class_confusion",
    "edge_separation",
    "embed_nodes",
    "encoder_map",
    "fit_calibration",
    "label_confusion",
    "node_matrix",
    "patch_occlusion",
    "roc_curves",
    "segment_clustering",
    "taxel_attribution",
    "untrained_separation",
]

__getattr__ = removed_names(__name__)
