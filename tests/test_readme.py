import re
from pathlib import Path

import pytest
import torch

from torch_geometric_tactile.cli import main

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")


def python_code(page):
    return re.findall(r"```python\n(.*?)```", page, flags=re.DOTALL)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
def test_readme_script_trains_saves_and_loads(tmp_path, monkeypatch):
    pytest.importorskip("lightning", reason="needs the extra 'train'")
    monkeypatch.chdir(tmp_path)
    (code,) = python_code(README)
    assert len(code.splitlines()) == 12
    names = {}
    exec("import numpy; numpy.random.seed(0)\n" + code, names)
    x, y, dataset = names["x"], names["y"], names["dataset"]
    assert names["probabilities"].shape == (2,)
    assert float(names["probabilities"].sum()) == pytest.approx(1, abs=1e-6)
    # The file alone gives what the trained model gives on scaled readings.
    predictor = names["Predictor"].load(tmp_path / "glove.predictor")
    batch = names["module"].transform(dataset.batch(range(800)))
    logits = names["classifier"].model.eval()(batch.x, batch.edge_index)
    assert torch.allclose(predictor(x), logits.softmax(-1), atol=1e-5)
    assert (predictor(x).argmax(-1).numpy() == y).mean() > 0.7  # half would be chance


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
def test_own_data_page_leads_from_files_to_a_predictor(tmp_path, monkeypatch, capsys):
    pytest.importorskip("lightning", reason="needs the extra 'train'")
    monkeypatch.chdir(tmp_path)
    page = (ROOT / "docs" / "your_own_data.md").read_text(encoding="utf-8")
    names = {}
    for code in python_code(page):
        exec(code, names)
    assert len(names["dataset"]) == 3 * 6 * 40
    assert names["metrics"]["test/accuracy"] > 0.9  # the generated grasps are easy to tell apart
    assert names["probabilities"].shape == (2,)
    (config,) = re.findall(r"```yaml\n(.*?)```", page, flags=re.DOTALL)
    quiet = "  enable_progress_bar: false\n  enable_model_summary: false\n"
    Path("glove.yaml").write_text(config + quiet, encoding="utf-8")
    assert main(["fit", "--config", "glove.yaml"]) == 0
    checkpoint = "runs/glove/version_0/checkpoints/last.ckpt"
    assert checkpoint in capsys.readouterr().out
    assert main(["predict", checkpoint]) == 0
    assert main(["predict", checkpoint, "--save", "again.predictor"]) == 0
    rows = Path("predictions.csv").read_text(encoding="utf-8").splitlines()
    assert rows[0] == "index,prediction,p_pinch,p_power"
    again = names["Predictor"].load("again.predictor")
    assert again.class_names == ("pinch", "power")


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
def test_models_examples_run(tmp_path, monkeypatch):
    pytest.importorskip("huggingface_hub", reason="one example saves a model for the Hub")
    pytest.importorskip("lightning", reason="one example trains")
    pytest.importorskip("cv2", reason="one example needs the extra 'baselines'")
    monkeypatch.chdir(tmp_path)
    page = (ROOT / "docs" / "models.md").read_text(encoding="utf-8")
    names = {}
    for code in python_code(page):
        exec(code, names)
    assert names["logits"].shape == (32, 6)
    assert type(names["model"]).__name__ == "MTGCN"


def test_time_examples_print_what_they_say(capsys):
    page = (ROOT / "docs" / "time.md").read_text(encoding="utf-8")
    names = {}
    code = "".join(python_code(page))
    exec(code, names)
    said = re.findall(r"^print\(.*\)  # (.*)$", code, flags=re.MULTILINE)
    assert capsys.readouterr().out.splitlines() == said
    assert len(said) == 6


@pytest.mark.parametrize("page", sorted([ROOT / "README.md", *(ROOT / "docs").rglob("*.md")]))
def test_links_to_files_lead_somewhere(page):
    links = re.findall(r"\]\((?!https?:|#)([^)#]+)", page.read_text(encoding="utf-8"))
    missing = [link for link in links if not (page.parent / link).exists()]
    assert not missing
