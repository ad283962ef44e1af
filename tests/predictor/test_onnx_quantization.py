# ruff: noqa: E402
"""Weights of eight bits: what they change is measured, and written to the file."""

import json

import numpy as np
import pytest

for extra in ("onnx", "onnxscript", "onnxruntime"):
    pytest.importorskip(extra, reason="needs the extra 'export'")

import onnx
import torch
from torch_geometric.transforms import Compose

from torch_geometric_tactile import Predictor
from torch_geometric_tactile import transforms as T
from torch_geometric_tactile.cli import main
from torch_geometric_tactile.data import Recording, StaticData, StaticDataset, Windows
from torch_geometric_tactile.io import write_recording
from torch_geometric_tactile.live import Judge, OnnxModel
from torch_geometric_tactile.nn.models import TactileFNN
from torch_geometric_tactile.predictor import export_onnx
from torch_geometric_tactile.predictor._network import Network
from torch_geometric_tactile.predictor._onnx_quantization import compare_predictions
from torch_geometric_tactile.sensors import grid

LAYOUT = grid(8, 8, 0.01)
NAMES = ["ball", "cube", "pen"]
WIDTHS = {"widths": (2736, 16), "pools": (1, 1)}  # 64 * 3 * 2736 = 525,312 weights


def frames(count=120):
    draw = torch.Generator().manual_seed(3)
    return StaticData(
        x=300 + 20 * torch.randn(count, 64, 3, generator=draw),
        session=torch.zeros(count, dtype=torch.long),
        trial=torch.zeros(count, dtype=torch.long),
        step=torch.arange(count),
        y=torch.arange(count) % 3,
        pos=LAYOUT.pos,
        edge_index=LAYOUT.edge_index("original"),
    )


def predictor(length=None, widths=WIDTHS, task="multiclass", tare=True):
    torch.manual_seed(0)
    data = StaticDataset._from_samples((frames(), {"class": NAMES}), LAYOUT, None, None, None)
    data = data if length is None else Windows(data, length)
    transform = Compose([*([T.Tare(first=10)] if tare else []), T.ZScore()])
    T.fit_parts(transform, data)
    channels = {} if length is None else {"channels": {"tactile": 3 * length}}
    model = TactileFNN(64, 3, **channels, **widths).eval()
    return Predictor.from_dataset(model, data, transform, task)


def recording(count=60, missing=False):
    tactile = frames(count).x.numpy()
    if missing:
        tactile[:, 5] = np.nan
    return Recording(time=np.arange(count) / 100, tactile=tactile)


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    path = tmp_path_factory.mktemp("onnx") / "eight.onnx"
    export_onnx(predictor(), path, quantize=True, check=[recording()], rest=0.2)
    return path


@pytest.mark.full
def test_the_file_says_what_it_changes(path, tmp_path):
    info = OnnxModel(path).info["quantization"]
    assert info["bits"] == 8
    assert info["weights"] == 64 * 3 * 2736
    assert info["frames"] == "recordings"
    assert info["num_answers"] == 60
    assert 0.95 < info["equal_labels"] <= 1
    assert 0 < info["largest_change"] < 0.02
    plain = export_onnx(predictor(), tmp_path / "single.onnx")
    assert plain.metadata["quantization"] is None
    assert plain.agreement is None
    assert path.stat().st_size < 0.5 * plain.num_bytes
    kinds = {node.op_type for node in onnx.load(path).graph.node}
    assert "DynamicQuantizeLinear" in kinds or "DynamicQuantizeMatMul" in kinds


def test_what_it_says_is_what_changes(path):
    model, reference, record = OnnxModel(path), predictor(), recording()
    still = record.select(slice(20))
    model.measure(still.tactile, still.time, None)
    reference.adapt_recording(record, rest=0.2)
    expected, answers = reference.recording(record).numpy(), model.recording(record)
    info = model.info["quantization"]
    change = float(np.abs(answers - expected).max())
    assert info["largest_change"] == pytest.approx(change, abs=1e-5)
    same = float((answers.argmax(1) == expected.argmax(1)).mean())
    assert info["equal_labels"] == pytest.approx(same)


