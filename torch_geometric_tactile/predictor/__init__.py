r"""A model with all that its readings go through, in one file; without the extra ``train``."""

from torch_geometric_tactile.predictor.predictor import Predictor

__all__ = ["Predictor"]
