import re
from pathlib import Path

import onnx_predictors as made
import pytest

from torch_geometric_tactile.cli import main
from torch_geometric_tactile.live import OnnxModel

for extra in ("onnx", "onnxscript", "onnxruntime"):
    pytest.importorskip(extra, reason="needs the extra 'export'")

pytestmark = pytest.mark.xdist_group("onnx_predictors")  # which makes each file once


@pytest.mark.slow
def test_export_writes_a_graph(tmp_path, capsys):
    made.predictor("tare").save(tmp_path / "a.predictor")
    path = tmp_path / "a.onnx"
    assert main(["export", str(tmp_path / "a.predictor"), str(path), "--unit", "count"]) == 0
    out = capsys.readouterr().out
    assert f"wrote {path}: Predictor(TactileGCN, 'small'" in out
    assert "inputs:  tactile (1, 11, 3), rest (11, 3)" in out
    assert "outputs: probability (1, 2)" in out
    assert "largest difference from PyTorch: " in out
    assert "one thread: " in out
    assert OnnxModel(path).info["unit"] == "count"


def test_export_asks_for_its_suffix(tmp_path, capsys):
    assert main(["export", "a.predictor", str(tmp_path / "a.bin")]) == 1
    assert "'FILE.onnx' must end in .onnx" in capsys.readouterr().err


def test_export_needs_its_extra(tmp_path, capsys, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "onnxscript", None)
    made.predictor("tare").save(tmp_path / "a.predictor")
    assert main(["export", str(tmp_path / "a.predictor"), str(tmp_path / "a.onnx")]) == 1
    line = "pip install 'torch-geometric-tactile[export]'"
    assert f"a graph needs onnxscript: {line}" in capsys.readouterr().err


def test_export_names_what_is_not_there(tmp_path, capsys):
    assert main(["export", str(tmp_path / "no"), str(tmp_path / "a.onnx")]) == 1
    assert "there is no predictor or checkpoint" in capsys.readouterr().err


@pytest.mark.full
@pytest.mark.slow
def test_the_page_runs_with_onnxruntime_alone(tmp_path, monkeypatch, capsys):
    page = (Path(__file__).parents[2] / "docs" / "predictor.md").read_text()
    (code,) = re.findall(r"```python\n(import json\n.*?)```", page, re.DOTALL)
    (tmp_path / "grasp.onnx").write_bytes(made.onnx_file("tare").read_bytes())
    monkeypatch.chdir(tmp_path)
    exec(code, {})
    assert capsys.readouterr().out.startswith("{'ball': np.float32(0.")
