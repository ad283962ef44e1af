r"""Temperature scaling, which converts the scores of a classifier to probabilities."""

from typing import Any, Self

import numpy as np
from scipy.optimize import minimize_scalar
from scipy.special import log_softmax, softmax
from sklearn.base import BaseEstimator, ClassifierMixin, MetaEstimatorMixin, clone
from sklearn.model_selection import StratifiedGroupKFold, StratifiedKFold
from sklearn.utils.validation import check_is_fitted

from torch_geometric_tactile._checks import need

_LOG_FACTOR_RANGE = (-7.0, 7.0)


class TemperatureScaling(MetaEstimatorMixin, ClassifierMixin, BaseEstimator):
    r"""Adds probabilities to a classifier that returns scores, such as a support vector machine. It
    uses the temperature scaling from the `"On Calibration of Modern Neural Networks"
    <https://arxiv.org/abs/1706.04599>`_ paper:

    .. math::
        \mathbf{p} = \mathrm{softmax}(a \, \mathbf{s})

    Here, :math:`\mathbf{s}` is the vector of class scores, which is :math:`(0, s)` for two classes.
    The factor :math:`a` is fitted to the scores of held-out samples by cross-validation. The labels
    of these samples are smoothed as in Platt's method, so that :math:`a` stays finite.

    The class with the highest score is also the most probable class. Unlike
    :class:`sklearn.calibration.CalibratedClassifierCV` with sigmoids, the scaling therefore does
    not move decision boundaries, and preserves the effect of class weights. Ties between the votes
    of one-against-one classifiers are broken by the scores, as with :obj:`SVC(break_ties=True)`.

    Args:
        estimator (estimator): A classifier with :meth:`decision_function`.
        folds (int): Number of cross-validation folds. Fewer folds are used if a class has fewer
            samples.

    Raises:
        ValueError: If :obj:`folds` is below two, or there are fewer than two classes.

    Examples:
        >>> from sklearn.svm import SVC
        >>> x = np.arange(12.0).reshape(-1, 1)
        >>> model = TemperatureScaling(SVC()).fit(x, [0] * 6 + [1] * 6)
        >>> model.predict([[1.0], [10.0]]).tolist()
        [0, 1]
        >>> bool(model.predict_proba([[10.0]])[0, 1] > 0.7)
        True
    """

    def __init__(self, estimator: Any, folds: int = 5) -> None:
        self.estimator = estimator
        self.folds = folds

    def fit(self, x: Any, y: Any, groups: Any = None) -> Self:
        r"""Fits the factor on held-out samples, then fits the classifier on all samples.

        Args:
            x (array-like): Features :math:`(S, F)`.
            y (array-like): Classes :math:`(S,)`.
            groups (array-like, optional): Groups :math:`(S,)`, such as trials. Samples of one group
                are held out together.
        """
        need(self.folds >= 2, "'folds' must be at least 2", self.folds)
        x, y = np.asarray(x), np.asarray(y)
        self.classes_, codes = np.unique(y, return_inverse=True)
        need(len(self.classes_) >= 2, "'y' must have at least 2 classes", len(self.classes_))
        scores, held_out_codes = [], []
        for train, test in self._splits(x, codes, groups):
            if len(np.unique(codes[train])) < len(self.classes_) or not len(test):
                continue
            model = clone(self.estimator).fit(x[train], y[train])
            scores.append(_as_columns(model.decision_function(x[test])))
            held_out_codes.append(codes[test])
        # If no fold is usable, the probabilities are the softmax of the unscaled scores.
        self.factor_ = (
            _fit_factor(np.concatenate(scores), np.concatenate(held_out_codes)) if scores else 1.0
        )
        self.estimator_ = clone(self.estimator).fit(x, y)
        return self

    def _splits(self, x: np.ndarray, codes: np.ndarray, groups: Any) -> Any:
        # Every class needs at least one sample or group in each fold.
        num_folds = min(self.folds, int(np.bincount(codes).min()))
        if groups is not None:
            groups_per_class = [
                len(np.unique(np.asarray(groups)[codes == code])) for code in np.unique(codes)
            ]
            num_folds = min(num_folds, *groups_per_class)
        if num_folds < 2:
            return []
        if groups is None:
            return StratifiedKFold(num_folds, shuffle=True, random_state=0).split(x, codes)
        group_folds = StratifiedGroupKFold(num_folds, shuffle=True, random_state=0)
        return group_folds.split(x, codes, groups)

    def predict_proba(self, x: Any) -> np.ndarray:
        r"""Returns the probabilities of the classes :math:`(S, C)`.

        Args:
            x (array-like): Features :math:`(S, F)`.
        """
        check_is_fitted(self)
        scores = _as_columns(self.estimator_.decision_function(x))
        probability: np.ndarray = softmax(self.factor_ * scores, axis=1)
        return probability

    def predict(self, x: Any) -> np.ndarray:
        r"""Returns the most probable classes :math:`(S,)`.

        Args:
            x (array-like): Features :math:`(S, F)`.
        """
        probability = self.predict_proba(x)
        labels: np.ndarray = self.classes_[probability.argmax(axis=1)]
        return labels


def _as_columns(scores: np.ndarray) -> np.ndarray:
    # Returns scores (S, C). For two classes, scikit-learn returns one column (S,).
    return scores if scores.ndim == 2 else np.stack([np.zeros_like(scores), scores], axis=1)


def _fit_factor(scores: np.ndarray, codes: np.ndarray) -> float:
    # Returns the factor that minimises the cross-entropy with smoothed labels.
    rows, num_classes = np.arange(len(codes)), scores.shape[1]
    smoothing = 1.0 / (len(codes) + 2)

    def smoothed_cross_entropy(log_factor: float) -> float:
        log_likelihood = log_softmax(np.exp(log_factor) * scores, axis=1)
        class_mean = log_likelihood.sum(axis=1) / num_classes
        target = (1 - smoothing) * log_likelihood[rows, codes] + smoothing * class_mean
        return float(-target.mean())

    optimum = minimize_scalar(smoothed_cross_entropy, bounds=_LOG_FACTOR_RANGE, method="bounded")
    return float(np.exp(optimum.x))
