"""Networks as estimators of scikit-learn."""

import numpy as np
import pytest

pytest.importorskip("lightning", reason="needs the extra 'train'")

import torch
from sklearn.base import clone, is_classifier, is_regressor
from sklearn.exceptions import NotFittedError
from sklearn.model_selection import GridSearchCV, GroupKFold, cross_val_predict

from torch_geometric_tactile import Predictor
from torch_geometric_tactile.sensors import TaxelLayout, grid
from torch_geometric_tactile.training import NetworkClassifier, NetworkRegressor

LAYOUT = grid(3, 4, pitch=0.01)
DRAW = np.random.default_rng(0)
CODES = np.arange(60) % 3
Y = np.array(["cup", "ball", "pen"])[CODES]
X = DRAW.normal(size=(60, 12, 2)) + 5 * np.eye(12)[CODES][:, :, None] + 300
FNN = {"model": "TactileFNN", "arguments": {"widths": [16], "pools": [1]}, "lr": 0.01}
QUICK = {"layout": LAYOUT, "epochs": 10, "random_state": 0, **FNN}


@pytest.fixture(scope="module")
def trained():
    return NetworkClassifier(**QUICK).fit(X[:45], Y[:45])


def test_classes_are_told_apart(trained):
    assert trained.classes_.tolist() == ["ball", "cup", "pen"]
    probability = trained.predict_proba(X[45:])
    assert probability.shape == (15, 3)
    assert probability.sum(axis=1) == pytest.approx(1.0)
    assert trained.predict(X[45:]).tolist() == trained.classes_[probability.argmax(axis=1)].tolist()
    assert trained.score(X[45:], Y[45:]) > 0.8


def test_taxels_without_edges_are_joined_to_their_nearest():
    layout = TaxelLayout("bare", LAYOUT.pos)
    model = NetworkClassifier(layout, "TactileGCN", epochs=1, random_state=0).fit(X, Y)
    assert model.predict_proba(X[:2]).shape == (2, 3)


def test_it_is_an_estimator_of_scikit_learn(trained):
    model = NetworkClassifier(**QUICK)
    assert is_classifier(model)
    assert is_regressor(NetworkRegressor(LAYOUT))
    other = clone(model)
    given = [{k: v for k, v in one.get_params().items() if k != "layout"} for one in (other, model)]
    assert given[0] == given[1]
    assert other.layout.matches(LAYOUT)
    before = dict(vars(model))
    state = torch.get_rng_state()
    assert model.fit(X[:45], Y[:45]) is model
    assert {key: vars(model)[key] for key in before} == before
    assert torch.get_rng_state().equal(state)
    assert model.predict_proba(X).tolist() == trained.predict_proba(X).tolist()
    seeded = clone(model).set_params(random_state=1).fit(X[:45], Y[:45])
    assert not np.allclose(seeded.predict_proba(X), trained.predict_proba(X))
    with pytest.raises(NotFittedError):
        clone(model).predict(X)
    with pytest.raises(NotFittedError):
        clone(model).to_predictor()


def test_a_grid_is_searched_with_groups():
    groups = np.arange(60) // 6
    tried = {"arguments": [{"widths": [8], "pools": [1]}, {"widths": [16], "pools": [1]}]}
    search = GridSearchCV(NetworkClassifier(**QUICK), tried, cv=GroupKFold(3))
    search.fit(X, Y, groups=groups)
    assert search.best_params_["arguments"] in tried["arguments"]
    assert search.best_score_ > 0.6
    assert search.best_estimator_.predict(X).shape == (60,)
    probability = cross_val_predict(
        search.best_estimator_, X, Y, groups=groups, cv=GroupKFold(2), method="predict_proba"
    )
    assert probability.shape == (60, 3)


def test_the_default_model_takes_edges_and_missing_readings():
    x = X.copy()
    x[::4, 5] = np.nan
    model = NetworkClassifier(LAYOUT, epochs=2, random_state=0).fit(x, Y)
    assert type(model.to_predictor().model).__name__ == "TaxelNet"
    assert np.isfinite(model.predict_proba(x)).all()


def test_a_predictor_says_the_same(trained, tmp_path):
    trained.to_predictor().save(tmp_path / "a")
    predictor = Predictor.load(tmp_path / "a")
    assert predictor.class_names == ("ball", "cup", "pen")
    found = predictor(X)
    assert found.double().numpy().tolist() == trained.predict_proba(X).tolist()
    assert [name for (name,) in predictor.labels(found)] == trained.predict(X).tolist()


@pytest.mark.parametrize("columns", [0, slice(0, 2)])
def test_numbers_come_in_their_own_unit(columns, tmp_path):
    y = 1000 + 50 * (X[:, :2, 0] - 300)[:, columns]
    model = NetworkRegressor(**{**QUICK, "epochs": 40}).fit(X, y)
    found = model.predict(X)
    assert found.shape == y.shape
    assert np.abs(found - y).mean() < 0.5 * np.abs(y - y.mean(axis=0)).mean()
    model.to_predictor().save(tmp_path / "a")
    again = Predictor.load(tmp_path / "a")(X).double().numpy()
    assert again.reshape(y.shape).tolist() == found.tolist()


def test_bad_input_is_refused(trained):
    for fit, text in (
        (lambda m: m.fit(X[0], Y), r"'x' must have shape \(num_samples, num_taxels, num_channels"),
        (lambda m: m.fit(X, Y[:9]), r"'y' must be of 60 samples \(got 9\)"),
        (lambda m: m.fit(X, Y[:, None]), "'y' must be one class a sample"),
        (lambda m: m.fit(X, np.zeros(60)), r"'y' must have at least 2 classes \(got 1\)"),
        (lambda m: m.fit(X[:, :3], Y), "must have shape|12 taxels"),
        (lambda m: m.set_params(arguments={"spam": 1}).fit(X, Y), "spam"),
        (lambda m: m.set_params(model="Spam").fit(X, Y), "Spam"),
    ):
        with pytest.raises(ValueError, match=text):
            fit(NetworkClassifier(**QUICK))
    with pytest.raises(ValueError, match=r"'x' must have 2 channels, .* \(got shape \(60, 12, 1"):
        trained.predict(X[..., :1])
    with pytest.raises(ValueError, match="'y' must hold finite numbers only"):
        NetworkRegressor(**QUICK).fit(X, np.full(60, np.nan))
