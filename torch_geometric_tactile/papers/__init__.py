r"""Tables from five papers with their published numbers and studies. Requires the extras ``train``
and ``viz``."""

from typing import TYPE_CHECKING

from torch_geometric_tactile._removed import removed_names
from torch_geometric_tactile.papers.frame_studies import DeadRows, FrameTime
from torch_geometric_tactile.papers.layer_studies import FeatureEmbedding, FeatureMaps, LayerProbes
from torch_geometric_tactile.papers.load_table import load_table, table_names
from torch_geometric_tactile.papers.training_history import TrainingHistory
from torch_geometric_tactile.papers.write_table import write_table

__all__ = [
    "DeadRows",
    "FeatureEmbedding",
    "FeatureMaps",
    "FrameTime",
    "LayerProbes",
    "TrainingHistory",
    "load_table",
    "table_names",
    "write_table",
]

if not TYPE_CHECKING:
    __getattr__ = removed_names(__name__)
