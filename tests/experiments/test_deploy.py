"""What a comparison recommends becomes a predictor that says what the comparison's models say."""

import sys
from dataclasses import replace

import pytest

pytest.importorskip("lightning", reason="needs the extra 'train'")

import numpy as np
import torch
from compared import GIVEN, touches
from moving import motions

from torch_geometric_tactile import Predictor
from torch_geometric_tactile.baselines import TemperatureScaling
from torch_geometric_tactile.data import Recording
from torch_geometric_tactile.experiments import advice, deploy, recommended
from torch_geometric_tactile.experiments import comparison as comparing
from torch_geometric_tactile.experiments._building import build_object
from torch_geometric_tactile.experiments._estimators import seeded_estimator
from torch_geometric_tactile.experiments.compared_windows import FrameCut, data_source
from torch_geometric_tactile.experiments.comparison import ComparisonSettings
from torch_geometric_tactile.experiments.deploy import _most_frequent_setting
from torch_geometric_tactile.io._recording_npz import write_npz
from torch_geometric_tactile.predictor import AverageModel, EstimatorModel, export_onnx
from torch_geometric_tactile.transforms import fit_transform

QUICK = {"folds": 3, "epochs": 2, "members": 2}


def compared(folder, models, out="out", cut=None, tare=None, by=None, **changes):
    make = touches if cut is None else motions
    make(folder / "a.npz", **changes)
    settings = ComparisonSettings(models=tuple(models), tare=tare, by=by, **QUICK)
    source = data_source(folder / "a.npz", grid="3x4", cut=cut)
    return comparing.compare(source, settings, folder / out)


def by_hand(comparison, name, samples):
    """The pipeline of a model with its default setting, fitted on samples, and these prepared."""
    experiment = next(e for e in comparison.run.plan.experiments if e.name == name)
    seen = fit_transform(build_object(experiment.transform), samples.data)
    return seeded_estimator(experiment.model, samples.layout, 0).fit(seen, seen.y.numpy()), seen


@pytest.fixture(scope="module")
def touched(tmp_path_factory):
    names = ("fnn", "svm_rbf", "forest", "constant")
    return compared(tmp_path_factory.mktemp("touched"), names)


def test_the_recommended_model_is_taken(touched, tmp_path):
    best = recommended(touched)
    assert advice(touched).startswith(f"Use {best.model.name} (")
    predictor = deploy(touched)
    score = predictor.score
    assert (score.model, score.metric, score.num_splits) == (best.model.name, "accuracy", 3)
    assert (score.mean, score.sd) == best.scores["accuracy"]
    assert score.protocol == "3 folds by trial, stratified by y"
    assert score.trained_on == "all 48 samples"
    predictor.save(tmp_path / "a")
    again = Predictor.load(tmp_path / "a")
    assert again.score == score
    x = touched.run.plan.data.load().data.x
    assert again(x).equal(predictor(x))
    assert again.class_names == ("0", "1", "2")


def test_a_forest_is_that_of_scikit_learn(touched):
    samples = touched.run.plan.data.load()
    predictor = deploy(touched, "forest")
    assert isinstance(predictor.model, EstimatorModel)
    if _most_frequent_setting(touched.of("forest"), touched.run.plan.experiments[0].choice) == {}:
        pipeline, seen = by_hand(touched, "forest", samples)
        expected = pipeline.predict_proba(seen)
        np.testing.assert_allclose(predictor(samples.data.x), expected, atol=1e-6)


def test_labels_of_a_machine_are_those_of_the_compared_one(touched, monkeypatch):
    monkeypatch.setattr(sys.modules[deploy.__module__], "_most_frequent_setting", lambda *_: {})
    samples = touched.run.plan.data.load()
    pipeline, seen = by_hand(touched, "svm_rbf", samples)
    predictor = deploy(touched, "svm_rbf")
    labels = [int(label) for (label,) in predictor.labels(predictor(samples.data.x))]
    assert labels == pipeline.predict(seen).tolist()


def test_networks_are_averaged_and_are_drawn_as_in_the_comparison(touched, tmp_path):
    predictor = deploy(touched, "fnn")
    assert isinstance(predictor.model, AverageModel)
    assert len(predictor.model.models) == 2
    x = touched.run.plan.data.load().data.x
    again = deploy(touched, "fnn")
    assert again(x).equal(predictor(x))
    data = predictor.prepare(x)
    alone = [one(data.x, data.edge_index).softmax(dim=1) for one in predictor.model.models]
    assert not alone[0].allclose(alone[1])
    assert torch.stack(alone).mean(dim=0).allclose(predictor(x), atol=1e-6)
    predictor.save(tmp_path / "a")
    assert Predictor.load(tmp_path / "a")(x).equal(predictor(x))


def test_the_setting_chosen_most_often_is_trained_with(touched):
    result, choice = touched.of("forest"), touched.run.plan.experiments[-2].choice
    assert len(choice.settings) == 3
    for numbers, expected in (([0, 1, 1], 1), ([1, 0], 0), ([0, 1, 0], 0)):
        chosen = tuple({"number": number} for number in numbers)
        found = _most_frequent_setting(replace(result, chosen=chosen), choice)
        assert found == choice.settings[expected]


