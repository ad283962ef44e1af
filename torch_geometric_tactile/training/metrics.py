r"""The metrics of a model. The names have the same meaning in logs and tables.

============================  ==============================================================
Name                          Meaning
============================  ==============================================================
``accuracy``                  Fraction of the samples with the correct class, or with all
                              labels correct (exact match).
``f1``                        Mean F1 score of the classes or labels (macro).
``f1_positive``               F1 score of class 1, the positive class (two classes only).
``precision_positive``        Precision of class 1 (two classes only).
``recall_positive``           Recall of class 1 (two classes only).
``auroc``                     Mean area under the ROC curve of each class against all others, or
                              of each label (macro).
``label_accuracy``            Mean over the labels of ``label_accuracy_<label>``.
``label_accuracy_<label>``    Fraction of the samples for which the label with this name or
                              number is correct.
``mae``, ``rmse``             Mean absolute error and root mean squared error over all numbers of
                              all samples.
``r2``                        Coefficient of determination, mean over the targets.
``accuracy_<session>``        Accuracy on one recording session (``mae_<session>`` for regression).
============================  ==============================================================
"""

import numpy as np
import torch
from torch import Tensor

from torch_geometric_tactile.training._collected_metrics import (
    Task,
    f1_scores,
    macro_auroc,
    make_metrics,
    positives,
    predicted_classes,
    read_metrics,
)


def classification_metrics(
    score: Tensor | np.ndarray,
    y: Tensor | np.ndarray,
    task: Task = "multiclass",
    threshold: float | None = None,
) -> dict[str, float]:
    r"""Returns the metrics of predicted classes or labels by name.

    The predicted class has the highest score. With a :obj:`threshold`, class 1 is predicted if its
    score is above the threshold. With :obj:`task="multilabel"`, every label with a score above 0.5
    is predicted. The metrics are:

    * :obj:`accuracy`: the fraction of the samples with the correct class, or with all labels
      correct (exact match).
    * :obj:`label_accuracy_0`, :obj:`label_accuracy_1`, ... and :obj:`label_accuracy` (multi-label
      only): the fraction of the samples for which one label is correct, and the mean over the
      labels.
    * :obj:`f1`: the mean F1 score of the classes or labels (macro). Classes that are neither in
      :obj:`y` nor predicted are left out. NaN if none is left.
    * :obj:`f1_positive`, :obj:`precision_positive` and :obj:`recall_positive` (two classes only):
      the F1 score, precision and recall of class 1. Zero if the denominator is zero, as in
      scikit-learn.
    * :obj:`auroc`: the mean area under the ROC curve of each class against all others, or of each
      label. Classes that no sample or every sample has are left out, because they have no curve.
      NaN if none is left.

    Args:
        score (torch.Tensor or numpy.ndarray): Probabilities.
        y (torch.Tensor or numpy.ndarray): The true classes, or 0 and 1 for each label.
        task (str): :obj:`"multiclass"` or :obj:`"multilabel"`.
        threshold (float, optional): For two classes, the probability above which class 1 is
            predicted. Defaults to one half.

    Shapes:
        - **score:** :math:`(S, C)`
        - **y:** :math:`(S,)`, or :math:`(S, C)` for :obj:`"multilabel"`

    Raises:
        ValueError: If :obj:`task` is unknown, if there are no samples, if a score is NaN, or if
            :obj:`y` does not fit :obj:`score`.

    Examples:
        >>> score = torch.tensor([[0.9, 0.2], [0.4, 0.8], [0.3, 0.6]])
        >>> y = torch.tensor([[1, 0], [1, 1], [0, 1]])
        >>> values = classification_metrics(score, y, task="multilabel")
        >>> {name: round(value, 3) for name, value in values.items()}
        {'accuracy': 0.667, 'label_accuracy': 0.833, 'label_accuracy_0': 0.667,
         'label_accuracy_1': 1.0, 'f1': 0.833, 'auroc': 1.0}
    """
    score, y = torch.as_tensor(score).detach(), torch.as_tensor(y)
    if task not in ("multiclass", "multilabel"):
        raise ValueError(f"'task' must be one of ['multiclass', 'multilabel'] (got '{task}')")
    if score.dim() != 2 or 0 in score.shape:
        raise ValueError(
            f"'score' must have shape (num_samples, num_classes), both positive (got "
            f"{tuple(score.shape)})"
        )
    nan_samples = score.isnan().any(dim=1).nonzero().view(-1)
    if len(nan_samples):  # argmax of a row with NaN is meaningless
        raise ValueError(
            f"'score' must not be NaN (got NaN for {len(nan_samples)} of {len(score)} samples; the "
            f"first is {int(nan_samples[0])}); leave them out, or fill missing readings with "
            "FillMissing()"
        )
    num_classes = score.size(1)
    expected = score.shape if task == "multilabel" else score.shape[:1]
    if y.shape != expected:
        raise ValueError(
            f"'y' must have shape {tuple(expected)} for task '{task}' (got {tuple(y.shape)})"
        )
    max_label = 1 if task == "multilabel" else num_classes - 1
    if y.min() < 0 or y.max() > max_label:
        raise ValueError(
            f"'y' must be between 0 and {max_label} (got {y.min().item()} to {y.max().item()})"
        )
    prediction = score if task == "multilabel" else predicted_classes(score, threshold)
    positive, predicted = positives(y, num_classes), positives(prediction, num_classes)
    is_correct = positive == predicted
    values = {"accuracy": is_correct.all(dim=1)}
    if task == "multilabel":
        values["label_accuracy"] = is_correct
        values |= {f"label_accuracy_{i}": is_correct[:, i] for i in range(num_classes)}
    counts = (positive & predicted, ~positive & predicted, positive & ~predicted)
    f1 = f1_scores([count.sum(0) for count in counts], task)
    return {
        **{name: float(value.double().mean()) for name, value in values.items()},
        **{name: float(value) for name, value in f1.items()},
        "auroc": float(macro_auroc(score, positive)),
    }


