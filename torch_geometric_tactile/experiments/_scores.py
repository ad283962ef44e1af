r"""Scores of predictions, their names and number formats, and the rule for differences."""

import math

import numpy as np
from sklearn.metrics import accuracy_score, precision_recall_fscore_support

from torch_geometric_tactile.training.metrics import regression_metrics

NAMES = {
    "accuracy": "accuracy",
    "balanced_accuracy": "balanced accuracy",
    "f1": "macro F1",
    "mae": "MAE",
    "rmse": "RMSE",
    "r2": "R2",
}
PERCENT = ("accuracy", "balanced_accuracy", "f1")
MIN_PAIRS = 3  # with fewer splits or units, a standard error is too uncertain for a verdict
RULE = (
    "A difference is beyond the noise if it is larger than both standard errors times Student's t "
    "(two-sided, 5 %). The error over the splits is corrected for overlapping training sets "
    "(Nadeau and Bengio, 2003). Seeds with the same test part count as one split: their mean is "
    "compared with the error over the units and the seeds together. There is no verdict with fewer "
    f"than {MIN_PAIRS} splits (unless all share one given test part) or with fewer than "
    f"{MIN_PAIRS} units. Units are the trials, persons or objects that are new in the test parts."
)


def prediction_scores(
    y: np.ndarray, prediction: np.ndarray, is_regression: bool
) -> dict[str, float]:
    r"""Returns the scores of predictions. For classes, these are :obj:`accuracy`,
    :obj:`balanced_accuracy` (the mean recall of the classes in :obj:`y`) and :obj:`f1` (macro). For
    numbers, these are :obj:`mae`, :obj:`rmse` and :obj:`r2`.

    Examples:
        >>> prediction_scores(np.array([0, 0, 0, 1]), np.array([0, 0, 0, 0]), is_regression=False)
        {'accuracy': 0.75, 'balanced_accuracy': 0.5, 'f1': 0.42857142857142855}

    Shapes:
        - **y:** Classes :math:`(S,)`, or numbers :math:`(S,)` or :math:`(S, C)`.
    """
    if is_regression:
        return regression_metrics(np.ascontiguousarray(prediction).reshape(y.shape), y)
    _, recall, f1, support = precision_recall_fscore_support(y, prediction, zero_division=0.0)
    return {
        "accuracy": float(accuracy_score(y, prediction)),
        "balanced_accuracy": float(recall[support > 0].mean()),
        "f1": float(f1.mean()),
    }


def sample_scores(y: np.ndarray, prediction: np.ndarray, metric: str) -> np.ndarray:
    r"""Returns the contribution of each sample to a score :math:`(S,)`. The mean of the
    contributions is the score.

    Examples:
        >>> sample_scores(np.array([0, 0, 0, 1]), np.array([0, 0, 1, 1]), "balanced_accuracy")
        array([0.66666667, 0.66666667, 0.        , 2.        ])

    Shapes:
        - **y:** Classes :math:`(S,)`, labels :math:`(S, C)` (a sample is correct if all its labels
          are), or numbers :math:`(S,)` or :math:`(S, C)`.
    """
    if metric == "mae":
        error = np.abs(prediction.reshape(y.shape).astype(np.float64) - y)
        return error.reshape(len(y), -1).mean(axis=1)
    is_correct = (y == prediction).reshape(len(y), -1).all(axis=1).astype(np.float64)
    if metric == "accuracy":
        return is_correct
    _, class_index, counts = np.unique(y, return_inverse=True, return_counts=True)
    return is_correct * len(y) / (len(counts) * counts[class_index])


def format_score(metric: str, value: float) -> str:
    r"""Returns a score as text: accuracies and F1 scores in percent, errors with three digits.

    Examples:
        >>> format_score("accuracy", 0.918), format_score("mae", 0.00435)
        ('91.8', '0.00435')
    """
    if math.isnan(value):
        return "?"
    text = f"{100 * value:.1f}" if metric in PERCENT else f"{value:.3g}"
    return text.removeprefix("-") if not float(text) else text  # not "-0.0"
