import re
from pathlib import Path

import pytest
import torch

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
    assert sum(bool(line.strip()) for line in code.splitlines()) == 12
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


def test_models_examples_run(tmp_path, monkeypatch):
    pytest.importorskip("huggingface_hub", reason="one example saves a model for the Hub")
    monkeypatch.chdir(tmp_path)
    page = (ROOT / "docs" / "models.md").read_text(encoding="utf-8")
    names = {}
    for code in python_code(page):
        exec(code, names)
    assert names["logits"].shape == (32, 6)
    assert type(names["model"]).__name__ == "MTGCN"


@pytest.mark.parametrize("page", sorted([ROOT / "README.md", *(ROOT / "docs").rglob("*.md")]))
def test_links_to_files_lead_somewhere(page):
    links = re.findall(r"\]\((?!https?:|#)([^)#]+)", page.read_text(encoding="utf-8"))
    missing = [link for link in links if not (page.parent / link).exists()]
    assert not missing
