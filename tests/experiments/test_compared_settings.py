"""Settings of compared models: which are tried, how cheaply, and as those of networks."""

from dataclasses import replace

import pytest

pytest.importorskip("lightning", reason="needs the extra 'train'")

import numpy as np
import torch
from compared import touches

from torch_geometric_tactile import Predictor
from torch_geometric_tactile.baselines import DescriptorFeatures
from torch_geometric_tactile.data import StaticData
from torch_geometric_tactile.experiments import _compared_models as compared_models
from torch_geometric_tactile.experiments import comparison as comparing
from torch_geometric_tactile.experiments._compared_models import MODELS, find_model
from torch_geometric_tactile.experiments._compared_task import ComparedTask
from torch_geometric_tactile.experiments._run_experiment import run_experiment
from torch_geometric_tactile.experiments.compared_windows import data_source
from torch_geometric_tactile.experiments.comparison import ComparisonSettings
from torch_geometric_tactile.experiments.deploy import deploy
from torch_geometric_tactile.predictor import export_onnx
from torch_geometric_tactile.sensors import as_layout, biotac, grid

SHIFT = "torch_geometric_tactile.transforms"


@pytest.mark.parametrize("num_frames", [None, 3, 60])
@pytest.mark.parametrize("size", [(3, 4), (30, 20)])
def test_each_setting_of_a_forest_has_features_of_its_own(size, num_frames):
    layout = grid(*size, 0.004)
    task = ComparedTask(layout, "accuracy", 100, num_frames=num_frames, num_channels=2)
    settings = find_model("descriptors_forest").to_cell(task).choice.settings
    samples = StaticData(x=torch.rand(2, layout.num_taxels, 2 * (num_frames or 1)))
    if num_frames is not None:
        samples.num_frames = num_frames
    repeated, plain = (
        DescriptorFeatures(layout, with_readings=True, balanced=balanced).transform(samples)
        for balanced in (True, False)
    )
    is_tried = any(setting.get("init_args", {}).get("balanced") is False for setting in settings)
    assert is_tried == (repeated.shape != plain.shape)
    assert settings[0] == {"init_args": {}}


@pytest.mark.parametrize("name", ["forest", "descriptors_forest", "posed_forest"])
def test_settings_of_a_forest_are_compared_with_fewer_trees(name):
    task = ComparedTask(grid(3, 4, 0.004), "accuracy", 100)
    cell = find_model(name).to_cell(task)
    assert cell.choice.draft == {"init_args": {"num_trees": 100}}
    assert "num_trees" not in cell.estimator["init_args"]  # the default of 300 to be tested


@pytest.mark.parametrize("name", ["forest", "descriptors_forest"])
@pytest.mark.parametrize(("size", "count"), [((3, 4), 1001), ((28, 50), 800)])
def test_what_takes_long_is_tried_twice_and_has_fewer_trees(name, size, count):
    cell = find_model(name).to_cell(ComparedTask(grid(*size, 0.01), "accuracy", count))
    assert cell.estimator["init_args"]["num_trees"] == 150
    assert cell.choice.repeats == 2
    few = find_model(name).to_cell(ComparedTask(grid(*size, 0.01), "accuracy", 100))
    assert few.choice.repeats == 3


def test_on_a_given_part_samples_of_many_taxels_are_validated_on_fewer_cuts():
    cuts = [
        ComparedTask(grid(*size, 0.01), "accuracy", count, has_given_parts=True)
        .choice()
        .num_validation_cuts
        for size, count in (((8, 8), 1000), ((8, 8), 1001), ((28, 50), 100))
    ]
    assert cuts == [5, 3, 3]


def test_only_forests_have_a_draft():
    task = ComparedTask(grid(3, 4, 0.004), "accuracy", 100)
    names = [model.name for model in MODELS if model.to_cell(task).choice.draft]
    assert names == ["forest", "descriptors_forest", "posed_forest"]


