import math

import numpy as np
import pytest
import torch
import torch.nn.functional as F

pytest.importorskip("lightning", reason="needs the extra 'train'")

from sklearn.utils.class_weight import compute_class_weight
from training_fixtures import quiet_trainer

from torch_geometric_tactile.training import TactileDataModule, TactileModule
from torch_geometric_tactile.training._losses import balanced_weights, task_loss

LOGITS = torch.tensor([[0.0, math.log(3)], [0.0, 0.0], [math.log(3), 0.0]])
Y = torch.tensor([1, 1, 0])


def test_plain_losses_are_pytorchs():
    assert task_loss(LOGITS, Y, "multiclass").equal(F.cross_entropy(LOGITS, Y))
    flags = torch.tensor([[1, 0], [0, 0], [1, 1]])
    expected = F.binary_cross_entropy_with_logits(LOGITS, flags.float())
    assert task_loss(LOGITS, flags, "multilabel").equal(expected)


def test_weighted_cross_entropy_by_hand():
    weights = torch.tensor([3.0, 1.0])
    # Probabilities of the classes: 3/4, 1/2, 3/4.
    expected = (math.log(4 / 3) + math.log(2) + 3 * math.log(4 / 3)) / 5
    found = task_loss(LOGITS, Y, "multiclass", weights=weights)
    assert float(found) == pytest.approx(expected)


def test_smoothed_cross_entropy_by_hand():
    found = task_loss(LOGITS[:1], Y[:1], "multiclass", label_smoothing=0.2)
    assert float(found) == pytest.approx(0.9 * math.log(4 / 3) + 0.1 * math.log(4))


def test_weights_and_smoothing_of_labels_by_hand():
    logits, y = torch.tensor([[math.log(3), 0.0]]), torch.tensor([[1, 0]])
    found = task_loss(logits, y, "multilabel", weights=torch.tensor([2.0, 5.0]))
    assert float(found) == pytest.approx((2 * math.log(4 / 3) + math.log(2)) / 2)
    found = task_loss(logits, y, "multilabel", label_smoothing=0.2)
    smoothed = 0.9 * math.log(4 / 3) + 0.1 * math.log(4)
    assert float(found) == pytest.approx((smoothed + math.log(2)) / 2)


@pytest.mark.parametrize(
    ("loss", "expected"), [(None, 2.5), ("mse", 2.5), ("l1", 1.5), ("huber", 1.0)]
)
def test_losses_of_numbers_by_hand(loss, expected):
    out, y = torch.tensor([[1.0], [4.0]]), torch.tensor([2.0, 2.0])
    assert float(task_loss(out, y, "regression", loss=loss)) == pytest.approx(expected)
    with pytest.raises(ValueError, match=r"'y' must have shape \(2, 1\) .*\(got \(2, 3\)\)"):
        task_loss(out, torch.zeros(2, 3), "regression")


def test_balanced_weights_are_those_of_scikit_learn():
    y = torch.tensor([0, 0, 0, 1, 2, 2])
    expected = compute_class_weight("balanced", classes=np.arange(3), y=y.numpy())
    assert balanced_weights(y, "multiclass", 3).tolist() == pytest.approx(expected.tolist())
    assert balanced_weights(y, "multiclass", 4)[3] == 1  # never seen


def test_balanced_weights_of_labels():
    y = torch.tensor([[1, 0, 1], [0, 0, 1], [0, 0, 1], [0, 0, 1]])
    assert balanced_weights(y, "multilabel", 3).tolist() == [3, 1, 1]


def test_weights_count_in_training_only(labelled, joint_model):
    batch = labelled("multiclass").batch([0, 1, 2, 3])
    torch.manual_seed(0)
    model = joint_model()
    plain = TactileModule(model, num_classes=3)
    weighted = TactileModule(
        model, num_classes=3, class_weights=[1.0, 2.0, 9.0], label_smoothing=0.1
    )
    expected = F.cross_entropy(
        model.lin(batch.joint), batch.y, torch.tensor([1.0, 2.0, 9.0]), label_smoothing=0.1
    )
    torch.testing.assert_close(weighted.training_step(batch, 0), expected)
    assert plain.training_step(batch, 0) != expected
    logits = model.lin(batch.joint)
    assert weighted.loss(logits, batch.y).equal(plain.loss(logits, batch.y))


def test_balanced_weights_are_of_the_training_part(labelled, joint_model):
    data = TactileDataModule(labelled("multiclass"), val=0.3)
    module = TactileModule(joint_model(), class_weights="balanced")
    quiet_trainer().fit(module, datamodule=data)
    y = data.part("train").column("y")
    assert len(y) == 42
    expected = compute_class_weight("balanced", classes=np.arange(3), y=y.numpy())
    assert module.class_weight.tolist() == pytest.approx(expected.tolist())
    assert not any("class_weight" in key for key in module.state_dict())


@pytest.mark.parametrize(
    ("kwargs", "match"),
    [
        ({"loss": "mse"}, r"'loss' must be one of .* \(got 'mse' for task='multiclass'\)"),
        ({"loss": "mae", "task": "regression"}, r"'loss' must be one of .*got 'mae'"),
        ({"label_smoothing": 1.0}, r"'label_smoothing' must be at least 0 and below 1 \(got 1.0\)"),
        ({"class_weights": "even"}, r"must be numbers or 'balanced' \(got 'even'\)"),
        ({"class_weights": [1, -1]}, r"'class_weights' must not be negative \(got \[1, -1\]\)"),
        ({"class_weights": "balanced", "task": "regression"}, "must be left out for task='regres"),
    ],
)
def test_bad_settings_are_named(joint_model, kwargs, match):
    TactileModule(joint_model(), class_weights=[0, 0.5, 2])
    with pytest.raises(ValueError, match=match):
        TactileModule(joint_model(), **kwargs)


def test_number_of_weights_is_checked(labelled, joint_model):
    module = TactileModule(joint_model(), class_weights=[1.0, 2.0], num_classes=3)
    with pytest.raises(ValueError, match=r"'class_weights' must have 3 numbers.*\(got 2\)"):
        module.setup("fit")
    module = TactileModule(joint_model(), class_weights="balanced", num_classes=3)
    with pytest.raises(ValueError, match=r"must be numbers without a TactileDataModule"):
        module.setup("fit")
