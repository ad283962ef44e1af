r"""The statistical features of many signals."""

from collections.abc import Sequence
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike
from sklearn.base import TransformerMixin
from sklearn.utils.validation import check_is_fitted

from torch_geometric_tactile.baselines._readings import TakesReadings, check_finite
from torch_geometric_tactile.baselines.features import FEATURE_NAMES, statistical_features


class SignalFeatures(TransformerMixin, TakesReadings):
    r"""Turns time series into the 12 features of each electrode's signal
    (:func:`~torch_geometric_tactile.baselines.statistical_features`), 228 for 19 electrodes, as a
    step of a scikit-learn pipeline.

    Features are ordered electrode by electrode, in each in the order of :obj:`FEATURE_NAMES`;
    :meth:`get_feature_names_out` names them. Nothing is measured but the number of electrodes, so
    that time series may be of any length.

    Shapes:
        - **input:** time series :math:`(S, T, E)`
        - **output:** features :math:`(S, 12 E)`

    Raises:
        ValueError: If the series have another shape, no frame, or other electrodes than those that
            this was fitted on, or a reading is not finite.

    Examples:
        >>> series = np.array([[[3.0, 0.0], [-1.0, 2.0]]])  # 1 sample, 2 frames, 2 electrodes
        >>> features = SignalFeatures().fit_transform(series)
        >>> features.shape, features[0, [0, 1, 12, 13]].tolist()
        ((1, 24), [3.0, -1.0, 2.0, 0.0])
    """

    def fit(self, x: ArrayLike, y: Any = None) -> Self:
        r"""Takes the number of electrodes.

        Args:
            x (array-like): Time series :math:`(S, T, E)`.
            y (array-like, optional): Not used.
        """
        self.n_features_in_ = _series(x).shape[2]
        return self

    def transform(self, x: ArrayLike) -> np.ndarray:
        r"""Returns the features.

        Args:
            x (array-like): Time series :math:`(S, T, E)`.
        """
        check_is_fitted(self)
        values = _series(x)
        if values.shape[2] != self.n_features_in_:
            raise ValueError(
                f"'x' must have {self.n_features_in_} electrodes, as {type(self).__name__} was "
                f"fitted on (got shape {values.shape})"
            )
        # Sums over what is contiguous are rounded alike, however the series came.
        features = statistical_features(np.ascontiguousarray(values.transpose(0, 2, 1)))
        return features.reshape(len(values), features.shape[1] * features.shape[2])

    def get_feature_names_out(self, input_features: Sequence[str] | None = None) -> np.ndarray:
        r"""Returns the names of the features, such as :obj:`"electrode0_maximum"`.

        Args:
            input_features (sequence of str, optional): Names of the electrodes :math:`(E,)`.

        Raises:
            ValueError: If there are other than :math:`E` names.
        """
        check_is_fitted(self)
        electrodes = input_features
        if electrodes is None:
            electrodes = [f"electrode{i}" for i in range(self.n_features_in_)]
        if len(electrodes) != self.n_features_in_:
            raise ValueError(
                f"'input_features' must have {self.n_features_in_} names, one an electrode (got "
                f"{len(electrodes)})"
            )
        names = [f"{electrode}_{name}" for electrode in electrodes for name in FEATURE_NAMES]
        return np.asarray(names, dtype=object)


def _series(x: ArrayLike) -> np.ndarray:
    values = np.asarray(x, dtype=np.float64)
    if values.ndim != 3 or 0 in values.shape[1:]:
        raise ValueError(
            "'x' must have shape (num_samples, num_frames, num_electrodes), with at least one "
            f"frame and electrode (got {values.shape})"
        )
    check_finite(values, "x")
    return values
