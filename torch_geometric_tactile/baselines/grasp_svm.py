r"""A support vector machine on statistical features of the electrodes' signals."""

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import ArrayLike
from sklearn.base import ClassifierMixin
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler
from sklearn.svm import SVC
from sklearn.utils.validation import check_is_fitted

from torch_geometric_tactile._checks import need
from torch_geometric_tactile.baselines._readings import ReadingsEstimator, check_finite
from torch_geometric_tactile.baselines._signal_features import SignalFeatures


@dataclass(repr=False, eq=False)
class GraspSVM(ClassifierMixin, ReadingsEstimator):
    r"""The SVM baseline from the "Tactile Grasp Stability Classification Based on Graph
    Convolutional Networks" paper. It uses 12 statistical features of each electrode's signal, which
    makes 228 features for 19 electrodes.

    For static readings, which have only one frame, the readings themselves are the features.
    Features are standardised on the training set. They are ordered by electrode, then by finger,
    then as in :obj:`SignalFeatures`. The paper does not state the kernel or the penalty; the
    defaults are scikit-learn's.

    Args:
        num_fingers (int): Number of fingers :math:`K`, whose signals are concatenated.
        finger (int, optional): Index of the finger to use (SVM-L, -M, -R). By default, all fingers
            are used (SVM-F).
        C (float): Penalty for errors.
        kernel (str): Kernel of :class:`sklearn.svm.SVC`.
        class_weight (dict or str, optional): Weights of the classes, as in
            :class:`sklearn.svm.SVC`. :obj:`"balanced"` gives rare classes the same total weight as
            common ones.

    Shapes:
        - **input:** readings :math:`(S, N, K \cdot T)` with :math:`T` frames per finger
        - **output:** predicted labels :math:`(S,)`

    Raises:
        ValueError: If the readings have the wrong shape or are not finite, :obj:`num_fingers` is
            below one, or :obj:`finger` is out of range.

    Examples:
        >>> x = np.array([0.0, 1.0, 9.0, 10.0]).reshape(4, 1, 1)
        >>> GraspSVM(num_fingers=1).fit(x, [0, 0, 1, 1]).predict(x)
        array([0, 0, 1, 1])
    """

    num_fingers: int = 3
    finger: int | None = None
    C: float = 1.0
    kernel: str = "rbf"
    class_weight: dict[int, float] | str | None = None

    def features(self, x: ArrayLike) -> np.ndarray:
        r"""Returns the features on which the support vector machine is fitted.

        Args:
            x (array-like): Readings :math:`(S, N, K \cdot T)`.

        Shapes:
            - **output:** :math:`(S, 12 K N)` for time series, :math:`(S, K N)` for static readings
        """
        need(self.num_fingers >= 1, "'num_fingers' must be at least 1", self.num_fingers)
        x = np.asarray(x, dtype=np.float64)
        if x.ndim != 3 or x.shape[2] == 0 or x.shape[2] % self.num_fingers:
            raise ValueError(
                f"'x' must have shape (num_samples, num_taxels, {self.num_fingers} fingers x "
                f"frames) (got {x.shape})"
            )
        check_finite(x, "x")
        num_frames = x.shape[2] // self.num_fingers
        signal = x.reshape(*x.shape[:2], self.num_fingers, num_frames)
        if self.finger is not None:
            if not 0 <= self.finger < self.num_fingers:
                raise ValueError(
                    f"'finger' must be between 0 and {self.num_fingers - 1} (got {self.finger})"
                )
            signal = signal[:, :, [self.finger]]
        series = signal.transpose(0, 3, 1, 2)
        series = series.reshape(len(x), num_frames, signal.shape[1] * signal.shape[2])
        if num_frames == 1:
            return series[:, 0]
        features: np.ndarray = SignalFeatures().fit_transform(series)
        return features

    def fit(self, x: ArrayLike, y: ArrayLike) -> Self:
        r"""Fits the support vector machine.

        Args:
            x (array-like): Readings :math:`(S, N, K \cdot T)`.
            y (array-like): Labels :math:`(S,)`.
        """
        labels = np.asarray(y)
        self.pipeline_ = make_pipeline(
            StandardScaler(), SVC(C=self.C, kernel=self.kernel, class_weight=self.class_weight)
        )
        self.pipeline_.fit(self.features(x), labels)
        self.classes_ = self.pipeline_.classes_
        return self

    def predict(self, x: ArrayLike) -> np.ndarray:
        r"""Returns the predicted labels.

        Args:
            x (array-like): Readings :math:`(S, N, K \cdot T)`.
        """
        check_is_fitted(self)
        labels: np.ndarray = self.pipeline_.predict(self.features(x))
        return labels

    def decision_function(self, x: ArrayLike) -> np.ndarray:
        r"""Returns the signed distances from the decision boundary, for example for a ROC curve.

        Args:
            x (array-like): Readings :math:`(S, N, K \cdot T)`.
        """
        check_is_fitted(self)
        scores: np.ndarray = self.pipeline_.decision_function(self.features(x))
        return scores
