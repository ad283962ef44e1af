import numpy as np
import pytest
import torch
from sklearn.base import clone
from sklearn.exceptions import NotFittedError

from torch_geometric_tactile.baselines import GraspSVM
from torch_geometric_tactile.baselines._features import FEATURE_NAMES, statistical_features


def series(num_samples=4, num_taxels=19, num_fingers=3, num_frames=60):
    draw = np.random.default_rng(0)
    return draw.normal(size=(num_samples, num_taxels, num_fingers * num_frames))


def separable(num_frames):
    # The second finger presses harder in the second class.
    x, y = series(60, 24, 3, num_frames), np.arange(60) % 2
    x[y == 1, :, num_frames : 2 * num_frames] += 2.0
    return x, y


def test_grasp_svm_repr():
    assert str(GraspSVM()) == "GraspSVM()"
    assert str(GraspSVM(finger=1, C=10.0)) == "GraspSVM(C=10.0, finger=1)"


def test_grasp_svm_number_of_features():
    assert GraspSVM(num_fingers=1).features(series(num_fingers=1)).shape == (4, 228)
    assert GraspSVM(finger=1).features(series()).shape == (4, 228)
    assert GraspSVM().features(series()).shape == (4, 12 * 3 * 19)
    assert GraspSVM().features(series(num_frames=1)).shape == (4, 3 * 19)
    assert GraspSVM().features(series(0)).shape == (0, 12 * 3 * 19)
    assert GraspSVM(num_fingers=1).features(series(2, 1, 1)).shape == (2, 12)


def test_grasp_svm_order_of_features():
    # Taxel by taxel, in it finger by finger, in it the twelve.
    x = series()
    found = GraspSVM().features(x).reshape(4, 19, 3, 12)
    assert np.allclose(found[2, 7, 1], statistical_features(x[2, 7, 60:120]))
    maximum = FEATURE_NAMES.index("maximum")
    assert found[3, 18, 2, maximum] == x[3, 18, 120:].max()


def test_grasp_svm_static_readings():
    x = series(num_frames=1)
    assert np.array_equal(GraspSVM().features(x), x.reshape(4, 57))
    assert np.array_equal(GraspSVM(finger=2).features(x), x[:, :, 2])
    assert np.array_equal(GraspSVM().features(torch.from_numpy(x)), x.reshape(4, 57))


@pytest.mark.parametrize("num_frames", [1, 10])
def test_grasp_svm_predicts_separable(num_frames):
    x, y = separable(num_frames)
    for finger in (None, 1):
        svm = GraspSVM(finger=finger).fit(x[:40], y[:40])
        assert (svm.predict(x[40:]) == y[40:]).all()
        assert ((svm.decision_function(x[40:]) > 0) == (y[40:] == 1)).all()
        assert svm.score(x[40:], y[40:]) == 1.0
        assert svm.classes_.tolist() == [0, 1]
    blind = GraspSVM(finger=0).fit(x[:40], y[:40])  # this finger knows nothing
    assert blind.score(x[40:], y[40:]) < 0.9


def test_grasp_svm_label_names():
    x, y = separable(1)
    labels = np.array(["stable", "slip"])[y]
    assert (GraspSVM().fit(x, labels).predict(x) == labels).all()


def test_grasp_svm_is_an_estimator():
    svm = GraspSVM(num_fingers=2, finger=0, C=3.0, kernel="linear")
    given = {"num_fingers": 2, "finger": 0, "C": 3.0, "kernel": "linear"}
    assert svm.get_params() == {**given, "class_weight": None}
    x, y = separable(1)
    svm.set_params(num_fingers=3, finger=1).fit(x, y)
    machine = svm.pipeline_[-1]
    assert (machine.C, machine.kernel) == (3.0, "linear")
    weighed = GraspSVM(class_weight="balanced").fit(x, y)
    assert weighed.pipeline_[-1].class_weight == "balanced"
    copied = clone(svm)
    assert copied.get_params() == svm.get_params()
    with pytest.raises(NotFittedError):
        copied.predict(x)


def test_grasp_svm_not_fitted():
    for method in ("predict", "decision_function"):
        with pytest.raises(NotFittedError, match="GraspSVM instance is not fitted yet"):
            getattr(GraspSVM(), method)(series())


@pytest.mark.parametrize("size", [(4, 19), (4, 19, 0), (4, 19, 4), (4, 19, 3, 60)])
def test_grasp_svm_bad_shape(size):
    match = r"'x' must have shape \(num_samples, num_taxels, 3 fingers x frames\) \(got \("
    with pytest.raises(ValueError, match=match):
        GraspSVM().fit(np.zeros(size), np.zeros(4))


def test_grasp_svm_bad_values():
    for value, found in ((np.nan, "1 NaN and 0 infinite"), (np.inf, "0 NaN and 1 infinite")):
        x = series()
        x[1, 2, 3] = value
        match = rf"'x' must hold finite .*got {found} in 1 of \d+ rows, the first is 1\).*Fill"
        with pytest.raises(ValueError, match=match):
            GraspSVM().features(x)
        with pytest.raises(ValueError, match=match):
            GraspSVM().fit(x, np.arange(len(x)) % 2)
    for finger in (-1, 3):
        with pytest.raises(ValueError, match=rf"between 0 and 2 \(got {finger}\)"):
            GraspSVM(finger=finger).features(series())
    with pytest.raises(ValueError, match=r"'num_fingers' must be at least 1 \(got 0\)"):
        GraspSVM(num_fingers=0).features(series())
