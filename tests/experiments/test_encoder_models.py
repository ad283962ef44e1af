import numpy as np
import pytest

pytest.importorskip("lightning", reason="needs the extra 'train'")

import torch
from torch_geometric.data import Data

from torch_geometric_tactile._files import file_sha256
from torch_geometric_tactile.baselines import DescriptorFeatures
from torch_geometric_tactile.data import StaticData, join_frames, split_frames
from torch_geometric_tactile.experiments._compared_models import model_of
from torch_geometric_tactile.experiments._compared_task import ComparedTask
from torch_geometric_tactile.experiments._encoder_models import (
    EncoderFeatures,
    EncoderScale,
    TunedEncoder,
    encoder_forest,
    encoder_svm,
)
from torch_geometric_tactile.nn import TaxelEncoder
from torch_geometric_tactile.predictor import PretrainedEncoder
from torch_geometric_tactile.sensors import grid
from torch_geometric_tactile.transforms import ZScore

LAYOUT = grid(3, 4, pitch=0.004)


@pytest.fixture
def given(tmp_path):
    """The arguments that name a small encoder."""
    torch.manual_seed(0)
    model = TaxelEncoder(LAYOUT, 1, in_channels=2, hidden_channels=6, embedding_channels=5)
    model.fit_scale(4.0 * torch.randn(50, 12, 2) + 3.0)
    path = tmp_path / "skin.encoder"
    PretrainedEncoder(model, LAYOUT).save(path)
    return {"encoder": str(path), "checksum": file_sha256(path)}


def readings(count=6, frames=None):
    x = 4.0 * torch.randn(count, 12, frames or 1, 2, generator=torch.Generator().manual_seed(1))
    return join_frames(x + 3.0)


def test_scale_is_that_of_the_encoder(given):
    model = PretrainedEncoder.load(given["encoder"]).model
    x = readings()
    assert EncoderScale(**given)(Data(x=x)).x.equal(model.scaled(x))
    windows = readings(frames=5)
    scaled = EncoderScale(**given)(StaticData(x=windows, num_frames=5)).x
    frames, raw = split_frames(scaled, 5), split_frames(windows, 5)
    assert frames[:, :, 3].equal(model.scaled(raw[:, :, 3]))


def test_features_are_embedding_descriptors_and_readings(given):
    encoder, x = PretrainedEncoder.load(given["encoder"]), readings(20)
    seen, other = StaticData(x=x[:12]), StaticData(x=x[12:])
    found = EncoderFeatures(LAYOUT, **given, with_readings=True).fit(seen).transform(other)
    scaled = ZScore(scale_per="channel", with_mean=False).fit(seen)(StaticData(x=x[12:]))
    described = DescriptorFeatures(LAYOUT).fit_transform(scaled)  # as of the other models
    np.testing.assert_array_equal(found[:, :5], encoder.embed(x[12:]).numpy())
    np.testing.assert_array_equal(found[:, 5:-24], described)
    np.testing.assert_array_equal(found[:, -24:], x[12:].flatten(1).nan_to_num())
    alone = EncoderFeatures(LAYOUT, **given).fit(seen.x.numpy()).transform(other)
    np.testing.assert_array_equal(alone, found[:, :-24])


def test_features_of_windows_are_of_the_last_and_the_mean_frame(given):
    encoder = PretrainedEncoder.load(given["encoder"])
    data = StaticData(x=readings(frames=4), num_frames=4)
    found = EncoderFeatures(LAYOUT, **given).fit_transform(data)
    x = split_frames(data.x, 4)
    for place, frame in ((0, x[:, :, -1]), (5, x.mean(dim=2))):
        expected = encoder.embed(frame).numpy()
        np.testing.assert_allclose(found[:, place : place + 5], expected, rtol=1e-4, atol=1e-5)
    scaled = ZScore(per="signal", scale_per="channel", with_mean=False).fit(data)(data)
    np.testing.assert_array_equal(found[:, 10:], DescriptorFeatures(LAYOUT).transform(scaled))


@pytest.mark.parametrize("make", [encoder_forest, encoder_svm])
@pytest.mark.parametrize("task", ["multiclass", "regression"])
def test_estimators_fit_and_predict(given, make, task):
    x = readings(40)
    y = (x[:, 0, 0] > 3).long().numpy() if task == "multiclass" else x[:, 0, 0].numpy()
    estimator = make(LAYOUT, task, **given).fit(StaticData(x=x), y)
    assert estimator.predict(StaticData(x=x)).shape == (40,)
    assert estimator.get_params()["encoderfeatures__encoder"] == given["encoder"]
    assert estimator.get_params()["encoderfeatures__balanced"] == (make is encoder_forest)


def test_tuned_encoder_begins_where_the_encoder_ended(given):
    encoder, x = PretrainedEncoder.load(given["encoder"]), readings()
    model = TunedEncoder(**given, out_channels=3).eval()
    scaled = EncoderScale(**given)(Data(x=x)).x
    torch.testing.assert_close(model.embed(scaled), encoder.embed(x), rtol=1e-4, atol=1e-5)
    assert model(scaled).shape == (6, 3)
    assert all(weight.requires_grad for weight in model.parameters())


def test_a_changed_file_is_noticed(given):
    path = given["encoder"]
    other = PretrainedEncoder.load(path)
    other.trained_on = {"num_trials": 3}
    other.save(path)
    with pytest.raises(ValueError, match="has changed since the comparison began"):
        EncoderScale(**given)


def test_models_have_a_place_with_an_encoder_only(given):
    task = ComparedTask(LAYOUT, "accuracy", 100, num_channels=2)
    windows = ComparedTask(LAYOUT, "accuracy", 100, num_frames=5, encoder=given)
    with_encoder = ComparedTask(LAYOUT, "accuracy", 100, num_channels=2, encoder=given)
    for name in ("encoder_forest", "encoder_svm", "encoder_tuned"):
        model = model_of(name)
        assert model.lacks(task) == "no encoder is given ('encoder')"
        assert model.lacks(with_encoder) == ""
        assert bool(model.lacks(windows)) == (name == "encoder_tuned")
        cell = model.to_cell(with_encoder)
        section = cell.estimator or cell.config["model"]["model"]
        assert section["init_args"]["checksum"] == given["checksum"]
