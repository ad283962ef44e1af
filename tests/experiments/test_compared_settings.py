"""Settings of compared models: which are tried, how cheaply, and as those of networks."""

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
from torch_geometric_tactile.experiments._compared_models import MODELS, model_of
from torch_geometric_tactile.experiments._compared_task import ComparedTask
from torch_geometric_tactile.experiments.compared_windows import data_source
from torch_geometric_tactile.experiments.comparison import ComparisonSettings
from torch_geometric_tactile.experiments.deploy import deploy
from torch_geometric_tactile.predictor import export_onnx
from torch_geometric_tactile.sensors import grid


@pytest.mark.parametrize("num_frames", [None, 3, 60])
@pytest.mark.parametrize("size", [(3, 4), (30, 20)])
def test_each_setting_of_a_forest_has_features_of_its_own(size, num_frames):
    layout = grid(*size, 0.004)
    task = ComparedTask(layout, "accuracy", 100, num_frames=num_frames, num_channels=2)
    settings = model_of("descriptors_forest").to_cell(task).choice.settings
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
    cell = model_of(name).to_cell(task)
    assert cell.choice.draft == {"init_args": {"num_trees": 100}}
    assert "num_trees" not in cell.estimator["init_args"]  # the default of 300 to be tested


def test_only_forests_have_a_draft():
    task = ComparedTask(grid(3, 4, 0.004), "accuracy", 100)
    names = [model.name for model in MODELS if model.to_cell(task).choice.draft]
    assert names == ["forest", "descriptors_forest", "posed_forest"]


def test_a_network_may_be_trained_on_readings_in_units_of_their_size(tmp_path, monkeypatch):
    pytest.importorskip("onnxscript", reason="needs the extra 'export'")
    onnxruntime = pytest.importorskip("onnxruntime", reason="needs the extra 'export'")
    fnn = model_of("fnn")
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
