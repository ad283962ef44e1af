r"""A network as a classifier of scikit-learn."""

from typing import Any, Self

import numpy as np
from sklearn.base import ClassifierMixin

from torch_geometric_tactile._checks import need
from torch_geometric_tactile.predictor import Predictor
from torch_geometric_tactile.training._network_estimator import NetworkEstimator
from torch_geometric_tactile.training.training_recipe import training_recipe


class NetworkClassifier(ClassifierMixin, NetworkEstimator):
    r"""A model of this package as a classifier of scikit-learn, for
    :class:`~sklearn.model_selection.GridSearchCV` and the like. Readings are scaled, missing ones
    (NaN) filled, and the network is trained as by ``tactile compare``.

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
        - **y:** classes :math:`(S,)`, numbers or names

    Raises:
        ValueError: If the readings are of other taxels, there are fewer than two classes, or an
            argument is not one of the model.

    Examples:
        >>> draw = np.random.default_rng(0)
        >>> x, y = draw.normal(size=(40, 24, 1)), np.arange(40) % 2
        >>> x[y == 1, :12] += 4
        >>> model = NetworkClassifier("biotac_sp", epochs=4, random_state=0).fit(x, y)
        >>> model.predict_proba(x[:3]).shape
        (3, 2)
    """

    def fit(self, x: Any, y: Any) -> Self:
        r"""Trains the network.

        Args:
            x (array-like): Readings :math:`(S, N, F)`.
            y (array-like): Classes :math:`(S,)`.
        """
        labels = np.asarray(y)
        need(labels.ndim == 1, "'y' must be one class a sample", labels.shape)
        self.classes_, codes = np.unique(labels, return_inverse=True)
        need(len(self.classes_) >= 2, "'y' must have at least 2 classes", len(self.classes_))
        dataset, transform, network = self._train(
            x,
            codes,
            class_names=[str(name) for name in self.classes_],
            num_classes=len(self.classes_),
            label_smoothing=training_recipe(len(codes)).label_smoothing,
        )
        self.predictor_ = Predictor.from_dataset(network, dataset, transform)
        return self

    def predict_proba(self, x: Any) -> np.ndarray:
        r"""Returns the probabilities of the classes :math:`(S, C)`.

        Args:
            x (array-like): Readings :math:`(S, N, F)`.
        """
        return self._say(x)

    def predict(self, x: Any) -> np.ndarray:
        r"""Returns the most probable classes :math:`(S,)`.

        Args:
            x (array-like): Readings :math:`(S, N, F)`.
        """
        probability = self.predict_proba(x)
        labels: np.ndarray = self.classes_[probability.argmax(axis=1)]
        return labels
