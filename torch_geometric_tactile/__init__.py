r"""Robot touch for PyTorch Geometric.

Submodules load on first use, so that ``import torch_geometric_tactile`` costs nothing and the
command line answers before :obj:`torch` is imported.
"""

from importlib import import_module
from types import ModuleType

__version__ = "0.1.0"

_SUBMODULES = (
    "analysis",
    "baselines",
    "data",
    "datasets",
    "experiments",
    "io",
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


def __getattr__(name: str) -> ModuleType:
    if name in _SUBMODULES:
        return import_module(f"{__name__}.{name}")
    raise AttributeError(f"module '{__name__}' has no attribute '{name}'")


def __dir__() -> list[str]:
    return sorted([*globals(), *_SUBMODULES])
