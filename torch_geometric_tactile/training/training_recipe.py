r"""How to train the models that are ours."""

import math
from typing import NamedTuple

from torch_geometric_tactile._checks import need

_STEPS = 1500
_EPOCHS = (15, 60)
_BATCHES = (16, 64)


class TrainingRecipe(NamedTuple):
    r"""What a training needs besides model and data."""

    batch_size: int
    max_epochs: int
    lr: float = 4e-3
    weight_decay: float = 0.03
    label_smoothing: float = 0.1


def training_recipe(num_samples: int) -> TrainingRecipe:
    r"""Returns how to train :class:`~torch_geometric_tactile.nn.models.TaxelNet`,
    :class:`~torch_geometric_tactile.nn.models.PosedTaxelNet` and
    :class:`~torch_geometric_tactile.nn.models.TemporalTaxelNet` on so many samples. It is the
    recipe of :obj:`studies/default_model.py`, chosen on validation parts of single frames.

    A batch has a twenty-fourth of the samples, within limits; training has about 1,500 steps, but
    at least 15 and at most 60 epochs. The rate falls to zero, so that the last weights are taken
    and nothing has to be kept back to stop early.

    Examples:
        >>> recipe = training_recipe(4000)
        >>> recipe.batch_size, recipe.max_epochs, recipe.lr
        (64, 24, 0.004)
    """
    need(num_samples >= 1, "'num_samples' must be at least 1", num_samples)
    least, most = _BATCHES
    batch_size = min(most, max(least, num_samples // 24))
    fewest, longest = _EPOCHS
    epochs = math.ceil(_STEPS * batch_size / num_samples)
    return TrainingRecipe(batch_size, min(longest, max(fewest, epochs)))
