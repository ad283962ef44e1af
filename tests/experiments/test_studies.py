r"""Studies of the models of a table: on a tiny set of images, whose classes differ plainly."""

import pickle
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

pytest.importorskip("lightning", reason="needs the extra 'train'")

from torch_geometric_tactile.data import Protocol, StaticData
from torch_geometric_tactile.experiments._experiment import Experiment
from torch_geometric_tactile.experiments._run_experiment import run_experiment
from torch_geometric_tactile.experiments.plan import make_plan
from torch_geometric_tactile.experiments.source import DataSource
from torch_geometric_tactile.experiments.studies import Trained
from torch_geometric_tactile.experiments.tables import Cell, Table, TableProtocol
from torch_geometric_tactile.papers.frame_studies import DeadRows, FrameTime
from torch_geometric_tactile.sensors import grid

_STUDIES = "torch_geometric_tactile.papers."
_ALL = [
    {"class_path": f"{_STUDIES}TrainingHistory"},
    {"class_path": f"{_STUDIES}LayerProbes", "init_args": {"num_samples": 30}},
    {"class_path": f"{_STUDIES}FeatureEmbedding", "init_args": {"per_class": 5}},
    {"class_path": f"{_STUDIES}FeatureMaps", "init_args": {"class_name": "1"}},
    {"class_path": f"{_STUDIES}FrameTime", "init_args": {"num_calls": 3}},
    {"class_path": f"{_STUDIES}DeadRows", "init_args": {"num_rows": [0, 20]}},
]


def _samples(path: Path) -> str:
    rng = np.random.default_rng(0)
    x = rng.uniform(0.0, 0.1, (60, 20, 20)).astype(np.float32)
    y = np.arange(60) % 2
    x[y == 0, 5:8] += 1.0  # a bar along a row, or along a column
    x[y == 1, :, 5:8] += 1.0
    np.savez(path, x=x, y=y)
    return str(path)


def _experiment(path: str, model: dict[str, Any], **arguments: Any) -> Experiment:
    source = DataSource(
        "torch_geometric_tactile.datasets.SamplesFile", {"path": path, "grid": "20x20"}
    )
    return Experiment(
        name="one",
        data=source.resolve()[0],
        protocol=Protocol("frame", val=0.0, test=0.4, stratify="y"),
        protocol_name="random",
        model=model,
        **arguments,
    )


_CNN = {
    "model": {"class_path": "torch_geometric_tactile.nn.models.BMFCNN"},
    "optimizer": {"class_path": "torch.optim.Adam", "init_args": {"lr": 0.003}},
}
_FOREST = {
    "class_path": "torch_geometric_tactile.baselines.flat_forest",
    "init_args": {"num_trees": 20},
}


def test_studies_look_into_a_network(tmp_path: Path) -> None:
    path = _samples(tmp_path / "bars.npz")
    found = run_experiment(_experiment(path, _CNN, epochs=3, batch_size=6, studies=_ALL))
    studies = found["studies"]
    assert found["metrics"]["accuracy"] == 1.0
    history = studies["TrainingHistory"]
    assert [len(history[key]) for key in ("train_loss", "test_loss", "test_accuracy")] == [3, 3, 3]
    assert history["train_loss"][-1] < history["train_loss"][0]
    assert history["test_accuracy"][-1] == 1.0
    assert list(history["gradients"]) == ["conv1", "conv2", "conv3", "fc1", "fc2"]
    assert all(list(sizes) == sorted(sizes) for sizes in history["gradients"].values())
    probes = studies["LayerProbes"]
    assert probes["num_samples"] == 30
    assert set(probes["accuracy"]) == {"C1", "bilinear(C1)", "C2", "bilinear(C2)", "C3", "F-C1"}
    assert probes["accuracy"]["F-C1"] == 1.0
    assert np.shape(studies["FeatureEmbedding"]["place"]) == (10, 2)
    assert sorted(studies["FeatureEmbedding"]["label"]) == ["0"] * 5 + ["1"] * 5
    maps = studies["FeatureMaps"]
    assert np.shape(maps["image"]) == (20, 20)
    assert np.shape(maps["maps"]) == np.shape(maps["bilinear"]) == (9, 16, 16)
    assert np.argmax(np.mean(maps["image"], axis=0)) in (5, 6, 7)
    assert studies["FrameTime"]["milliseconds"] > 0
    intact, dead = studies["DeadRows"]["accuracy"]
    assert intact == 1.0
    assert dead == 0.5  # nothing is read at all: one class is said of all


