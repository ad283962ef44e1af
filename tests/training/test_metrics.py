import math

import numpy as np
import pytest
import torch
from sklearn.metrics import f1_score, roc_auc_score

pytest.importorskip("torchmetrics", reason="needs the extra 'train'")

from torch_geometric_tactile.training._collected_metrics import make_metrics, read_metrics
from torch_geometric_tactile.training.metrics import classification_metrics


def draw(task, num_samples=200, num_classes=5, seed=0):
    generator = np.random.default_rng(seed)
    score = generator.random((num_samples, num_classes)).round(2)  # with ties
    if task == "multilabel":
        return score, (generator.random(score.shape) < 0.3).astype(np.int64)
    return score / score.sum(1, keepdims=True), generator.integers(0, num_classes, num_samples)


def test_multiclass_by_hand():
    score = [[0.8, 0.1, 0.1], [0.3, 0.6, 0.1], [0.5, 0.4, 0.1], [0.2, 0.2, 0.6]]
    values = classification_metrics(np.array(score), np.array([0, 1, 1, 2]))
    assert set(values) == {"accuracy", "f1", "auroc"}
    assert values["accuracy"] == 0.75
    assert values["f1"] == pytest.approx((2 / 3 + 2 / 3 + 1) / 3)
    assert values["auroc"] == pytest.approx(1.0)


def test_two_classes_by_hand():
    score = torch.tensor([[0.2, 0.8], [0.4, 0.6], [0.9, 0.1], [0.7, 0.3]])
    values = classification_metrics(score, torch.tensor([1, 0, 0, 0]))
    of_positive = {"f1_positive", "precision_positive", "recall_positive"}
    assert set(values) == {"accuracy", "f1", "auroc", *of_positive}
    assert (values["precision_positive"], values["recall_positive"]) == (0.5, 1.0)
    assert values["f1_positive"] == pytest.approx(2 / 3)
    assert values["f1"] == pytest.approx((2 / 3 + 4 / 5) / 2)
    nobody = classification_metrics(torch.tensor([[0.9, 0.1]]), torch.tensor([0]))
    assert (nobody["f1"], nobody["f1_positive"]) == (1.0, 0.0)


def test_multilabel_by_hand():
    score = torch.tensor([[0.9, 0.2], [0.4, 0.8], [0.6, 0.7], [0.5, 0.1]])
    values = classification_metrics(
        score, torch.tensor([[1, 0], [1, 1], [0, 1], [0, 0]]), "multilabel"
    )
    assert values["accuracy"] == 0.5  # both labels are right in the first and last; 0.5 is a no
    assert (values["label_accuracy_0"], values["label_accuracy_1"]) == (0.5, 1.0)
    assert values["label_accuracy"] == 0.75
    assert values["f1"] == pytest.approx((0.5 + 1) / 2)
    assert values["auroc"] == pytest.approx((0.5 + 1) / 2)


@pytest.mark.parametrize("task", ["multiclass", "multilabel"])
def test_as_scikit_learn(task):
    score, y = draw(task)
    values = classification_metrics(score, y, task)
    predicted = score > 0.5 if task == "multilabel" else score.argmax(1)
    assert values["f1"] == pytest.approx(f1_score(y, predicted, average="macro"))
    expected = roc_auc_score(y, score, average="macro", multi_class="ovr")
    assert values["auroc"] == pytest.approx(expected)


@pytest.mark.parametrize("task", ["multiclass", "multilabel"])
@pytest.mark.parametrize("lacking", [False, True])
def test_collected_in_batches_is_the_same(task, lacking):
    score, y = (torch.from_numpy(value) for value in draw(task))
    if lacking and task == "multilabel":
        y[:, 2], score[:, 2] = 0, 0.1
    elif lacking:
        y[y == 2], score[:, 2] = 3, 0.0
    metrics = make_metrics(5, task)
    for part in torch.arange(200).split(64):
        metrics.update(score[part], y[part])
    found = read_metrics(metrics)
    expected = classification_metrics(score, y, task)
    assert {name: float(value) for name, value in found.items()} == pytest.approx(expected)


