r"""Probabilities of classifiers that give scores only."""

from typing import Any, Self

import numpy as np
from scipy.optimize import minimize_scalar
from scipy.special import log_softmax, softmax
from sklearn.base import BaseEstimator, ClassifierMixin, MetaEstimatorMixin, clone
from sklearn.model_selection import StratifiedGroupKFold, StratifiedKFold
from sklearn.utils.validation import check_is_fitted

from torch_geometric_tactile._checks import need

_RANGE = (-7.0, 7.0)  # of the logarithm of the factor


class TemperatureScaling(MetaEstimatorMixin, ClassifierMixin, BaseEstimator):
    r"""Gives a classifier with scores, such as a support vector machine, probabilities, by the
    temperature scaling of the `"On Calibration of Modern Neural Networks"
    <https://arxiv.org/abs/1706.04599>`_ paper:

    .. math::
        \mathbf{p} = \mathrm{softmax}(a \, \mathbf{s})

    of the scores :math:`\mathbf{s}` (of two classes, of :math:`(0, s)`). The one factor :math:`a`
    is fitted to scores of samples that are held out in turn, with labels that are smoothed as in
    Platt's method, so that it stays finite. The most probable class is the one with the highest
    score: other than :class:`sklearn.calibration.CalibratedClassifierCV` with sigmoids, this moves
    no boundary, also not that of balanced classes. Votes of one-against-one that are level are
    decided by the scores, as by :obj:`SVC(break_ties=True)`.

    Args:
        estimator (estimator): A classifier with :meth:`decision_function`.
        folds (int): Number of folds that are held out; fewer if a class has fewer samples.

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
        r"""Fits the factor on held-out samples, and then the classifier on all.

        Args:
            x (array-like): Features :math:`(S, F)`.
            y (array-like): Classes :math:`(S,)`.
            groups (array-like, optional): Samples of one group, such as a trial, are held out
                together :math:`(S,)`.
        """
        need(self.folds >= 2, "'folds' must be at least 2", self.folds)
        x, y = np.asarray(x), np.asarray(y)
        self.classes_, codes = np.unique(y, return_inverse=True)
        need(len(self.classes_) >= 2, "'y' must have at least 2 classes", len(self.classes_))
        scores, held_out = [], []
        for train, test in self._splits(x, codes, groups):
            if len(np.unique(codes[train])) < len(self.classes_) or not len(test):
                continue
            model = clone(self.estimator).fit(x[train], y[train])
            scores.append(_as_columns(model.decision_function(x[test])))
            held_out.append(codes[test])
        self.factor_ = _fitted(np.concatenate(scores), np.concatenate(held_out)) if scores else 1.0
        self.estimator_ = clone(self.estimator).fit(x, y)
        return self

    def _splits(self, x: np.ndarray, codes: np.ndarray, groups: Any) -> Any:
        folds = min(self.folds, int(np.bincount(codes).min()))
        if groups is not None:
            of_class = [len(np.unique(np.asarray(groups)[codes == c])) for c in np.unique(codes)]
            folds = min(folds, *of_class)
        if folds < 2:
            return []
        if groups is None:
            return StratifiedKFold(folds, shuffle=True, random_state=0).split(x, codes)
        grouped = StratifiedGroupKFold(folds, shuffle=True, random_state=0)
        return grouped.split(x, codes, groups)

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
    # One column a class (S, C), also of two.
    return scores if scores.ndim == 2 else np.stack([np.zeros_like(scores), scores], axis=1)


def _fitted(scores: np.ndarray, codes: np.ndarray) -> float:
    rows, num_classes = np.arange(len(codes)), scores.shape[1]
    smoothed = 1.0 / (len(codes) + 2)

    def loss(log_factor: float) -> float:
        likelihood = log_softmax(np.exp(log_factor) * scores, axis=1)
        mean_of_all = likelihood.sum(axis=1) / num_classes
        target = (1 - smoothed) * likelihood[rows, codes] + smoothed * mean_of_all
        return float(-target.mean())

    found = minimize_scalar(loss, bounds=_RANGE, method="bounded")
    return float(np.exp(found.x))
