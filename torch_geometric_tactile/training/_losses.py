r"""The loss functions of the tasks."""

from collections.abc import Callable, Sequence
from typing import Literal

import torch
import torch.nn.functional as F
from torch import Tensor

from torch_geometric_tactile.training._collected_metrics import Task

RegressionLoss = Literal["mse", "l1", "huber"]
ClassWeights = Sequence[float] | Literal["balanced"]

_REGRESSION: dict[str, Callable[[Tensor, Tensor], Tensor]] = {
    "mse": F.mse_loss,
    "l1": F.l1_loss,
    "huber": F.huber_loss,
}


def check_loss(
    task: Task,
    loss: str | None,
    class_weights: ClassWeights | None,
    label_smoothing: float,
) -> None:
    r"""Checks that the settings of a loss fit its task."""
    if loss is not None and (task != "regression" or loss not in _REGRESSION):
        raise ValueError(
            f"'loss' must be one of {list(_REGRESSION)} for task='regression', and left out for "
            f"other tasks (got '{loss}' for task='{task}')"
        )
    if not 0 <= label_smoothing < 1:
        raise ValueError(
            f"'label_smoothing' must be at least 0 and below 1 (got {label_smoothing})"
        )
    if task == "regression" and (class_weights is not None or label_smoothing):
        raise ValueError(
            "'class_weights' and 'label_smoothing' must be left out for task='regression': there "
            "are no classes"
        )
    if isinstance(class_weights, str):
        if class_weights != "balanced":
            raise ValueError(
                f"'class_weights' must be numbers or 'balanced' (got '{class_weights}')"
            )
    elif class_weights is not None and not all(weight >= 0 for weight in class_weights):
        raise ValueError(f"'class_weights' must not be negative (got {list(class_weights)})")


def balanced_weights(y: Tensor, task: Task, num_classes: int) -> Tensor:
    r"""Returns weights that make rare classes count as much as common classes.

    The weight of class :math:`c` is :math:`S / (C S_c)`, as in scikit-learn. The weight of a label
    is the number of samples without the label divided by the number of samples with the label. The
    weight is one for classes without samples, and for labels that no sample or every sample has.

    Examples:
        >>> balanced_weights(torch.tensor([0, 0, 0, 1]), "multiclass", 2)
        tensor([0.6667, 2.0000])

    Shapes:
        - **y:** Classes :math:`(S,)`, or labels :math:`(S, C)`, of the training part.
        - **num_classes:** Number of classes or labels :math:`C`.
        - **output:** :math:`(C,)`
    """
    if task == "multilabel":
        num_positive = (y > 0.5).sum(dim=0).double()
        weights = (len(y) - num_positive) / num_positive
        return torch.where((num_positive > 0) & (num_positive < len(y)), weights, 1.0).float()
    num_samples = torch.bincount(y, minlength=num_classes).double()
    return torch.where(num_samples > 0, len(y) / (num_classes * num_samples), 1.0).float()


def check_num_weights(weights: Tensor | None, num_classes: int) -> None:
    r"""Checks that there is a weight for each class.

    Shapes:
        - **num_classes:** Number of classes or labels :math:`C`.
    """
    if weights is not None and len(weights) != num_classes:
        raise ValueError(
            f"'class_weights' must have {num_classes} numbers, one for each class (got "
            f"{len(weights)})"
        )


def task_loss(
    out: Tensor,
    y: Tensor,
    task: Task,
    *,
    loss: RegressionLoss | None = None,
    weights: Tensor | None = None,
    label_smoothing: float = 0.0,
) -> Tensor:
    r"""Returns the mean loss of a batch: the cross entropy for classes, the binary cross entropy
    for labels, or the mean squared error for numbers.

    Shapes:
        - **out:** Outputs of the model :math:`(B, C)`.
        - **y:** Classes :math:`(B,)`, labels :math:`(B, C)`, or numbers :math:`(B, C)` or
          :math:`(B,)`.
        - **weights:** Weight of each class, or of the samples that have each label :math:`(C,)`.
    """
    if task == "regression":
        return _REGRESSION[loss or "mse"](out, numbers_like(y, out))
    expected = out.shape if task == "multilabel" else out.shape[:1]
    if y.shape != expected:
        other_task = "multiclass" if task == "multilabel" else "multilabel"
        raise ValueError(
            f"'y' must have shape {tuple(expected)} for task='{task}' (got {tuple(y.shape)}); is "
            f"it task='{other_task}', or does the model have a different number of outputs?"
        )
    if task == "multiclass":
        return F.cross_entropy(out, y, weights, label_smoothing=label_smoothing)
    target = y.to(out.dtype)
    if label_smoothing:
        target = target * (1 - label_smoothing) + label_smoothing / 2
    return F.binary_cross_entropy_with_logits(out, target, pos_weight=weights)


def numbers_like(y: Tensor, out: Tensor) -> Tensor:
    r"""Returns the target numbers with the shape and type of the model's outputs.

    Shapes:
        - **y:** Numbers :math:`(B,)` or :math:`(B, C)`.
        - **out:** Outputs of the model :math:`(B, C)`.
    """
    target = y.view(-1, 1) if y.dim() == 1 else y
    if target.shape != out.shape:  # broadcasting would hide the mistake
        raise ValueError(
            f"'y' must have shape {tuple(out.shape)} for task='regression' (got {tuple(y.shape)}); "
            "does the model have a different number of outputs?"
        )
    return target.to(out.dtype)