def test_a_network_may_be_trained_on_readings_in_units_of_their_size(tmp_path, monkeypatch):
    pytest.importorskip("onnxscript", reason="needs the extra 'export'")
    onnxruntime = pytest.importorskip("onnxruntime", reason="needs the extra 'export'")
    fnn = find_model("fnn")
    only = type(fnn)(
        fnn.name,
        fnn.title,
        fnn.class_name,
        lambda task: [{"transform": task.transform(normalized=True)}],
        {"widths": [16], "pools": [1]},
    )
    monkeypatch.setitem(compared_models._BY_NAME, "fnn", only)
    monkeypatch.setattr(compared_models, "MODELS", (only,))
    touches(tmp_path / "a.npz")
    source = data_source(tmp_path / "a.npz", grid="3x4")
    settings = ComparisonSettings(models=("fnn",), folds=3, epochs=20, members=2)
    comparison = comparing.compare(source, settings, tmp_path / "out")
    assert comparison.of("fnn").scores["accuracy"].mean > 0.6  # of three classes
    predictor = deploy(comparison, "fnn")
    x = source.resolve()[0].load().data.x
    expected = predictor(x)
    assert expected.allclose(predictor(1000 * x), atol=1e-4)  # strength does not count
    predictor.save(tmp_path / "a.predictor")
    assert Predictor.load(tmp_path / "a.predictor")(x).equal(expected)
    assert export_onnx(predictor, tmp_path / "a.onnx").difference < 1e-5
    session = onnxruntime.InferenceSession(tmp_path / "a.onnx")
    (name,) = (one.name for one in session.get_inputs())
    found = np.concatenate([session.run(None, {name: one})[0] for one in x.numpy()[:, None]])
    np.testing.assert_allclose(found, expected, atol=1e-5)


def network_settings(name, task):
    return find_model(name).to_cell(task).choice.settings


def augmentations(settings):
    """The steps of the augmentation of each setting, by their names."""
    augmented = [setting["train_transform"] for setting in settings if "train_transform" in setting]
    steps = [transform["init_args"]["transforms"] for transform in augmented]
    return [{one["class_path"].rpartition(".")[2]: one["init_args"] for one in s} for s in steps]


@pytest.mark.parametrize("name", ["taxel_net", "cnn"])
def test_images_are_shifted_by_a_sixteenth_in_training(name):
    for size, shift in (((32, 15), (2, 1)), ((28, 50), (2, 3)), ((8, 8), (1, 1))):
        task = ComparedTask(grid(*size, 0.01), "accuracy", 100)
        found = augmentations(network_settings(name, task))
        mirrors = set() if task.num_taxels > 500 else {"RandomMirror"}  # of few: they take long
        assert {"RandomShift"} | mirrors == {step for steps in found for step in steps}
        assert all(s["RandomShift"] == {"rows": shift[0], "columns": shift[1]} for s in found)
        assert network_settings(name, task)[0] == {}


@pytest.mark.parametrize("layout", ["biotac_sp", "allegro_uskin", grid(7, 20, 0.01)])
def test_readings_that_are_no_image_are_not_shifted(layout):
    task = ComparedTask(as_layout(layout), "accuracy", 100)
    for model in MODELS:
        if not model.obstacle(task):
            assert not augmentations(model.to_cell(task).choice.settings)


@pytest.mark.parametrize("name", ["taxel_net", "cnn"])
def test_mirror_images_are_of_one_channel(name):
    """Of shear, a mirror image has another sign."""
    task = ComparedTask(grid(8, 8, 0.01), "accuracy", 100, num_channels=3)
    found = augmentations(network_settings(name, task))
    assert found
    assert all("RandomMirror" not in steps for steps in found)


@pytest.mark.parametrize("name", ["taxel_net", "cnn"])
def test_one_setting_with_shifts_is_trained_on_many_images_of_many_taxels(name):
    task = ComparedTask(grid(28, 50, 0.01), "accuracy", 800)
    assert task.is_slow
    (steps,) = augmentations(network_settings(name, task))
    assert steps == {"RandomShift": {"rows": 2, "columns": 3}}
    assert len(network_settings(name, task)) == 1


