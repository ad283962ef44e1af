import pytest
import torch

from torch_geometric_tactile.analysis import class_confusion, label_confusion, roc_curves

Y = torch.tensor([0, 1, 2, 2])
SCORE = torch.tensor([[3.0, 1.0, 0.0], [0.0, 2.0, 1.0], [4.0, 0.0, 3.0], [0.0, 0.0, 9.0]])


def test_confusion_of_classes_by_hand():
    found = class_confusion(Y, SCORE.argmax(dim=1), num_classes=4)
    expected = [[1, 0, 0, 0], [0, 1, 0, 0], [1, 0, 1, 0], [0, 0, 0, 0]]
    assert found.tolist() == expected


def test_confusion_of_labels_by_hand():
    y = torch.tensor([[0, 1], [1, 1], [1, 1]])
    prediction = torch.tensor([[1, 1], [1, 1], [0, 1]])
    assert label_confusion(y, prediction).tolist() == [[[0, 1], [1, 1]], [[0, 0], [0, 3]]]
    assert label_confusion(y[:, :1], prediction[:, :1]).tolist() == [[[0, 1], [1, 1]]]


def test_roc_of_classes_by_hand():
    curves = roc_curves(Y, SCORE, ["a", "b", "c"])
    # Class 0: the third sample scores above the only true one, two of three pairs are in order.
    assert curves["a"].auc == pytest.approx(2 / 3)
    assert curves["b"].auc == 1
    assert curves["c"].auc == 1
    assert curves["mean of all"].auc == pytest.approx(8 / 9)
    assert curves["a"].fpr[0] == curves["mean of all"].fpr[0] == 0


def test_mean_curve_of_one_class_is_that_curve():
    y = torch.tensor([[0], [1], [0], [1], [1]])
    score = torch.tensor([[0.1], [0.4], [0.5], [0.6], [0.45]])
    curves = roc_curves(y, score, ["a"])
    one, mean = curves["a"], curves["mean of all"]
    area = ((mean.fpr[1:] - mean.fpr[:-1]) * (mean.tpr[1:] + mean.tpr[:-1]) / 2).sum()
    assert area == pytest.approx(one.auc)


def test_labels_equal_classes_one_by_one():
    one_hot = torch.nn.functional.one_hot(Y)
    by_class, by_label = (roc_curves(y, SCORE, ["a", "b", "c"]) for y in (Y, one_hot))
    assert {k: v.auc for k, v in by_class.items()} == {k: v.auc for k, v in by_label.items()}


def test_class_that_does_not_occur_has_no_curve():
    assert list(roc_curves(Y[:2], SCORE[:2], ["a", "b", "c"])) == ["a", "b", "mean of all"]


def test_bad_input_is_named():
    with pytest.raises(ValueError, match=r"'y' must have shape \(num_samples,\), not empty"):
        class_confusion(Y[:0], Y[:0], 3)
    with pytest.raises(ValueError, match=r"'prediction' must have the shape of 'y', \(4,\)"):
        class_confusion(Y, Y[:3], 3)
    with pytest.raises(ValueError, match=r"'y' must hold classes 0 to 1 \(got 0 to 2\)"):
        class_confusion(Y, Y, 2)
    with pytest.raises(ValueError, match=r"'y' must hold only 0 and 1 \(got 0 to 2\)"):
        label_confusion(Y.view(-1, 1), Y.view(-1, 1))
    with pytest.raises(ValueError, match=r"'score' must have shape \(num_samples, 2\)"):
        roc_curves(Y, SCORE, ["a", "b"])
    with pytest.raises(ValueError, match=r"'y' must have shape \(4,\) or \(4, 3\) \(got \(3,\)\)"):
        roc_curves(Y[:3], SCORE, ["a", "b", "c"])
    with pytest.raises(ValueError, match="'score' must hold finite"):
        roc_curves(Y, SCORE / 0, ["a", "b", "c"])
    with pytest.raises(ValueError, match="'names' must differ"):
        roc_curves(Y, SCORE, ["a", "b", "a"])
    with pytest.raises(ValueError, match="samples with and without a class"):
        roc_curves(Y[:1], SCORE[:1, :1], ["a"])
