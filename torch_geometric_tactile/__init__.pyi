from . import (
    analysis,
    baselines,
    data,
    datasets,
    experiments,
    io,
    live,
    loader,
    nn,
    predictor,
    reports,
    sensors,
    sim,
    testing,
    training,
    transforms,
    visualization,
)
from .predictor import Predictor

__version__: str

__all__ = [
    "Predictor",
    "__version__",
    "analysis",
    "baselines",
    "data",
    "datasets",
    "experiments",
    "io",
    "live",
    "loader",
    "nn",
    "predictor",
    "reports",
    "sensors",
    "sim",
    "testing",
    "training",
    "transforms",
    "visualization",
]
