r"""Plots of layouts, readings and results. The functions need the extra ``viz``; the import of this
package does not.
"""

from typing import TYPE_CHECKING

from torch_geometric_tactile._removed import removed_names
from torch_geometric_tactile.visualization.bigs_grasp import plot_bigs_grasps
from torch_geometric_tactile.visualization.comparison import ComparisonPanel, plot_comparison
from torch_geometric_tactile.visualization.curves import plot_curves
from torch_geometric_tactile.visualization.embedding import plot_embedding
from torch_geometric_tactile.visualization.feature_maps import (
    plot_feature_maps,
    plot_sample_embeddings,
)
from torch_geometric_tactile.visualization.figure import save_figure, theme
from torch_geometric_tactile.visualization.grasp import plot_grasps
from torch_geometric_tactile.visualization.hand import open_hand, plot_hand
from torch_geometric_tactile.visualization.hand_panels import plot_hand_panels
from torch_geometric_tactile.visualization.layout import plot_layout
from torch_geometric_tactile.visualization.letters import plot_presses
from torch_geometric_tactile.visualization.metrics import (
    plot_confusion,
    plot_label_confusions,
    plot_protocols,
    plot_roc,
)
from torch_geometric_tactile.visualization.predictions import plot_predictions
from torch_geometric_tactile.visualization.recording import plot_recording

__all__ = [
    "ComparisonPanel",
    "open_hand",
    "plot_bigs_grasps",
    "plot_comparison",
    "plot_confusion",
    "plot_curves",
    "plot_embedding",
    "plot_feature_maps",
    "plot_grasps",
    "plot_hand",
    "plot_hand_panels",
    "plot_label_confusions",
    "plot_layout",
    "plot_predictions",
    "plot_presses",
    "plot_protocols",
    "plot_recording",
    "plot_roc",
    "plot_sample_embeddings",
    "save_figure",
    "theme",
]

if not TYPE_CHECKING:
    __getattr__ = removed_names(__name__)
