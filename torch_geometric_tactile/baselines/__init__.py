r"""The papers' baselines as scikit-learn estimators."""

from torch_geometric_tactile.baselines.features import FEATURE_NAMES, statistical_features
from torch_geometric_tactile.baselines.grasp_svm import GraspSVM

__all__ = ["FEATURE_NAMES", "GraspSVM", "statistical_features"]
