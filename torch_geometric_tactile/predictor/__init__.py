r"""Predictors: a trained model and the preparation of its readings in one file. Predictors do not
need the extra ``train``."""

from typing import TYPE_CHECKING

from torch_geometric_tactile._removed import removed_names
from torch_geometric_tactile.predictor.average_model import AverageModel
from torch_geometric_tactile.predictor.estimator_model import EstimatorModel
from torch_geometric_tactile.predictor.estimator_predictor import estimator_predictor
from torch_geometric_tactile.predictor.export_onnx import Exported, export_onnx
from torch_geometric_tactile.predictor.measured_score import MeasuredScore
from torch_geometric_tactile.predictor.missing_own_error import MissingOwnError
from torch_geometric_tactile.predictor.predictor import Predictor
from torch_geometric_tactile.predictor.stock import predictor_path, stock_predictors

__all__ = [
    "AverageModel",
    "EstimatorModel",
    "Exported",
    "MeasuredScore",
    "MissingOwnError",
    "Predictor",
    "estimator_predictor",
    "export_onnx",
    "predictor_path",
    "stock_predictors",
]

if not TYPE_CHECKING:
    __getattr__ = removed_names(__name__)
