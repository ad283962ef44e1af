r"""The part of a table's page on studies."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("lightning", reason="needs the extra 'train'")
pytest.importorskip("matplotlib", reason="needs the extra 'viz'")

from torch_geometric_tactile.data import Protocol
from torch_geometric_tactile.experiments.plan import PlanRun, make_plan
from torch_geometric_tactile.experiments.run_plan import run_plan
from torch_geometric_tactile.experiments.source import DataSource
from torch_geometric_tactile.experiments.tables import Cell, Table, TableProtocol
from torch_geometric_tactile.papers._table_studies import study_lines, study_pictures
from torch_geometric_tactile.papers.write_table import markdown, write_table

_STUDIES = "torch_geometric_tactile.papers."
_LOOKS = [
    {"class_path": f"{_STUDIES}FrameTime", "init_args": {"num_calls": 2}},
    {"class_path": f"{_STUDIES}DeadRows", "init_args": {"num_rows": [0, 4]}},
    {"class_path": "torch_geometric_tactile.experiments.Confusion"},
]
_NETWORK = [
    *_LOOKS,
    {"class_path": f"{_STUDIES}TrainingHistory"},
    {"class_path": f"{_STUDIES}LayerProbes"},
    {"class_path": f"{_STUDIES}FeatureEmbedding"},
    {"class_path": f"{_STUDIES}FeatureMaps", "init_args": {"class_name": "bar"}},
]
_FOREST = {"class_path": "torch_geometric_tactile.baselines.flat_forest"}


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> PlanRun:
    folder = tmp_path_factory.mktemp("studies")
    rng = np.random.default_rng(0)
    x = rng.uniform(0.0, 0.1, (40, 20, 20)).astype(np.float32)
    x[::2, 5:8] += 1.0
    np.savez(folder / "bars.npz", x=x, y=np.array(["bar", "none"] * 20))
    config = {
        "model": {
            "model": {"class_path": "torch_geometric_tactile.nn.models.BMFCNN"},
            "optimizer": {"class_path": "torch.optim.Adam", "init_args": {"lr": 0.003}},
        },
        "data": {"batch_size": 5},
        "trainer": {"max_epochs": 2},
    }
    source = DataSource(
        "torch_geometric_tactile.datasets.SamplesFile",
        {"path": str(folder / "bars.npz"), "grid": "20x20"},
        kind="simulated",
    )
    network: dict[str, Any] = {"config": config, "studies": _NETWORK}
    table = Table(
        name="bars",
        title="Bars",
        data=source,
        protocols=(TableProtocol("random", Protocol("frame", folds=2, stratify="y")),),
        cells=(
            Cell(
                "net", "", "net", layers={"C1": 45.7}, published={"milliseconds": 0.47}, **network
            ),
            Cell("net", "again", "same", **network),
            Cell("forest", "", "forest", estimator=_FOREST, studies=_LOOKS),
        ),
        seeds=1,
        measure_memory=False,
        measured_on="real array",
    )
    return run_plan(make_plan(table), folder / "out")


def test_page_shows_what_was_found(run: PlanRun) -> None:
    text = "\n".join(study_lines(run))
    assert "### Accuracy of single layers in %" in text
    assert "| net | published | 45.7 |" in text
    assert "| model | 0 dead | 4 dead |" in text
    time = next(line for line in text.split("\n") if line.startswith("| net |") and "0.47" in line)
    assert "100.0 ± 0.0" in time
    assert "* net, accuracy of a class in %: best " in text
    assert "again" not in text  # one configuration is shown once
    assert "`bars-training.png`" in text
    assert text in markdown(run)


def test_one_fold_has_no_deviation(run: PlanRun) -> None:
    first = [(e, r) for e, r in run.results if r.get("studies")]
    text = "\n".join(study_lines(run._replace(results=first)))
    assert "100.0 |" in text
    assert "nan" not in text


def test_pictures_of_studies_are_written_beside_the_table(run: PlanRun, tmp_path: Path) -> None:
    names = {
        "training",
        "t-sne",
        "maps-net",
        "confusion-net",
        "confusion-forest",
        "dead-rows",
    }
    assert set(study_pictures(run)) == names
    paths = write_table(run, tmp_path)
    assert {path.name for path in paths} >= {f"bars-{name}.png" for name in names}
    assert all(path.stat().st_size > 1000 for path in paths if path.suffix == ".png")


def test_table_without_studies_has_no_such_part(run: PlanRun) -> None:
    plain = run._replace(results=[(e, {**r, "studies": {}}) for e, r in run.results])
    without = [(e, {k: v for k, v in r.items() if k != "studies"}) for e, r in plain.results]
    assert study_lines(run._replace(results=without)) == []
    assert study_pictures(run._replace(results=without)) == {}