def regression_metrics(prediction: Tensor | np.ndarray, y: Tensor | np.ndarray) -> dict[str, float]:
    r"""Returns the metrics of predicted numbers by name.

    The metrics are:

    * :obj:`mae`: the mean absolute error over all numbers.
    * :obj:`rmse`: the root mean squared error over all numbers.
    * :obj:`r2`: the coefficient of determination, averaged over the targets. NaN for a single
      sample.

    Args:
        prediction (torch.Tensor or numpy.ndarray): The predicted numbers.
        y (torch.Tensor or numpy.ndarray): The true numbers.

    Shapes:
        - **input:** :math:`(S, C)` or :math:`(S,)` each

    Raises:
        ValueError: If there are no samples, or the shapes differ.

    Examples:
        >>> values = regression_metrics(np.array([1.0, 2.0, 4.0]), np.array([1.0, 2.0, 3.0]))
        >>> {name: round(value, 3) for name, value in values.items()}
        {'mae': 0.333, 'rmse': 0.577, 'r2': 0.5}
    """
    prediction, y = torch.as_tensor(prediction).detach(), torch.as_tensor(y)
    prediction, y = (value.view(-1, 1) if value.dim() == 1 else value for value in (prediction, y))
    if prediction.dim() != 2 or 0 in prediction.shape or prediction.shape != y.shape:
        raise ValueError(
            "'prediction' and 'y' must have the same shape, (S,) or (S, C), both positive (got "
            f"{tuple(prediction.shape)} and {tuple(y.shape)})"
        )
    metrics = make_metrics(y.size(1), "regression").to(y.device)
    metrics.update(prediction.double(), y.double())
    return {name: float(value) for name, value in read_metrics(metrics).items()}
