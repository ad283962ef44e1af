r"""Metrics that are collected batch by batch."""

from collections.abc import Sequence
from typing import Literal, get_args

import torch
import torch.nn.functional as F
from torch import Tensor
from torchmetrics import MeanAbsoluteError, MeanSquaredError, Metric, MetricCollection, R2Score
from torchmetrics.classification import (
    MulticlassAccuracy,
    MulticlassStatScores,
    MultilabelExactMatch,
    MultilabelStatScores,
)
from torchmetrics.functional.classification import binary_auroc
from torchmetrics.utilities import dim_zero_cat

from torch_geometric_tactile._checks import need

Task = Literal["multiclass", "multilabel", "regression"]
TASKS: tuple[Task, ...] = get_args(Task)


def check_task(task: str) -> None:
    r"""Raises a :class:`ValueError` if there is no such task."""
    need(task in TASKS, f"'task' must be one of {list(TASKS)} (got '{task}')")


class KeptScores(Metric):
    r"""Keeps the scores :math:`(B, C)` and the classes or labels of all batches until it is reset:
    the base of metrics that need them all at once.
    """

    full_state_update = False
    higher_is_better = True
    scores: list[Tensor]
    targets: list[Tensor]

    def __init__(self) -> None:
        super().__init__()
        self.add_state("scores", default=[], dist_reduce_fx="cat")
        self.add_state("targets", default=[], dist_reduce_fx="cat")

    def update(self, score: Tensor, y: Tensor) -> None:
        r"""Takes the predictions of a batch.

        Shapes:
            - **score:** Probabilities :math:`(B, C)`.
            - **y:** Classes :math:`(B,)`, or labels :math:`(B, C)`.
        """
        self.scores.append(score.detach())
        self.targets.append(y)

    def kept(self) -> tuple[Tensor, Tensor]:
        r"""Returns the scores and targets of all samples so far."""
        return dim_zero_cat(self.scores), dim_zero_cat(self.targets)


class MacroAUROC(KeptScores):
    r"""The mean area under the ROC curve of each class against the rest, or of each label; classes
    that no sample has, or all have, are left out (torchmetrics counts them as zero).
    """

    def compute(self) -> Tensor:
        r"""Returns the mean of all samples so far."""
        if len(self.scores) == 0:
            return torch.tensor(torch.nan)
        score, y = self.kept()
        return macro_auroc(score, positives(y, score.size(1)))


def positives(y: Tensor, num_classes: int) -> Tensor:
    r"""Returns which samples are of each class, or have each label, as booleans.

    Shapes:
        - **y:** Classes :math:`(S,)`, or labels :math:`(S, C)`.
        - **output:** :math:`(S, C)`
    """
    return (y if y.dim() == 2 else F.one_hot(y.long(), num_classes)) > 0.5


def macro_auroc(score: Tensor, positive: Tensor) -> Tensor:
    r"""Returns the mean area under the ROC curve, over the classes that some samples have and
    some have not; NaN if there is none, or a score is NaN.

    Shapes:
        - **input:** :math:`(S, C)` each
        - **output:** a scalar
    """
    mixed = (positive.any(dim=0) & ~positive.all(dim=0)).nonzero().view(-1)
    if len(mixed) == 0 or score.isnan().any():
        return score.new_tensor(torch.nan)
    areas = [
        binary_auroc(score[:, i], positive[:, i].long(), validate_args=False)
        for i in mixed.tolist()
    ]
    return torch.stack(areas).mean()


def macro_f1(true_positive: Tensor, false_positive: Tensor, false_negative: Tensor) -> Tensor:
    r"""Returns the mean F1 score of the classes, without those neither present nor predicted; NaN
    if none is left.

    Shapes:
        - **input:** :math:`(C,)` each
        - **output:** a scalar
    """
    of_all = 2 * true_positive + false_positive + false_negative
    counts = of_all > 0
    return (2 * true_positive[counts] / of_all[counts]).mean()


def predicted_classes(score: Tensor, threshold: float | None = None) -> Tensor:
    r"""Returns the class with the highest probability; of two classes, class 1 if its probability
    is above a threshold.

    Shapes:
        - **input:** :math:`(S, C)`
        - **output:** :math:`(S,)`
    """
    if threshold is None:
        return score.argmax(dim=1)
    if score.size(1) != 2:
        raise ValueError(f"'threshold' must be None unless of two classes (got {score.size(1)})")
    return (score[:, 1] > threshold).long()


