r"""Confusion matrices of classes and labels."""

import torch
from sklearn.metrics import confusion_matrix, multilabel_confusion_matrix
from torch import Tensor


def class_confusion(y: Tensor, prediction: Tensor, num_classes: int) -> Tensor:
    r"""Returns the confusion matrix of classes.

    Args:
        y (torch.Tensor): The true classes.
        prediction (torch.Tensor): The predicted classes.
        num_classes (int): Number of classes :math:`C`.

    Shapes:
        - **y, prediction:** :math:`(S,)`
        - **output:** number of samples for each pair of a true class (row) and a predicted class
          (column) :math:`(C, C)`

    Raises:
        ValueError: If the shapes differ, there is no sample, or a class is not between 0 and
            :math:`C - 1`.

    Examples:
        >>> class_confusion(torch.tensor([0, 0, 1]), torch.tensor([0, 1, 1]), num_classes=2)
        tensor([[1, 1],
                [0, 1]])
    """
    y, prediction = _checked(y, prediction, dim=1)
    for name, value in (("y", y), ("prediction", prediction)):
        if int(value.min()) < 0 or int(value.max()) >= num_classes:
            raise ValueError(
                f"'{name}' must hold classes 0 to {num_classes - 1} "
                f"(got {int(value.min())} to {int(value.max())})"
            )
    labels = list(range(num_classes))
    return torch.from_numpy(confusion_matrix(y.numpy(), prediction.numpy(), labels=labels))


def label_confusion(y: Tensor, prediction: Tensor) -> Tensor:
    r"""Returns the confusion matrix of each label. A sample may have several labels.

    Args:
        y (torch.Tensor): The true labels, 0 or 1.
        prediction (torch.Tensor): The predicted labels, 0 or 1.

    Shapes:
        - **y, prediction:** :math:`(S, C)`
        - **output:** numbers of samples :obj:`[[true negative, false positive], [false negative,
          true positive]]` for each label :math:`(C, 2, 2)`

    Raises:
        ValueError: If the shapes differ, there is no sample, or a value is neither 0 nor 1.

    Examples:
        >>> label_confusion(torch.tensor([[0], [1], [1]]), torch.tensor([[0], [1], [0]]))
        tensor([[[1, 0],
                 [1, 1]]])
    """
    y, prediction = _checked(y, prediction, dim=2)
    for name, value in (("y", y), ("prediction", prediction)):
        if not ((value == 0) | (value == 1)).all():
            raise ValueError(
                f"'{name}' must hold only 0 and 1 (got {int(value.min())} to {int(value.max())})"
            )
    counts = [
        multilabel_confusion_matrix(a.numpy(), b.numpy(), labels=[1])[0]
        for a, b in zip(y.unbind(1), prediction.unbind(1), strict=True)
    ]
    return torch.stack([torch.from_numpy(count) for count in counts])


def _checked(y: Tensor, prediction: Tensor, dim: int) -> tuple[Tensor, Tensor]:
    y, prediction = y.detach().cpu().long(), prediction.detach().cpu().long()
    if y.dim() != dim or y.numel() == 0:
        expected = "(num_samples,)" if dim == 1 else "(num_samples, num_labels)"
        raise ValueError(f"'y' must have shape {expected}, not empty (got {tuple(y.shape)})")
    if prediction.shape != y.shape:
        raise ValueError(
            f"'prediction' must have the shape of 'y', {tuple(y.shape)} "
            f"(got {tuple(prediction.shape)})"
        )
    return y, prediction
