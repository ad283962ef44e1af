import numpy as np
import pytest
from sklearn.base import clone
from sklearn.metrics import log_loss
from sklearn.svm import SVC, LinearSVC

from torch_geometric_tactile.baselines import TemperatureScaling

DRAW = np.random.default_rng(0)
Y = np.arange(240) % 3
X = DRAW.normal(size=(240, 5)) + 1.2 * np.eye(5)[Y]


@pytest.mark.parametrize("machine", [SVC(C=10.0), LinearSVC(dual=False)])
@pytest.mark.parametrize("classes", [2, 3])
def test_labels_stay_and_probabilities_are_calibrated(machine, classes):
    x, y = X[classes > Y], np.array(["a", "b", "c"])[Y[classes > Y]]
    train, test = slice(0, 120), slice(120, None)
    scaled = clone(TemperatureScaling(machine)).fit(x[train], y[train])
    plain = machine.fit(x[train], y[train])
    found, scores = scaled.predict_proba(x[test]), plain.decision_function(x[test])
    assert found.sum(axis=1) == pytest.approx(1.0)
    best = scores.argmax(axis=1) if classes == 3 else (scores > 0).astype(int)
    assert scaled.predict(x[test]).tolist() == plain.classes_[best].tolist()
    constant = np.full(classes, 1 / classes)
    floor = log_loss(y[test], np.tile(constant, (len(found), 1)), labels=plain.classes_)
    assert log_loss(y[test], found, labels=plain.classes_) < 0.95 * floor
    by_hand = scaled.factor_ * (scores if classes == 3 else np.stack([0 * scores, scores], axis=1))
    by_hand = np.exp(by_hand) / np.exp(by_hand).sum(axis=1, keepdims=True)
    assert found == pytest.approx(by_hand)


def test_boundary_of_balanced_classes_stays():
    y = (np.arange(400) < 20).astype(int)
    x = DRAW.normal(size=(400, 2)) + 1.5 * y[:, None]
    machine = SVC(class_weight="balanced")
    scaled, plain = TemperatureScaling(machine).fit(x, y), machine.fit(x, y)
    assert scaled.predict(x).tolist() == plain.predict(x).tolist()
    assert (scaled.predict(x) == 1).sum() > 25


def test_samples_of_a_group_are_held_out_together():
    groups = np.arange(24).repeat(10)
    centre = 6 * DRAW.normal(size=(24, 5))
    x, y = centre[groups] + 0.01 * DRAW.normal(size=(240, 5)), (np.arange(24) % 2)[groups]
    alone = TemperatureScaling(SVC(C=100.0)).fit(x, y)
    whole = TemperatureScaling(SVC(C=100.0)).fit(x, y, groups=groups)
    assert whole.factor_ < 0.5 * alone.factor_  # a new group is a guess


def test_factor_of_what_cannot_be_held_out_is_one():
    model = TemperatureScaling(SVC()).fit(X[:3], Y[:3])
    assert model.factor_ == 1.0
    separable = TemperatureScaling(SVC()).fit([[0.0]] * 5 + [[9.0]] * 5, [0] * 5 + [1] * 5)
    assert separable.predict_proba([[9.0]])[0, 1] == pytest.approx(11 / 12, abs=0.06)


def test_bad_input_is_refused():
    with pytest.raises(ValueError, match=r"'folds' must be at least 2 \(got 1\)"):
        TemperatureScaling(SVC(), folds=1).fit(X, Y)
    with pytest.raises(ValueError, match=r"'y' must have at least 2 classes \(got 1\)"):
        TemperatureScaling(SVC()).fit(X, np.zeros(240))
