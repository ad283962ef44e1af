r"""The readings of a sample as one row of features."""

from typing import Any, Self

import numpy as np
from sklearn.base import TransformerMixin
from sklearn.utils import Tags

from torch_geometric_tactile.baselines._readings import ReadingsEstimator, readings


class FlatReadings(TransformerMixin, ReadingsEstimator):
    r"""Flattens the readings of all taxels of a sample to one row. Use it as the first step of a
    scikit-learn pipeline. Missing readings (NaN) become zero, which is the mean of standardised
    readings.

    Shapes:
        - **input:** readings :math:`(S, N, F)`, or samples
        - **output:** rows :math:`(S, N \cdot F)`

    Examples:
        >>> FlatReadings().fit_transform(np.array([[[1.0, np.nan], [3.0, 4.0]]]))
        array([[1., 0., 3., 4.]])
    """

    takes_samples = True
    _allows_nan = True

    def __sklearn_tags__(self) -> Tags:
        tags = super().__sklearn_tags__()
        tags.requires_fit = False
        return tags

    def fit(self, x: Any, y: Any = None) -> Self:
        r"""Returns the transformer unchanged, since it has no parameters to fit.

        Args:
            x (array-like or StaticData): Readings :math:`(S, N, F)`.
            y (array-like, optional): Not used.
        """
        return self

    def transform(self, x: Any) -> np.ndarray:
        r"""Returns one row of readings for each sample :math:`(S, N \cdot F)`.

        Args:
            x (array-like or StaticData): Readings :math:`(S, N, F)`.
        """
        values = readings(x)
        return np.nan_to_num(values.reshape(len(values), -1), nan=0.0)