def test_none_is_recommended_where_nothing_was_learnt(tmp_path):
    draw = np.random.default_rng(0)
    noise = {"x": draw.normal(size=(48, 3, 4)), "y": draw.integers(0, 2, 12).repeat(4)}
    comparison = compared(tmp_path, ("svm_linear", "constant"), **noise)
    assert recommended(comparison) is None
    with pytest.raises(
        ValueError, match=r"'name' must be the name of a model \(got none\). No model is rec"
    ):
        deploy(comparison)
    assert deploy(comparison, "svm_linear").score.model == "svm_linear"
    with pytest.raises(ValueError, match=r"'name' must be one of .* \(got 'forest'\)"):
        deploy(comparison, "forest")


@pytest.mark.parametrize(
    "name", ["fnn", "svm_linear", "svm_rbf", pytest.param("forest", marks=pytest.mark.full)]
)
def test_numbers_come_in_their_own_unit(name, tmp_path):
    x = np.random.default_rng(0).normal(size=(48, 3, 4))
    y = 1000 + 50 * x[:, 0, :2]
    comparison = compared(tmp_path, (name,), x=x, y=y)
    predictor = deploy(comparison)
    predictor.save(tmp_path / "a")
    found = Predictor.load(tmp_path / "a")(x.reshape(48, 12, 1))
    assert found.shape == (48, 2)
    assert predictor.task == "regression"
    floor = np.abs(y - y.mean(axis=0)).mean()
    assert np.abs(found.numpy() - y).mean() < (3 * floor if name == "fnn" else floor)
    assert abs(float(found.mean()) - 1000) < 100


@pytest.mark.full
@pytest.mark.slow
@pytest.mark.parametrize("numbers", [False, True])
def test_averages_of_networks_are_exported(numbers, tmp_path):
    pytest.importorskip("onnxscript", reason="needs the extra 'export'")
    pytest.importorskip("onnxruntime", reason="needs the extra 'export'")
    x = np.random.default_rng(0).normal(size=(48, 3, 4))
    changes = {"x": x, "y": 1000 + 50 * x[:, 0, :2]} if numbers else {}
    predictor = deploy(compared(tmp_path, ("taxel_net",), **changes), "taxel_net")
    assert export_onnx(predictor, tmp_path / "a.onnx").difference < 1e-5


def test_the_test_part_of_given_parts_stays_unseen(tmp_path):
    part = {"part": GIVEN, "by": "given"}
    comparison = compared(tmp_path, ("forest",), **part)
    predictor = deploy(comparison)
    told = "the 36 samples of the training and validation parts"
    assert predictor.score.trained_on == told
    known = comparison.run.plan.data.load()[torch.from_numpy(np.flatnonzero(GIVEN < 2))]
    scaler = predictor.transform.transforms[0]
    assert scaler.center.view(-1).allclose(known.data.x.mean(dim=0).view(-1).double())


@pytest.mark.parametrize("name", ["lstm", "temporal_cnn", "svm_signal", "svm_rbf"])
def test_windows_of_recordings_are_cut_as_in_training(name, tmp_path):
    draw = np.random.default_rng(0)
    for i in range(8):
        tactile = (
            draw.normal(size=(40, 12, 1))
            + 50
            + np.sin(np.arange(40) * (0.2, 1.0)[i % 2])[:, None, None]
        )
        recording = Recording(time=np.arange(40) / 100, tactile=tactile.astype(np.float32))
        write_npz(recording, tmp_path / f"{('slow', 'fast')[i % 2]}_{i:03}.npz")
    source = data_source(tmp_path, grid="3x4", cut=FrameCut(window=10, hop=5))
    settings = ComparisonSettings(models=(name,), **QUICK)
    comparison = comparing.compare(source, settings, tmp_path / "out")
    predictor = deploy(comparison)
    predictor.save(tmp_path / "a.predictor")
    again = Predictor.load(tmp_path / "a.predictor")
    assert (again.window.length, again.window.hop) == (10, 5)
    assert again.class_names == ("fast", "slow")
    samples = comparison.run.plan.data.load()
    of_it = samples.data.x[3 * 7 : 4 * 7]  # files are in the order of their names
    assert again(of_it).allclose(again.recording(recording), atol=1e-6)
    assert len(again.recording(recording)) == 7


def test_the_rest_is_measured_on_each_recording(tmp_path):
    tare = {"key": "trial", "first": 2}
    comparison = compared(tmp_path, ("svm_linear",), tare=tare)
    predictor = deploy(comparison)
    x = comparison.run.plan.data.load().data.x[:4]
    with pytest.raises(ValueError, match=r"'session' must be given, since .* call 'adapt' first"):
        deploy(comparison)(x)
    predictor.adapt(x + 7)
    first = predictor(x + 7)
    predictor.adapt(x)
    assert predictor(x).allclose(first, atol=1e-5)


def test_predictor_of_windows_of_every_fourth_frame_knows_it(tmp_path):
    motions(tmp_path / "a.npz")
    cut = FrameCut(window=5)
    source = data_source(tmp_path / "a.npz", grid="3x4", stride=4, cut=cut)
    settings = ComparisonSettings(models=("constant",), **QUICK)
    comparison = comparing.compare(source, settings, tmp_path / "out")
    assert deploy(comparison, "constant").info.stride == 4


def test_machines_are_calibrated_with_whole_trials_held_out(touched, monkeypatch):
    seen = []
    fit = TemperatureScaling.fit

    def watched(self, x, y, groups=None):
        seen.append(groups)
        return fit(self, x, y, groups)

    monkeypatch.setattr(TemperatureScaling, "fit", watched)
    deploy(touched, "svm_rbf")
    assert seen[0].tolist() == np.arange(12).repeat(4).tolist()
