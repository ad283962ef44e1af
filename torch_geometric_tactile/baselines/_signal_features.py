r"""Statistical features of time series as a step of a pipeline."""

from collections.abc import Sequence
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike
from sklearn.base import TransformerMixin
from sklearn.utils.validation import check_is_fitted

from torch_geometric_tactile.baselines._features import FEATURE_NAMES, statistical_features
from torch_geometric_tactile.baselines._readings import ReadingsEstimator, check_finite


class SignalFeatures(TransformerMixin, ReadingsEstimator):
    r"""Converts time series to the 12 statistical features of each electrode's signal
    (:obj:`statistical_features`), which makes 228 features for 19 electrodes. Use it as a step of a
    scikit-learn pipeline.

    Features are ordered by electrode, then as in :obj:`FEATURE_NAMES`.
    :meth:`get_feature_names_out` returns their names. :meth:`fit` fixes only the number of
    electrodes. Time series may have any length.

    Shapes:
        - **input:** time series :math:`(S, T, E)`
        - **output:** features :math:`(S, 12 E)`

    Raises:
        ValueError: If the time series have the wrong shape, have no frame or do not have as many
            electrodes as in :meth:`fit`, or if a reading is not finite.

    Examples:
        >>> series = np.array([[[3.0, 0.0], [-1.0, 2.0]]])  # 1 sample, 2 frames, 2 electrodes
        >>> features = SignalFeatures().fit_transform(series)
        >>> features.shape, features[0, [0, 1, 12, 13]].tolist()
        ((1, 24), [3.0, -1.0, 2.0, 0.0])
    """

    def fit(self, x: ArrayLike, y: Any = None) -> Self:
        r"""Stores the number of electrodes.

        Args:
            x (array-like): Time series :math:`(S, T, E)`.
            y (array-like, optional): Not used.
        """
        self.n_features_in_ = _checked_series(x).shape[2]
        return self

    def transform(self, x: ArrayLike) -> np.ndarray:
        r"""Returns the features :math:`(S, 12 E)`.

        Args:
            x (array-like): Time series :math:`(S, T, E)`.
        """
        check_is_fitted(self)
        values = _checked_series(x)
        if values.shape[2] != self.n_features_in_:
            raise ValueError(
                f"'x' must have {self.n_features_in_} electrodes, like the data that "
                f"{type(self).__name__} was fitted on (got shape {values.shape})"
            )
        # The order of summation depends on the memory layout. A contiguous copy makes the rounding,
        # and thus the features, independent of the strides of the input.
        features = statistical_features(np.ascontiguousarray(values.transpose(0, 2, 1)))
        return features.reshape(len(values), features.shape[1] * features.shape[2])

    def get_feature_names_out(self, input_features: Sequence[str] | None = None) -> np.ndarray:
        r"""Returns the names of the features, such as :obj:`"electrode0_maximum"`.

        Args:
            input_features (sequence of str, optional): Names of the electrodes :math:`(E,)`.

        Raises:
            ValueError: If the number of names is not :math:`E`.
        """
        check_is_fitted(self)
        electrodes = input_features
        if electrodes is None:
            electrodes = [f"electrode{i}" for i in range(self.n_features_in_)]
        if len(electrodes) != self.n_features_in_:
            raise ValueError(
                f"'input_features' must have {self.n_features_in_} names, one per electrode (got "
                f"{len(electrodes)})"
            )
        names = [f"{electrode}_{name}" for electrode in electrodes for name in FEATURE_NAMES]
        return np.asarray(names, dtype=object)


def _checked_series(x: ArrayLike) -> np.ndarray:
    values = np.asarray(x, dtype=np.float64)
    if values.ndim != 3 or 0 in values.shape[1:]:
        raise ValueError(
            "'x' must have shape (num_samples, num_frames, num_electrodes), with at least one "
            f"frame and electrode (got {values.shape})"
        )
    check_finite(values, "x")
    return values