def test_readers_show_it(path):
    model = OnnxModel(path)
    assert repr(model).startswith(
        "OnnxModel(TactileFNN, 'grid_8x8', classes=['ball', 'cube', 'pen'], "
    )
    assert "weights of 8 bits: " in repr(model)
    assert "on 60 recorded frames" in repr(model)
    assert repr(Judge(path, np.zeros((64, 3)))).startswith("Judge(ONNX, 8 bits, ")


def test_no_other_metadata_stays(path):
    properties = {entry.key for entry in onnx.load(path).metadata_props}
    assert properties == {"torch_geometric_tactile"}
    entry = onnx.load(path).metadata_props[0]
    assert json.loads(entry.value)["sha256"] != 64 * "0"


@pytest.mark.full
def test_windows_of_recordings(tmp_path):
    exported = export_onnx(
        predictor(length=4, widths={"widths": (688, 8), "pools": (1, 1)}, tare=False),
        tmp_path / "windows.onnx",
        quantize=True,
        check=[recording(20), recording(30)],
    )
    assert exported.agreement.num_answers == 17 + 27
    assert 0 < exported.agreement.largest_change < 0.02


@pytest.mark.full
def test_regressions_have_no_labels(tmp_path):
    exported = export_onnx(predictor(task="regression"), tmp_path / "numbers.onnx", quantize=True)
    assert exported.agreement.equal_labels is None
    assert exported.agreement.frames == "random"
    assert str(exported.agreement).startswith("largest change 0.")
    assert "largest change" in repr(OnnxModel(tmp_path / "numbers.onnx"))


def test_bad_arguments(tmp_path):
    file = tmp_path / "model.onnx"
    small = predictor(widths={"widths": (8, 4), "pools": (1, 1)})
    with pytest.raises(ValueError, match=r"at least 524,288 weights .*\(got 1,536 in"):
        export_onnx(small, file, quantize=True)
    with pytest.raises(ValueError, match=r"'check' must be left out without 'quantize' \(got 1\)"):
        export_onnx(small, file, check=[recording()])
    assert not list(tmp_path.iterdir())


@pytest.mark.full
def test_recordings_without_whole_frames_are_refused(tmp_path):
    with pytest.raises(ValueError, match="frames without missing readings to compare"):
        export_onnx(predictor(), tmp_path / "a", quantize=True, check=[recording(missing=True)])
    assert not list(tmp_path.iterdir())


def test_answers_that_one_graph_lacks_are_refused():
    network = Network(torch.nn.Identity(), NAMES)
    single = np.array([[0.2, 0.3, 0.5], [np.nan] * 3, [0.1, 0.8, 0.1]])
    quantized = np.array([[0.2, 0.41, 0.39], [np.nan] * 3, [0.1, 0.8, 0.1]])
    agreement = compare_predictions(single, quantized, network, "random")
    assert agreement.equal_labels == 0.5
    assert agreement.largest_change == pytest.approx(0.11)
    assert agreement.num_answers == 2
    quantized[1] = 0.3
    with pytest.raises(ValueError, match="must be NaN for the same readings"):
        compare_predictions(single, quantized, network, "random")


@pytest.mark.full
def test_command(tmp_path, capsys, monkeypatch):
    predictor().save(tmp_path / "a.predictor")
    write_recording(recording(), tmp_path / "a.npz")
    words = ["export", str(tmp_path / "a.predictor"), str(tmp_path / "a.onnx")]
    given = ["--check", str(tmp_path / "a.npz"), "--rest", "0.2"]
    export = __import__("importlib").import_module("torch_geometric_tactile.commands.export")
    monkeypatch.setattr(export, "_MIN_EQUAL_LABELS", 0.9)
    assert main([*words, "--quantize", *given]) == 0
    out = capsys.readouterr().out
    assert "  eight-bit weights: " in out
    assert "on 60 frames or windows of recordings" in out
    (tmp_path / "a.onnx").unlink()
    monkeypatch.setattr(export, "_MIN_EQUAL_LABELS", 1.1)
    assert main([*words, "--quantize", *given]) == 1
    assert "of the labels agree: export without --quantize" in capsys.readouterr().err
    assert (tmp_path / "a.onnx").is_file()
    assert main([*words, *given]) == 1
    assert "'--check' must be left out without '--quantize'" in capsys.readouterr().err
    assert main([*words, "--quantize", "--rest", "1"]) == 1
    assert "'--rest' must be left out without '--check'" in capsys.readouterr().err