def positive_scores(
    true_positive: Tensor, false_positive: Tensor, false_negative: Tensor
) -> dict[str, Tensor]:
    r"""Returns :obj:`f1_positive`, :obj:`precision_positive` and :obj:`recall_positive` of class 1
    of two; zero where there is nothing to divide by.

    Shapes:
        - **input:** :math:`(2,)` each
    """
    found, wrong, missed = (n[1] for n in (true_positive, false_positive, false_negative))
    return {
        "f1_positive": (2 * found / (2 * found + wrong + missed)).nan_to_num(),
        "precision_positive": (found / (found + wrong)).nan_to_num(),
        "recall_positive": (found / (found + missed)).nan_to_num(),
    }


def f1_scores(counts: Sequence[Tensor], task: Task) -> dict[str, Tensor]:
    r"""Returns the scores of true positives, false positives and false negatives of each class."""
    of_two = task == "multiclass" and len(counts[0]) == 2
    return {"f1": macro_f1(*counts), **(positive_scores(*counts) if of_two else {})}


def make_metrics(num_classes: int, task: Task = "multiclass") -> MetricCollection:
    r"""Returns what is collected batch by batch, to be read with :func:`read_metrics`.

    Shapes:
        - **num_classes:** Number of classes, labels or targets :math:`C`.
    """
    metrics: dict[str, Metric | MetricCollection]
    if task == "regression":
        metrics = {
            "mae": MeanAbsoluteError(),
            "rmse": MeanSquaredError(squared=False),
            "r2": R2Score(),
        }
    else:
        counts = MultilabelStatScores if task == "multilabel" else MulticlassStatScores
        metrics = {
            "accuracy": session_metric(num_classes, task),
            "counts": counts(num_classes, average=None),
            "auroc": MacroAUROC(),
        }
    return MetricCollection(metrics, compute_groups=False)


def update_metrics(
    metrics: MetricCollection, score: Tensor, y: Tensor, threshold: float | None = None
) -> None:
    r"""Adds a batch to what is collected.

    Shapes:
        - **score:** Probabilities :math:`(B, C)`, or the predicted numbers.
    """
    if threshold is None:
        metrics.update(score, y)
        return
    prediction = predicted_classes(score, threshold)
    for name, metric in metrics.items():
        assert isinstance(metric, Metric)
        metric.update(score if name == "auroc" else prediction, y)


def session_metric(num_classes: int, task: Task = "multiclass") -> Metric:
    r"""Returns what is collected of one recording session: the accuracy, or the mean absolute error
    of a regression.

    Shapes:
        - **num_classes:** Number of classes, labels or targets :math:`C`.
    """
    if task == "regression":
        return MeanAbsoluteError()
    if task == "multilabel":
        return MultilabelExactMatch(num_classes)
    return MulticlassAccuracy(num_classes, average="micro")


def read_metrics(metrics: MetricCollection) -> dict[str, Tensor]:
    r"""Returns the values of :func:`classification_metrics` or :func:`regression_metrics` over all
    batches so far.
    """
    if "r2" in metrics:
        r2 = metrics["r2"]
        # torchmetrics raises an error for less than two samples.
        few = int(r2.total) < 2  # type: ignore[arg-type]
        return {
            "mae": metrics["mae"].compute(),
            "rmse": metrics["rmse"].compute(),
            "r2": torch.tensor(torch.nan, device=r2.device) if few else r2.compute(),
        }
    value = metrics.compute()
    true_positive, false_positive, true_negative, false_negative, _ = value["counts"].unbind(1)
    read = {"accuracy": value["accuracy"]}
    task: Task = "multiclass"
    if isinstance(metrics["counts"], MultilabelStatScores):
        task = "multilabel"
        num_samples = value["counts"][0, :4].sum()
        right = (true_positive + true_negative) / num_samples
        read["label_accuracy"] = right.mean()
        read |= {f"label_accuracy_{i}": part for i, part in enumerate(right)}
    read |= f1_scores([true_positive, false_positive, false_negative], task)
    return {**read, "auroc": value["auroc"]}