def test_windows_are_also_judged_as_a_whole():
    task = ComparedTask(biotac(), "accuracy", 100, num_frames=60, num_channels=3)
    settings = network_settings("temporal", task)
    arguments = [s.get("model", {}).get("init_args", {}) for s in settings]
    assert settings[0] == {}
    assert {a.get("pool", "last") for a in arguments} == {"last", "mean", "mean_max"}
    assert any(a.get("mixed_channels") for a in arguments)
    for name in ("temporal", "temporal_cnn"):
        (steps,) = augmentations(network_settings(name, task))
        assert steps == {"RandomTimeShift": {"steps": 3}}


@pytest.mark.full
@pytest.mark.parametrize("num_frames", [None, 9])
def test_each_setting_of_a_network_can_be_trained(tmp_path, num_frames):
    """On an image of 8 x 8 taxels, or windows of it."""
    rng = np.random.default_rng(0)
    x = rng.normal(size=(30, 64, num_frames or 1)).astype(np.float32)
    np.savez(tmp_path / "a.npz", x=x, y=np.arange(30) % 3, trial=np.arange(30))
    axis = {} if num_frames is None else {"time_axis": 2}
    source = data_source(tmp_path / "a.npz", grid="8x8", **axis)
    names = ["taxel_net", "cnn", "fnn"]
    names += [] if num_frames is None else ["temporal", "temporal_cnn"]
    settings = ComparisonSettings(models=tuple(names), folds=3, epochs=1, members=1)
    plan = comparing.comparison_plan(source, settings)
    for experiment in plan.experiments[: len(names)]:
        for setting in experiment.choice.settings:
            alone = replace(experiment.choice, settings=[setting], repeats=1)
            result = run_experiment(replace(experiment, choice=alone))
            assert 0 <= result["metrics"]["accuracy"] <= 1


def test_an_augmentation_is_of_training_only(tmp_path):
    """Training on images that are shifted out of sight learns nothing."""
    touches(tmp_path / "a.npz")
    source = data_source(tmp_path / "a.npz", grid="3x4")
    settings = ComparisonSettings(models=("fnn",), folds=3, epochs=20, members=1)
    plan = comparing.comparison_plan(source, settings)
    far = {"class_path": f"{SHIFT}.RandomShift", "init_args": {"rows": 100, "columns": 100}}
    scores, codes = [], []
    for over in ({}, {"train_transform": far}):
        experiment = plan.experiments[0]
        choice = replace(experiment.choice, settings=[over])
        experiment = replace(experiment, choice=choice)
        scores.append(run_experiment(experiment)["metrics"]["accuracy"])
        codes.append(experiment.with_setting(over).code)
    assert scores[0] > scores[1] + 0.2
    assert codes[0] != codes[1]


def test_a_saved_model_has_no_augmentation(tmp_path, monkeypatch):
    touches(tmp_path / "a.npz")
    fnn = find_model("fnn")
    small = {"class_path": f"{SHIFT}.RandomShift", "init_args": {"rows": 0, "columns": 0}}
    only = replace(fnn, settings=[{"train_transform": small}])
    monkeypatch.setitem(compared_models._BY_NAME, "fnn", only)
    monkeypatch.setattr(compared_models, "MODELS", (only,))
    source = data_source(tmp_path / "a.npz", grid="3x4")
    settings = ComparisonSettings(models=("fnn",), folds=3, epochs=2, members=1)
    predictor = deploy(comparing.compare(source, settings, tmp_path / "out"), "fnn")
    assert "RandomShift" not in str(predictor.preparation.transform)


@pytest.mark.parametrize("name", ["temporal", "temporal_cnn", "taxel_net", "cnn", "fnn", "lstm"])
def test_fewer_settings_are_tried_on_many_samples(name):
    tasks = [
        ComparedTask(grid(8, 8, 0.01), "accuracy", count, num_frames=9) for count in (1000, 1001)
    ]
    few, many = (network_settings(name, task) for task in tasks)
    assert few[0] == many[0] == {}
    assert len(many) < len(few)
    assert all(setting in few for setting in many)
    assert "NormalizeRMS" not in str(many)