def test_studies_look_into_an_estimator(tmp_path: Path) -> None:
    path = _samples(tmp_path / "bars.npz")
    studies = run_experiment(_experiment(path, _FOREST, studies=_ALL))["studies"]
    assert set(studies) == {"FrameTime", "DeadRows"}
    assert studies["DeadRows"]["accuracy"] == [1.0, 0.5]


def test_studies_are_of_the_first_seed_and_fold_and_part_of_the_identity(tmp_path: Path) -> None:
    path = _samples(tmp_path / "bars.npz")
    looks = [{"class_path": f"{_STUDIES}FrameTime"}]
    table = Table(
        name="mine",
        title="Mine",
        data=DataSource(
            "torch_geometric_tactile.datasets.SamplesFile", {"path": path, "grid": "20x20"}
        ),
        protocols=(TableProtocol("random", Protocol("frame", folds=2)),),
        cells=(Cell("forest", "", "forest", estimator=_FOREST, studies=looks),),
        seeds=2,
    )
    experiments = make_plan(table).experiments
    assert [bool(e.studies) for e in experiments] == [True, False, False, False]
    assert experiments[0].identity()["studies"] == looks
    assert "studies" not in experiments[1].identity()
    assert pickle.loads(pickle.dumps(experiments[0])).code == experiments[0].code
    other = replace(experiments[0], studies=[{"class_path": "torch.nn.ReLU"}])
    with pytest.raises(ValueError, match=r"'studies' must hold studies \(got 'torch.nn.ReLU'\)"):
        run_experiment(other)


class _First(torch.nn.Module):
    r"""Says class 1 where the first row of a grid reads more than the others."""

    def forward(self, x: torch.Tensor, edge_index: torch.Tensor | None = None) -> torch.Tensor:
        rows = x.view(len(x), 4, 4).mean(dim=2)
        return torch.stack([rows[:, 1:].amax(dim=1), rows[:, 0]], dim=1)


def test_dead_rows_read_what_rest_reads() -> None:
    x = torch.full((6, 16, 1), 2.0)
    x[:, :4] = 5.0
    samples = StaticData(x=x, y=torch.ones(6, dtype=torch.long))
    trained = Trained(_First(), samples, samples, ["0", "1"], grid(4, 4, 0.01))
    found = DeadRows(num_rows=(0, 4), seed=1).measure(trained)
    assert found == {"num_rows": [0, 4], "accuracy": [1.0, 0.0]}
    assert torch.equal(trained.test.x, x)  # the caller's samples are as before
    one = DeadRows(num_rows=(1,), seed=1).measure(trained)["accuracy"][0]
    assert 0.0 < one < 1.0  # the first row is one of four


def test_frame_time_counts_its_calls_and_leaves_the_threads_alone() -> None:
    samples = StaticData(x=torch.rand(3, 16, 1), y=torch.zeros(3, dtype=torch.long))
    trained = Trained(_First(), samples, samples, ["0", "1"], grid(4, 4, 0.01))
    threads = torch.get_num_threads()
    torch.set_num_threads(2)
    try:
        assert FrameTime().measure(trained)["num_calls"] == 3
        assert torch.get_num_threads() == 2
    finally:
        torch.set_num_threads(threads)
