import json

import pytest
import torch
from small_models import LAYOUT, samples

from torch_geometric_tactile.nn import TaxelEncoder, TaxelNet
from torch_geometric_tactile.predictor import PretrainedEncoder
from torch_geometric_tactile.predictor._tensor_file import read_tensors, write_tensors
from torch_geometric_tactile.sensors import grid

KEY = "torch_geometric_tactile.encoder"
TOLD = {"num_trials": 20, "source": "day1", "rest": None}


def small(**more):
    torch.manual_seed(0)
    sizes = {"in_channels": 2, "hidden_channels": 6, "num_layers": 1, "embedding_channels": 5}
    model = TaxelEncoder(LAYOUT, 1, **{**sizes, **more})
    return PretrainedEncoder(model.fit_scale(3 * samples(20, 11, 2) + 1), LAYOUT, TOLD)


@pytest.fixture
def path(tmp_path):
    small().save(tmp_path / "skin.encoder")
    return tmp_path / "skin.encoder"


def changed(path, change):
    """Writes the file again, with another header and a right checksum."""
    tensors, texts, _ = read_tensors(path)
    header = json.loads(texts[KEY])
    change(header)
    write_tensors(tensors, {KEY: json.dumps(header)}, path)


def test_encoder_file_repr_and_words():
    encoder = small()
    assert str(encoder) == (
        "PretrainedEncoder('small', num_taxels=11, num_channels=2, embedding_channels=5)"
    )
    assert encoder.describe() == (
        "layout 'small', 11 taxels of 2 channels: num trials 20; source day1"
    )
    assert PretrainedEncoder(encoder.model, LAYOUT).describe().endswith("2 channels")


def test_encoder_embeds_in_parts(monkeypatch):
    encoder, x = small(), samples(9, 11, 2)
    whole = encoder.embed(x)
    assert whole.shape == (9, 5)
    assert not whole.requires_grad
    monkeypatch.setattr("torch_geometric_tactile.predictor.pretrained_encoder._AT_ONCE", 50)
    torch.testing.assert_close(encoder.embed(x.double()), whole)
    assert encoder.embed(x[:0]).shape == (0, 5)


def test_encoder_file_keeps_all(path):
    encoder, loaded = small(), PretrainedEncoder.load(path)
    assert loaded.embed(samples(4, 11, 2)).equal(encoder.embed(samples(4, 11, 2)))
    assert loaded.trained_on == TOLD
    assert loaded.layout.to_dict() == LAYOUT.to_dict()
    assert loaded.model.center.equal(encoder.model.center)
    assert not loaded.model.training


def test_encoder_checks_the_sensor():
    encoder = small()
    encoder.check(LAYOUT, 2)
    with pytest.raises(ValueError, match=r"'encoder' must be .* 3 channels \(got .*num trials 20"):
        encoder.check(LAYOUT, 3)
    with pytest.raises(ValueError, match=r"layout 'grid_1x11' with 11 taxels"):
        encoder.check(grid(1, 11, 0.01), 2)
    with pytest.raises(ValueError, match=r"'layout' must have the 11 taxels .* \(got 4\)"):
        PretrainedEncoder(encoder.model, grid(2, 2, 0.01))


def test_encoder_file_missing(tmp_path):
    with pytest.raises(FileNotFoundError, match="write one with: tactile pretrain"):
        PretrainedEncoder.load(tmp_path / "none.encoder")


def test_every_flipped_byte_is_noticed(path):
    data = path.read_bytes()
    for place in range(0, len(data), 97):
        path.write_bytes(data[:place] + bytes([data[place] ^ 4]) + data[place + 1 :])
        with pytest.raises(ValueError, match="no encoder that can be read here"):
            PretrainedEncoder.load(path)


@pytest.mark.parametrize(
    ("key", "value", "match"),
    [
        ("format", 2, "format must be 1"),
        ("trained_on", {"a": [1]}, "numbers and texts"),
        ("trained_on", None, "numbers and texts"),
        ("layout", {}, "no encoder"),
        ("model", {"class": "TaxelNet", "arguments": {}}, r"TaxelEncoder \(got TaxelNet\)"),
        ("model", {"own": "Evil", "text": "Evil()"}, r"TaxelEncoder \(got None\)"),
        ("model", {"class": "TaxelEncoder", "arguments": {"hidden_channels": 10**9}}, "no encoder"),
    ],
)
def test_hostile_header(path, key, value, match):
    changed(path, lambda header: header.update({key: value}))
    with pytest.raises(ValueError, match=f"(?s)no encoder that can be read here.*{match}|{match}"):
        PretrainedEncoder.load(path)


def test_file_of_another_kind(path, tmp_path):
    from torch_geometric_tactile.predictor import Predictor

    other = tmp_path / "a.predictor"
    Predictor(TaxelNet(LAYOUT, 2, in_channels=2), LAYOUT, num_channels=2).save(other)
    with pytest.raises(ValueError, match="not a file of 'tactile pretrain'"):
        PretrainedEncoder.load(other)
    with pytest.raises(ValueError, match="not a file of Predictor"):
        Predictor.load(path)
