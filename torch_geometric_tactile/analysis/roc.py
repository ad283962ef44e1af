r"""Receiver operating characteristic (ROC) curves of classes or labels."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from sklearn.metrics import roc_auc_score, roc_curve
from torch import Tensor

from torch_geometric_tactile._checks import need

MACRO = "mean of all"


class RocCurve(NamedTuple):
    r"""A receiver operating characteristic (ROC) curve. Plot it with
    :func:`~torch_geometric_tactile.visualization.plot_roc`.

    Args:
        fpr (numpy.ndarray): False positive rates :math:`(P,)`, in ascending order.
        tpr (numpy.ndarray): True positive rates :math:`(P,)`.
        auc (float): Area under the curve.

    Examples:
        >>> import numpy as np
        >>> curve = RocCurve(fpr=np.array([0.0, 0.0, 1.0]), tpr=np.array([0.0, 1.0, 1.0]), auc=1.0)
        >>> curve.auc
        1.0
    """

    fpr: np.ndarray
    tpr: np.ndarray
    auc: float


def roc_curves(y: Tensor, score: Tensor, names: Sequence[str]) -> dict[str, RocCurve]:
    r"""Returns the ROC curve of each class against all other classes, or of each label, and the
    mean curve.

    The last curve, :obj:`"mean of all"`, holds the mean true positive rate at each false positive
    rate, and the mean of the areas (the macro average). There is no curve for a class that has no
    samples or all samples.

    Args:
        y (torch.Tensor): The true classes, or the true labels (0 or 1).
        score (torch.Tensor): Logits or probabilities.
        names (sequence of str): Names of the :math:`C` classes or labels.

    Shapes:
        - **y:** classes :math:`(S,)` or labels :math:`(S, C)`
        - **score:** :math:`(S, C)`

    Raises:
        ValueError: If a shape does not match, a score is not finite, two names are equal, or each
            class has either no samples or all samples.

    Examples:
        >>> import torch
        >>> score = torch.tensor([[0.9, 0.1], [0.2, 0.8], [0.6, 0.4]])
        >>> curves = roc_curves(torch.tensor([0, 1, 0]), score, ["cup", "ball"])
        >>> {name: curve.auc for name, curve in curves.items()}
        {'cup': 1.0, 'ball': 1.0, 'mean of all': 1.0}
    """
    truth, scores = y.detach().cpu().numpy(), score.detach().cpu().double().numpy()
    num_classes = len(names)
    if scores.ndim != 2 or scores.shape[1] != num_classes:
        raise ValueError(
            f"'score' must have shape (num_samples, {num_classes}), one column for each name "
            f"(got {scores.shape})"
        )
    if truth.shape not in (scores.shape[:1], scores.shape):
        raise ValueError(
            f"'y' must have shape {scores.shape[:1]} or {scores.shape} (got {truth.shape})"
        )
    need(np.isfinite(scores).all(), "'score' must hold finite numbers only (got NaN or infinity)")
    if len(set(names)) < num_classes or MACRO in names:
        raise ValueError(f"'names' must differ from each other and from '{MACRO}' (got {names})")
    if truth.ndim == 1:
        truth = truth[:, None] == np.arange(num_classes)
    curves = {}
    for i, name in enumerate(names):
        if len(np.unique(truth[:, i])) == 2:
            fpr, tpr, _ = roc_curve(truth[:, i], scores[:, i])
            curves[name] = RocCurve(fpr, tpr, float(roc_auc_score(truth[:, i], scores[:, i])))
    need(curves, "'y' must have samples with and without a class (got one kind only)")
    grid = np.unique(np.concatenate([curve.fpr for curve in curves.values()]))
    # Includes each rate and the number just below it, so that vertical steps stay vertical.
    grid = np.stack([np.nextafter(grid, -1.0), grid], axis=1).ravel()
    mean = np.mean([np.interp(grid, curve.fpr, curve.tpr) for curve in curves.values()], axis=0)
    area = float(np.mean([curve.auc for curve in curves.values()]))
    curves[MACRO] = RocCurve(np.maximum(grid, 0.0), mean, area)
    return curves
