import sys

import numpy as np
import pytest
import torch
from sklearn.base import clone

from torch_geometric_tactile import baselines
from torch_geometric_tactile.baselines import FlatReadings, GraspSVM, constant, flat_forest, rbf_svm
from torch_geometric_tactile.data import StaticData
from torch_geometric_tactile.sensors import grid

LAYOUT = grid(2, 3, pitch=0.01)
DRAW = np.random.default_rng(0)
Y = np.arange(60) % 2
X = DRAW.normal(size=(60, 6, 2)) + 4 * (np.arange(6) == 2)[:, None] * Y[:, None, None]
NUMBERS = np.stack([X[:, 0, 0], 1000 * X[:, 1, 1]], axis=1)
NAMES = [
    "flat_forest",
    "descriptor_forest",
    "descriptor_svm",
    "posed_forest",
    "posed_ridge",
    "linear_svm",
    "rbf_svm",
    "signal_svm",
    "constant",
]


def model(name, task="multiclass", **more):
    layout = {"layout": LAYOUT} if name.startswith(("posed", "descriptor")) else {}
    estimator = getattr(baselines, name)(task=task, **layout, **more)
    drawn = [key for key in estimator.get_params() if key.endswith("__random_state")]
    return estimator.set_params(**dict.fromkeys(drawn, 0))


@pytest.mark.parametrize("name", NAMES)
def test_classes_are_told_apart_in_one_line(name):
    estimator = clone(model(name))
    predicted = estimator.fit(X[:40], Y[:40]).predict(X[40:])
    assert (predicted == Y[40:]).mean() > (0.4 if name == "constant" else 0.8)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("columns", [0, slice(0, 2)])
def test_numbers_of_any_size_are_predicted(name, columns):
    y = NUMBERS[:, columns]
    predicted = clone(model(name, "regression")).fit(X, y).predict(X).reshape(y.shape)
    error, floor = np.abs(predicted - y).mean(), np.abs(y.mean(axis=0) - y).mean()
    assert np.isfinite(predicted).all()
    assert error <= (floor * 1.000001 if name in ("constant", "posed_ridge") else 0.8 * floor)


@pytest.mark.parametrize("name", NAMES)
def test_samples_and_their_readings_are_one(name):
    first = model(name).fit(X, Y).predict(X)
    data = StaticData(x=torch.from_numpy(X))
    assert np.array_equal(model(name).fit(data, Y).predict(data), first)


@pytest.mark.full  # numba compiles for 20 seconds
@pytest.mark.parametrize("num_channels", [1, 2])
def test_minirocket_tells_movements_apart(num_channels):
    pytest.importorskip("sktime")
    draw = np.random.default_rng(0)
    phase = draw.uniform(0, 6, size=(60, 6, 1))
    speed = 0.3 + 0.5 * (np.arange(60) % 2)[:, None, None]
    x = np.sin(phase + speed * np.arange(20)) + 0.3 * draw.normal(size=(60, 6, 20))
    estimator = clone(baselines.minirocket(num_channels=num_channels, num_kernels=168))
    estimator.set_params(**{f"{estimator.steps[0][0]}__random_state": 0})
    assert (estimator.fit(x[:40], Y[:40]).predict(x[40:]) == Y[40:]).mean() > 0.8
    again = clone(estimator).fit(x[:40], Y[:40]).predict(x[40:])
    assert np.array_equal(again, estimator.predict(x[40:]))
    numbers = baselines.minirocket("regression", num_kernels=84).fit(x, speed[:, 0, 0])
    assert np.abs(numbers.predict(x) - speed[:, 0, 0]).mean() < 0.15
    with pytest.raises(ValueError, match=r"windows of at least 9 frames \(got 4\)"):
        baselines.minirocket().fit(x[..., :4], Y)


def test_minirocket_names_what_is_missing(monkeypatch):
    monkeypatch.setitem(sys.modules, "sktime.transformations.panel.rocket", None)
    with pytest.raises(ImportError, match=r"pip install 'torch-geometric-tactile\[series\]'"):
        baselines.minirocket().fit(np.zeros((2, 6, 20)), [0, 1])


def test_flat_readings_are_side_by_side():
    x = np.array([[[1.0, 2.0], [np.nan, 4.0]]])
    assert FlatReadings().transform(x).tolist() == [[1.0, 2.0, 0.0, 4.0]]
    with pytest.raises(ValueError, match=r"'x' must have shape \(num_samples, num_taxels"):
        FlatReadings().transform(x[0])


def test_many_samples_are_thinned_for_the_kernel():
    few = rbf_svm(most_samples=20).fit(X, Y)
    assert few[-1].shape_fit_[0] == 20
    assert rbf_svm(most_samples=60).fit(X, Y)[-1].shape_fit_[0] == 60


def test_width_of_the_kernel_follows_the_readings():
    narrow = rbf_svm(width=2.0).fit(X, Y)[-1]
    assert narrow.gamma == pytest.approx(2.0 / (12 * X.var()))


def test_rare_classes_may_weigh_as_much():
    y = (np.arange(60) < 4).astype(int)
    x = DRAW.normal(size=(60, 6, 1)) + 1.0 * y[:, None, None]
    found = [
        rbf_svm(class_weight=weight).fit(x, y).predict(x)[y == 1].mean()
        for weight in (None, "balanced")
    ]
    assert found[1] > found[0]


@pytest.mark.parametrize("make", [flat_forest, constant, rbf_svm])
def test_unknown_task_is_refused(make):
    with pytest.raises(ValueError, match=r"'task' must be one of \['multiclass', 'regression'\]"):
        make("multilabel")


def test_signal_svm_is_that_of_the_grasp_paper():
    x = DRAW.normal(size=(60, 6, 3 * 20)) * np.where(Y, 3.0, 1.0)[:, None, None]
    paper = GraspSVM(num_fingers=3, C=2.0).fit(x[:40], Y[:40])
    ours = baselines.signal_svm(num_channels=3, C=2.0).fit(x[:40], Y[:40])
    assert np.allclose(ours.decision_function(x[40:]), paper.decision_function(x[40:]))
    assert (ours.predict(x[40:]) == Y[40:]).mean() > 0.9
    with pytest.raises(ValueError, match="7 fingers x frames"):
        baselines.signal_svm(num_channels=7).fit(x, Y)


def test_linear_svm_takes_few_steps_where_readings_outnumber_samples():
    draw = np.random.default_rng(0)
    x, y = np.cumsum(draw.normal(size=(200, 10, 50)), axis=-1), draw.integers(0, 2, 200)
    assert baselines.linear_svm().fit(x, y)[-1].n_iter_ < 50
    numbers = baselines.linear_svm("regression").fit(x, y.astype(float))[-1].regressor_
    assert numbers.estimators_[0].n_iter_ < 50
