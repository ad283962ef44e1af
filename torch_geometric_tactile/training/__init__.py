r"""Training and evaluation with Lightning. Needs the extra ``train``."""

from typing import TYPE_CHECKING

try:
    import jsonargparse  # noqa: F401
    import lightning  # noqa: F401
    import torchmetrics  # noqa: F401
except ImportError as error:
    raise ModuleNotFoundError(
        f"torch_geometric_tactile.training needs '{error.name}': "
        'pip install "torch-geometric-tactile[train]"',
        name=error.name,
    ) from error


from torch_geometric_tactile._removed import removed_names
from torch_geometric_tactile.training.cosine_annealing import CosineAnnealing
from torch_geometric_tactile.training.data_module import TactileDataModule
from torch_geometric_tactile.training.metrics import classification_metrics, regression_metrics
from torch_geometric_tactile.training.module import TactileModule, classifier_from_config
from torch_geometric_tactile.training.one_cycle import OneCycle
from torch_geometric_tactile.training.quiet import quiet_lightning
from torch_geometric_tactile.training.training_recipe import TrainingRecipe, training_recipe

__all__ = [
    "CosineAnnealing",
    "OneCycle",
    "TactileDataModule",
    "TactileModule",
    "TrainingRecipe",
    "classification_metrics",
    "classifier_from_config",
    "quiet_lightning",
    "regression_metrics",
    "training_recipe",
]

if not TYPE_CHECKING:
    __getattr__ = removed_names(__name__)
