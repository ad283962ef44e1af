r"""Robot touch for PyTorch Geometric.

Submodules load on first use, so that ``import torch_geometric_tactile`` costs nothing and the
command line answers before :obj:`torch` is imported.
"""

from importlib import import_module
from typing import Any

__version__ = "0.2.1"

_SUBMODULES = (
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
)


def __getattr__(name: str) -> Any:
    if name in _SUBMODULES:
        return import_module(f"{__name__}.{name}")
    if name == "Predictor":
        return import_module(f"{__name__}.predictor").Predictor
    raise AttributeError(f"module '{__name__}' has no attribute '{name}'")


def __dir__() -> list[str]:
    return sorted([*globals(), *_SUBMODULES, "Predictor"])
