import json
from pathlib import Path

import numpy as np
import pytest
import torch

from torch_geometric_tactile import Predictor
from torch_geometric_tactile.cli import main
from torch_geometric_tactile.data import LiveFrame, Recording
from torch_geometric_tactile.io import write_recording
from torch_geometric_tactile.live import Judge
from torch_geometric_tactile.nn import TactileFNN
from torch_geometric_tactile.predictor import export_onnx, predictor_path, stock_predictors
from torch_geometric_tactile.sensors import grid

DOCS = Path(__file__).parents[2] / "docs"
NAMES = ["biotac_sp_slip", "pressure_mat_side", "simulated_hand_shape"]
# Logarithms of the probabilities of the second of `frames`; the first is the reading at rest.
LOG_PROBABILITIES = {
    "biotac_sp_slip": [-0.002892, -5.847242],
    "pressure_mat_side": [-1.489017, -0.619714, -1.44262],
    "simulated_hand_shape": [-1.968177, -1.583153, -2.109982, -0.627881],
}
NO_FILE = (
    r"there is no predictor or checkpoint '{}': give the path of a file from Predictor\.save, "
    r"'tactile predict --save' or 'tactile fit', or one of \['biotac_sp_slip', "
    r"'pressure_mat_side', 'simulated_hand_shape'\]"
)


def frames(predictor):
    """A frame of zeros, and one with a slope over the taxels, in counts."""
    size = (predictor.layout.num_taxels, predictor.preparation.num_channels)
    slope = torch.arange(size[0] * size[1]).view(size) * 11 % 300
    return torch.stack([torch.zeros(size), slope.float()])


def adapted(name):
    predictor = Predictor.load(name)
    if predictor.measures_rest:
        predictor.contact = None
        predictor.adapt(frames(predictor)[:1])
    return predictor


def small_predictor():
    torch.manual_seed(0)
    return Predictor(TactileFNN(4, 2, widths=(5,), pools=(1,)), grid(2, 2, pitch=0.01))


def test_the_names_are_those_of_the_cards():
    assert stock_predictors() == NAMES == sorted(LOG_PROBABILITIES)
    page = (DOCS / "pretrained.md").read_text(encoding="utf-8")
    assert [name for name in NAMES if f"## `{name}`" not in page] == []


@pytest.mark.parametrize("name", NAMES)
def test_a_stock_predictor_answers_as_when_it_was_written(name):
    predictor = adapted(name)
    probability = predictor(frames(predictor)[1])
    assert probability.log().tolist() == pytest.approx(LOG_PROBABILITIES[name], abs=1e-3)


@pytest.mark.parametrize("name", NAMES)
def test_a_stock_predictor_is_as_its_card_says(name):
    predictor, size = Predictor.load(name), predictor_path(name).stat().st_size
    card = json.loads((DOCS / "results" / "pretrained.json").read_text(encoding="utf-8"))[name]
    assert str(predictor.score) == card["score"]
    assert size == card["bytes"] < 1_000_000
    assert predictor.preparation.info.unit == "count"
    page = (DOCS / "pretrained.md").read_text(encoding="utf-8")
    section = page.partition(f"## `{name}`")[2].partition("\n## ")[0]
    layout, channels = predictor.layout, predictor.preparation.num_channels
    for text in (
        f"{100 * card['accuracy']['mean']:.1f}",
        f"{100 * card['baselines']['forest']['mean']:.1f}",
        f"{100 * card['baselines']['most frequent class']['mean']:.1f}",
        f"{layout.num_taxels:,} taxels, {channels} channel",
        ", ".join(f"`{label}`" for label in predictor.class_names),
    ):
        assert text in section, text


def test_an_unknown_name_lists_the_names(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for read in (Predictor.load, Judge, predictor_path):
        with pytest.raises(FileNotFoundError, match=NO_FILE.format("biotac_slip")):
            read("biotac_slip")
    with pytest.raises(FileNotFoundError, match=NO_FILE.format("biotac_sp_slip")):
        Predictor.load(Path("biotac_sp_slip"))  # a path is no name


def test_an_existing_file_has_precedence_over_a_name(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "pressure_mat_side").mkdir()  # a folder is no predictor
    small_predictor().save("biotac_sp_slip")
    assert Predictor.load("biotac_sp_slip").layout.num_taxels == 4
    assert Predictor.load("pressure_mat_side").layout.num_taxels == 2048


def test_judge_takes_a_name():
    predictor = adapted("biotac_sp_slip")
    frame = frames(predictor)[1]
    judgement = Judge("biotac_sp_slip")(LiveFrame(0, 0.0, 0, None, frame.numpy()))
    assert judgement.probability == pytest.approx(predictor(frame).numpy(), abs=1e-6)


@pytest.mark.parametrize("name", NAMES)
def test_a_stock_predictor_is_exported(name, tmp_path):
    pytest.importorskip("onnxscript", reason="needs the extra 'export'")
    assert export_onnx(Predictor.load(name), tmp_path / "a.onnx").difference < 1e-5


def test_commands_take_a_name(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    predictor = adapted("biotac_sp_slip")
    x = frames(predictor).numpy()
    write_recording(Recording(time=np.arange(2) / 100, tactile=x), "grasps.npz")
    assert main(["predict", "biotac_sp_slip", "grasps.npz", "--no-picture"]) == 0
    out = capsys.readouterr().out
    assert out.startswith(f"biotac_sp_slip was selected for {predictor.score}\n")
    last = (tmp_path / "predictions.csv").read_text().splitlines()[-1].split(",")
    expected = np.exp(LOG_PROBABILITIES["biotac_sp_slip"])
    assert [float(text) for text in last[-2:]] == pytest.approx(expected, abs=1e-5)
    assert main(["live", "grasps.npz", "--model", "biotac_sp_slip", "--policy", "all"]) == 0
    assert "2 frames, 2 judged" in capsys.readouterr().err
    assert main(["predict", "biotac_slip", "grasps.npz"]) == 1
    assert "or one of ['biotac_sp_slip', " in capsys.readouterr().err
