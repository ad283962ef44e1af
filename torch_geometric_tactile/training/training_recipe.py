r"""The training hyperparameters of the package's own models."""

import math
from typing import NamedTuple

from torch_geometric_tactile._checks import need

# Selected on validation parts by studies/default_model.py.
_NUM_STEPS = 1500
_EPOCH_RANGE = (15, 60)
_BATCH_SIZE_RANGE = (16, 64)


class TrainingRecipe(NamedTuple):
    r"""The batch size, the number of epochs and the hyperparameters of the optimizer."""

    batch_size: int
    max_epochs: int
    lr: float = 4e-3
    weight_decay: float = 0.03
    label_smoothing: float = 0.1


def training_recipe(num_samples: int) -> TrainingRecipe:
    r"""Returns the hyperparameters for training
    :class:`~torch_geometric_tactile.nn.models.TaxelNet`,
    :class:`~torch_geometric_tactile.nn.models.PosedTaxelNet` and
    :class:`~torch_geometric_tactile.nn.models.TemporalTaxelNet` on a number of samples.
    :obj:`studies/default_model.py` selected them on validation parts with single frames.

    A batch has 1/24 of the samples, but at least 16 and at most 64 samples. Training has about
    1,500 steps, but at least 15 and at most 60 epochs. The learning rate falls to zero, so that the
    last weights are used and no data has to be held out for early stopping.

    Examples:
        >>> recipe = training_recipe(4000)
        >>> recipe.batch_size, recipe.max_epochs, recipe.lr
        (64, 24, 0.004)
    """
    need(num_samples >= 1, "'num_samples' must be at least 1", num_samples)
    min_batch_size, max_batch_size = _BATCH_SIZE_RANGE
    batch_size = min(max_batch_size, max(min_batch_size, num_samples // 24))
    min_epochs, max_epochs = _EPOCH_RANGE
    epochs = math.ceil(_NUM_STEPS * batch_size / num_samples)
    return TrainingRecipe(batch_size, min(max_epochs, max(min_epochs, epochs)))
