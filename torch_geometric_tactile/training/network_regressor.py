r"""A network as a regressor of scikit-learn."""

from typing import Any, Self

import numpy as np
import torch
from sklearn.base import RegressorMixin

from torch_geometric_tactile._checks import need
from torch_geometric_tactile.predictor import AverageModel, Predictor
from torch_geometric_tactile.training._network_estimator import NetworkEstimator


class NetworkRegressor(RegressorMixin, NetworkEstimator):
    r"""A model of this package as a regressor of scikit-learn, as :class:`NetworkClassifier`.
    Targets are scaled for the training, with the Huber loss.

    Args:
        layout (TaxelLayout or str or PathLike): The taxels: a layout, the name of one that comes
            with the package, or a layout file.
        model (str): Name of a model of :mod:`torch_geometric_tactile.nn.models`.
        arguments (dict, optional): Arguments of the model; sizes that are left out are those of the
            data. In a grid, try several: :obj:`{"arguments": [{}, {"taxel_dropout": 0.0}]}`.
        epochs (int, optional): Epochs; by the number of samples if left out, as the rest of
            :func:`training_recipe`.
        batch_size (int, optional): Number of samples of a batch.
        lr (float, optional): Largest learning rate of AdamW.
        weight_decay (float, optional): Weight decay of AdamW.
        random_state (int or RandomState, optional): Seed of weights and batches.

    Shapes:
        - **x:** readings :math:`(S, N, F)`
        - **y:** numbers :math:`(S,)` or :math:`(S, C)`

    Raises:
        ValueError: If the readings are of other taxels, a target is not finite, or an argument is
            not one of the model.

    Examples:
        >>> x = np.random.default_rng(0).normal(size=(40, 24, 1))
        >>> model = NetworkRegressor("biotac_sp", epochs=2, random_state=0).fit(x, 100 + x[:, 0, 0])
        >>> model.predict(x).shape
        (40,)
    """

    def fit(self, x: Any, y: Any) -> Self:
        r"""Trains the network.

        Args:
            x (array-like): Readings :math:`(S, N, F)`.
            y (array-like): Numbers :math:`(S,)` or :math:`(S, C)`.
        """
        numbers = np.asarray(y, dtype=np.float64)
        need(numbers.ndim in (1, 2), "'y' must be one or several numbers a sample", numbers.shape)
        need(np.isfinite(numbers).all(), "'y' must hold finite numbers only (got others)")
        self.is_one_number_ = numbers.ndim == 1
        center, scale = numbers.mean(axis=0), numbers.std(axis=0)
        scale = np.where(scale > 0, scale, 1.0)
        scaled = ((numbers - center) / scale).astype(np.float32)
        dataset, transform, network = self._train(x, scaled, task="regression", loss="huber")
        back = {"center": torch.as_tensor(center), "scale": torch.as_tensor(scale)}
        model = AverageModel([network], numbers=True, **back)
        self.predictor_ = Predictor.from_dataset(model, dataset, transform, "regression")
        return self

    def predict(self, x: Any) -> np.ndarray:
        r"""Returns the numbers :math:`(S,)` or :math:`(S, C)`, as they were given.

        Args:
            x (array-like): Readings :math:`(S, N, F)`.
        """
        said = self._say(x)
        return said[:, 0] if self.is_one_number_ else said
