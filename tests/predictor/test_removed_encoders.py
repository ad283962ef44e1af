"""Files of `tactile pretrain` and of models that began with such an encoder."""

import json

import pytest
import torch

from torch_geometric_tactile import Predictor
from torch_geometric_tactile.cli import main
from torch_geometric_tactile.nn import TaxelNet
from torch_geometric_tactile.predictor import _content
from torch_geometric_tactile.predictor._content import build_model
from torch_geometric_tactile.predictor._tensor_file import read_tensors, write_tensors
from torch_geometric_tactile.sensors import grid

LAYOUT = grid(2, 2, pitch=0.01)
LAST_READER = "version 0.2.1 is the last version that reads it"
ENCODER = {"class": "TaxelEncoder", "arguments": {"layout": {"$layout": None}, "out_channels": 1}}


@pytest.fixture
def encoder_path(tmp_path):
    """A file as `PretrainedEncoder.save` wrote it."""
    header = {
        "format": 1,
        "package": "0.2.1",
        "layout": LAYOUT.to_dict(),
        "model": ENCODER,
        "trained_on": {"num_trials": 20},
    }
    texts = {"torch_geometric_tactile.encoder": json.dumps(header)}
    write_tensors({"model.lin.weight": torch.zeros(3, 4)}, texts, tmp_path / "skin.encoder")
    return tmp_path / "skin.encoder"


def save_predictor(path, model=ENCODER, transform=None):
    """Writes the file of a predictor whose header describes other parts."""
    Predictor(TaxelNet(LAYOUT, 2, in_channels=1), LAYOUT, num_channels=1).save(path)
    tensors, texts, _ = read_tensors(path)
    header = json.loads(texts[_content._HEADER_KEY])
    header |= {"model": model, "transform": transform}
    write_tensors(tensors, {_content._HEADER_KEY: json.dumps(header)}, path)


def test_encoder_file_names_the_last_version_that_reads_it(encoder_path):
    with pytest.raises(ValueError, match=f"a pretrained encoder: {LAST_READER}"):
        Predictor.load(encoder_path)


@pytest.mark.parametrize(
    "argv",
    [
        ["predict", "{}", "trial.npz"],
        ["live", "sim:", "--model", "{}"],
        ["export", "{}", "model.onnx"],
    ],
)
def test_command_with_an_encoder_file(argv, encoder_path, capsys):
    pytest.importorskip("matplotlib", reason="needs the extra 'viz'")
    assert main([word.format(encoder_path) for word in argv]) == 1
    error = capsys.readouterr().err
    assert "skin.encoder" in error
    assert LAST_READER in error


@pytest.mark.parametrize(
    ("parts", "name"),
    [
        ({}, "TaxelEncoder"),
        (
            {"model": {"class": "AverageModel", "arguments": {"models": [{"$model": ENCODER}]}}},
            "TaxelEncoder",
        ),
        ({"model": {"own": "TunedEncoder", "text": "TunedEncoder()"}}, "TunedEncoder"),
        ({"transform": {"own": "EncoderScale", "text": "EncoderScale()"}}, "EncoderScale"),
    ],
)
def test_predictor_with_an_encoder_names_the_last_version(parts, name, tmp_path):
    save_predictor(tmp_path / "a.predictor", **parts)
    with pytest.raises(ValueError, match=f"{name} was removed: {LAST_READER}"):
        Predictor.load(tmp_path / "a.predictor")


def test_checkpoint_of_an_encoder_names_the_last_version(tmp_path):
    save_predictor(tmp_path / "a.predictor")
    tensors, texts, _ = read_tensors(tmp_path / "a.predictor")
    entry = {"header": json.loads(texts[_content._HEADER_KEY]), "tensors": tensors}
    torch.save({"predictor": entry, "state_dict": tensors}, tmp_path / "last.ckpt")
    with pytest.raises(ValueError, match=f"TaxelEncoder was removed: {LAST_READER}"):
        Predictor.from_checkpoint(tmp_path / "last.ckpt")
    with pytest.raises(ValueError, match=f"TaxelEncoder was removed: {LAST_READER}"):
        build_model({"description": ENCODER, "tensors": {}}, {}, LAYOUT)