@pytest.mark.parametrize("classes", [[0, 1], [0]])
def test_two_classes_collected_in_batches_are_the_same(classes):
    score, y = (torch.from_numpy(value) for value in draw("multiclass", num_classes=2))
    y = torch.where(torch.tensor(len(classes) == 2), y, 0)
    metrics = make_metrics(2)
    for part in torch.arange(200).split(64):
        metrics.update(score[part], y[part])
    found = {name: float(value) for name, value in read_metrics(metrics).items()}
    expected = classification_metrics(score, y)
    assert found == pytest.approx(expected, nan_ok=True)
    y, predicted = y.numpy(), score.argmax(1).numpy()  # scikit-learn 1.6.0 takes no tensors
    assert found["f1_positive"] == pytest.approx(f1_score(y, predicted, zero_division=0.0))
    assert found["f1"] == pytest.approx(f1_score(y, predicted, average="macro"))


def test_class_that_is_absent_does_not_count():
    score, y = draw("multiclass")
    score[:, 4] = 0.0
    y[y == 4] = 0
    values = classification_metrics(score, y)
    assert values == pytest.approx(classification_metrics(score[:, :4], y))
    score[0] = [0, 0, 0, 0, 1]  # absent, but predicted: now it counts in the F1 score, as zero
    less = classification_metrics(score, y)["f1"]
    assert less < 0.85 * values["f1"]


def test_label_that_is_always_there_counts_but_in_auroc():
    score, y = draw("multilabel")
    y[:, 1] = 1
    values = classification_metrics(score, y, "multilabel")
    rest = [0, 2, 3, 4]
    without = classification_metrics(score[:, rest], y[:, rest], "multilabel")
    assert values["auroc"] == pytest.approx(without["auroc"])
    assert values["label_accuracy_1"] == pytest.approx((score[:, 1] > 0.5).mean())


def test_nothing_to_rank_gives_nan():
    values = classification_metrics(torch.eye(3)[[1, 1]], torch.tensor([1, 1]))
    assert (values["accuracy"], values["f1"]) == (1.0, 1.0)
    assert math.isnan(values["auroc"])
    none = classification_metrics(torch.zeros(4, 2), torch.zeros(4, 2), "multilabel")
    assert (none["accuracy"], none["label_accuracy"]) == (1.0, 1.0)
    assert math.isnan(none["f1"])
    assert math.isnan(none["auroc"])
    metrics = make_metrics(3)
    metrics.update(torch.eye(3)[[1, 1]], torch.tensor([1, 1]))
    assert math.isnan(read_metrics(metrics)["auroc"])


@pytest.mark.parametrize("task", ["multiclass", "multilabel"])
def test_nan_is_no_class(task):
    score, y = draw(task)
    score[[3, 7], 2] = np.nan
    match = r"'score' must not be NaN \(got NaN for 2 of 200 samples; the first is 3\); .*FillMiss"
    with pytest.raises(ValueError, match=match):
        classification_metrics(score, y, task)


def test_one_sample_and_large_probabilities():
    values = classification_metrics(torch.tensor([[1.0, 0.0]]), torch.tensor([0]))
    assert values["accuracy"] == 1.0


@pytest.mark.parametrize(
    ("score", "y", "task", "match"),
    [
        (torch.zeros(2, 3), torch.zeros(2), "binary", r"'task' must be one of .* \(got 'binary'\)"),
        (torch.zeros(2), torch.zeros(2), "multiclass", r"'score' must have shape .*\(got \(2,\)\)"),
        (torch.zeros(0, 3), torch.zeros(0), "multiclass", "both positive"),
        (torch.zeros(2, 3), torch.zeros(3), "multiclass", r"'y' must have shape \(2,\)"),
        (torch.zeros(2, 3), torch.zeros(2), "multilabel", r"'y' must have shape \(2, 3\)"),
        (torch.zeros(2, 3), torch.tensor([0, 3]), "multiclass", "'y' must be between 0 and 2"),
        (torch.zeros(1, 2), torch.tensor([[0, 2]]), "multilabel", "'y' must be between 0 and 1"),
    ],
)
def test_bad_arguments_are_named(score, y, task, match):
    with pytest.raises(ValueError, match=match):
        classification_metrics(score, y, task)
