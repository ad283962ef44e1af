r"""Metrics that are accumulated batch by batch."""

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
    r"""Raises a :class:`ValueError` if the task is unknown."""
    need(task in TASKS, f"'task' must be one of {list(TASKS)} (got '{task}')")


class StoredScores(Metric):
    r"""The base class of metrics that need the scores :math:`(B, C)` and the classes or labels of
    all batches at once. The values are stored until the metric is reset.
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
        r"""Stores the predictions of a batch.

        Shapes:
            - **score:** Probabilities :math:`(B, C)`.
            - **y:** Classes :math:`(B,)`, or labels :math:`(B, C)`.
        """
        self.scores.append(score.detach())
        self.targets.append(y)

    def scores_and_targets(self) -> tuple[Tensor, Tensor]:
        r"""Returns the scores and targets of all samples so far."""
        return dim_zero_cat(self.scores), dim_zero_cat(self.targets)


class MacroAUROC(StoredScores):
    r"""The mean area under the ROC curve of each class against all others, or of each label.
    Classes that have no samples or all samples are left out (torchmetrics counts them as zero).
    """

    def compute(self) -> Tensor:
        r"""Returns the mean over all samples so far."""
        if len(self.scores) == 0:
            return torch.tensor(torch.nan)
        score, y = self.scores_and_targets()
        return macro_auroc(score, positives(y, score.size(1)))


def positives(y: Tensor, num_classes: int) -> Tensor:
    r"""Returns a mask of the samples that belong to each class, or have each label.

    Shapes:
        - **y:** Classes :math:`(S,)`, or labels :math:`(S, C)`.
        - **output:** :math:`(S, C)`
    """
    return (y if y.dim() == 2 else F.one_hot(y.long(), num_classes)) > 0.5


def macro_auroc(score: Tensor, positive: Tensor) -> Tensor:
    r"""Returns the mean area under the ROC curve over the classes that some but not all samples
    have. It is NaN if there is no such class, or if a score is NaN.

    Shapes:
        - **input:** :math:`(S, C)` each
        - **output:** a scalar
    """
    rankable_classes = (positive.any(dim=0) & ~positive.all(dim=0)).nonzero().view(-1)
    if len(rankable_classes) == 0 or score.isnan().any():
        return score.new_tensor(torch.nan)
    areas = [
        binary_auroc(score[:, i], positive[:, i].long(), validate_args=False)
        for i in rankable_classes.tolist()
    ]
    return torch.stack(areas).mean()


def macro_f1(true_positive: Tensor, false_positive: Tensor, false_negative: Tensor) -> Tensor:
    r"""Returns the mean F1 score of the classes. Classes that are neither present nor predicted are
    left out. The mean is NaN if no class is left.

    Shapes:
        - **input:** :math:`(C,)` each
        - **output:** a scalar
    """
    denominator = 2 * true_positive + false_positive + false_negative
    is_counted = denominator > 0
    return (2 * true_positive[is_counted] / denominator[is_counted]).mean()


def predicted_classes(score: Tensor, threshold: float | None = None) -> Tensor:
    r"""Returns the class with the highest probability. With a threshold for two classes, returns
    class 1 if its probability is above the threshold.

    Shapes:
        - **input:** :math:`(S, C)`
        - **output:** :math:`(S,)`
    """
    if threshold is None:
        return score.argmax(dim=1)
    if score.size(1) != 2:
        raise ValueError(
            f"'threshold' must be None unless there are 2 classes (got {score.size(1)})"
        )
    return (score[:, 1] > threshold).long()


def positive_scores(
    true_positive: Tensor, false_positive: Tensor, false_negative: Tensor
) -> dict[str, Tensor]:
    r"""Returns :obj:`f1_positive`, :obj:`precision_positive` and :obj:`recall_positive`, the scores
    of class 1 of two. A score is zero if its denominator is zero.

    Shapes:
        - **input:** :math:`(2,)` each
    """
    tp, fp, fn = (n[1] for n in (true_positive, false_positive, false_negative))
    return {
        "f1_positive": (2 * tp / (2 * tp + fp + fn)).nan_to_num(),
        "precision_positive": (tp / (tp + fp)).nan_to_num(),
        "recall_positive": (tp / (tp + fn)).nan_to_num(),
    }


def f1_scores(counts: Sequence[Tensor], task: Task) -> dict[str, Tensor]:
    r"""Returns the F1 scores from the true positives, false positives and false negatives of each
    class.
    """
    is_binary = task == "multiclass" and len(counts[0]) == 2
    return {"f1": macro_f1(*counts), **(positive_scores(*counts) if is_binary else {})}


def make_metrics(num_classes: int, task: Task = "multiclass") -> MetricCollection:
    r"""Returns the metrics of a task, to be read with :func:`read_metrics`.

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
    r"""Adds a batch to the metrics.

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
    r"""Returns the metric of one recording session: the accuracy or, for a regression, the mean
    absolute error.

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
        # For fewer than two samples, torchmetrics raises an error.
        is_undefined = int(r2.total) < 2  # type: ignore[arg-type]
        return {
            "mae": metrics["mae"].compute(),
            "rmse": metrics["rmse"].compute(),
            "r2": torch.tensor(torch.nan, device=r2.device) if is_undefined else r2.compute(),
        }
    values = metrics.compute()
    true_positive, false_positive, true_negative, false_negative, _ = values["counts"].unbind(1)
    scores = {"accuracy": values["accuracy"]}
    task: Task = "multiclass"
    if isinstance(metrics["counts"], MultilabelStatScores):
        task = "multilabel"
        num_samples = values["counts"][0, :4].sum()
        label_accuracies = (true_positive + true_negative) / num_samples
        scores["label_accuracy"] = label_accuracies.mean()
        scores |= {
            f"label_accuracy_{i}": label_accuracy
            for i, label_accuracy in enumerate(label_accuracies)
        }
    scores |= f1_scores([true_positive, false_positive, false_negative], task)
    return {**scores, "auroc": values["auroc"]}
