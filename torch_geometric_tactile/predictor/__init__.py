r"""Predictors: a trained model and the preparation of its readings in one file. Does not need the
extra ``train``."""

from torch_geometric_tactile.predictor.builder import MissingOwnError
from torch_geometric_tactile.predictor.content import checkpoint_entry, is_checkpoint
from torch_geometric_tactile.predictor.predictor import Predictor

__all__ = ["MissingOwnError", "Predictor", "checkpoint_entry", "is_checkpoint"]
