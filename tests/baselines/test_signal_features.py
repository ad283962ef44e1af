import numpy as np
import pytest
import torch
from sklearn.base import clone
from sklearn.exceptions import NotFittedError
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler
from sklearn.svm import SVC

from torch_geometric_tactile.baselines import GraspSVM
from torch_geometric_tactile.baselines._features import statistical_features
from torch_geometric_tactile.baselines._signal_features import SignalFeatures
from torch_geometric_tactile.data import join_frames


def series(num_samples=4, num_frames=60, num_electrodes=19):
    return np.random.default_rng(0).normal(size=(num_samples, num_frames, num_electrodes))


def test_signal_features_repr():
    assert str(SignalFeatures()) == "SignalFeatures()"


def test_signal_features_are_those_of_the_paper():
    assert SignalFeatures().fit_transform(series()).shape == (4, 228)
    frames = torch.randn(4, 19, 60, 3)
    assert GraspSVM().features(join_frames(frames).numpy()).shape == (4, 684)


def test_signal_features_by_hand_and_order():
    x = series()
    found = SignalFeatures().fit_transform(x)
    assert np.allclose(found[2, 12 * 7 : 12 * 8], statistical_features(x[2, :, 7]), rtol=1e-12)
    names = SignalFeatures().fit(x).get_feature_names_out()
    assert names[:2].tolist() == ["electrode0_maximum", "electrode0_minimum"]
    assert len(names) == 228
    column = names.tolist().index("electrode7_root_mean_square")
    assert np.allclose(found[:, column], np.sqrt(np.square(x[:, :, 7]).mean(axis=1)))
    own = SignalFeatures().fit(x[:, :, :2]).get_feature_names_out(["P1", "P2"])
    assert own[12] == "P2_maximum"


def test_signal_features_do_not_depend_on_the_length():
    features = SignalFeatures().fit(series())
    assert features.transform(series(num_frames=7)).shape == (4, 228)
    assert features.transform(series(num_samples=0)).shape == (0, 228)
    assert SignalFeatures().fit_transform(series(2, 5, 1)).shape == (2, 12)
    x = series(num_frames=20)
    backwards = features.transform(x[:, ::-1])
    assert np.allclose(features.transform(x), backwards)  # no feature knows the order in time


def test_signal_features_are_a_step_of_scikit_learn():
    x, y = series(60, 10, 4), np.arange(60) % 2
    x[y == 1, :, 2] += 3.0
    model = make_pipeline(SignalFeatures(), StandardScaler(), SVC()).fit(x[:40], y[:40])
    assert model.score(x[40:], y[40:]) == 1.0
    names = model[:-1].get_feature_names_out()
    assert names[24] == "electrode2_maximum"
    copied = clone(model[0])
    assert copied.get_params() == {}
    with pytest.raises(NotFittedError, match="SignalFeatures instance is not fitted yet"):
        copied.transform(x)
    with pytest.raises(NotFittedError, match="SignalFeatures instance is not fitted yet"):
        copied.get_feature_names_out()
    tags = model[0].__sklearn_tags__()
    assert (tags.input_tags.three_d_array, tags.input_tags.two_d_array) == (True, False)
    assert model[0].n_features_in_ == 4
    before = x.copy()
    model.predict(x)
    assert np.array_equal(before, x)


def test_signal_features_as_a_table():
    pytest.importorskip("pandas")
    table = SignalFeatures().set_output(transform="pandas").fit_transform(series())
    assert table.columns[0] == "electrode0_maximum"


def test_signal_features_bad():
    for size in ((4, 60), (4, 0, 19), (4, 60, 0), (4, 60, 19, 3)):
        match = r"'x' must have shape \(num_samples, num_frames, num_electrodes\).* \(got \("
        with pytest.raises(ValueError, match=match):
            SignalFeatures().fit(np.zeros(size))
    with pytest.raises(ValueError, match=r"'x' must have 19 electrodes, .*\(4, 60, 18\)"):
        SignalFeatures().fit(series()).transform(series()[:, :, 1:])
    x = series()
    x[1, 2, 3] = np.nan
    with pytest.raises(ValueError, match=r"'x' must hold finite .*1 NaN .* the first is 1\)"):
        SignalFeatures().fit(x)
    with pytest.raises(ValueError, match=r"'input_features' must have 19 names, .* \(got 1\)"):
        SignalFeatures().fit(series()).get_feature_names_out(["one"])
