"""Training on samples of different sensors, and networks that are called with PyG's batch."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("lightning", reason="needs the extra 'train'")

import lightning as L
import torch
from mixed_sensors import Gloves, gloves
from own_models import Attention, OneLayer, Ring
from torch.utils.data import ConcatDataset, Subset
from torch_geometric.data import Batch, Data
from torch_geometric.loader import DataLoader

from torch_geometric_tactile import Predictor
from torch_geometric_tactile.data import Protocol, StaticDataset
from torch_geometric_tactile.datasets import FakeTactileDataset
from torch_geometric_tactile.training import (
    TactileDataModule,
    TactileModule,
    classifier_from_config,
)
from torch_geometric_tactile.training._sizes import DataSizes, fill_sizes
from torch_geometric_tactile.transforms import (
    FillMissing,
    GeometricEdgeAttr,
    KNNGraph,
    RandomNoise,
    ZScore,
)

SCRIPT = Path(__file__).parent / "mixed_on_two_processes.py"
_OF_PROCESSES = ("LOCAL_RANK", "NODE_RANK", "WORLD_SIZE", "MASTER_ADDR", "MASTER_PORT")
BY_SUBJECT = Protocol("group", val=0.25, test=0.25)


def trainer(**arguments):
    off = ("logger", "enable_checkpointing", "enable_progress_bar", "enable_model_summary")
    settings = {**dict.fromkeys(off, False), "max_epochs": 1, "accelerator": "cpu"}
    return L.Trainer(**{**settings, **arguments})


def module(model=None, lr=0.02):
    L.seed_everything(0, verbose=False)
    model = Attention(2, 2) if model is None else model
    return TactileModule(model, lambda weights: torch.optim.Adam(weights, lr=lr))


def parts(samples=None, **changes):
    samples = gloves(12, 12) if samples is None else samples
    given = {"split": BY_SUBJECT, "transform": ZScore(per="channel"), "batch_size": 16}
    return TactileDataModule(samples, **given | changes)


@pytest.mark.filterwarnings("ignore")
def test_network_learns_touches_of_other_subjects(tmp_path):
    data = parts(train_transform=RandomNoise(0.1))
    model, on_cpu = module(), trainer(max_epochs=6)
    on_cpu.fit(model, data)
    (metrics,) = on_cpu.test(model, data, verbose=False)
    assert metrics["test/accuracy"] > 0.9
    assert {f"test/accuracy_day {i}" for i in range(3)} & {*metrics}
    assert len(torch.cat(on_cpu.predict(model, data))) == 36
    on_cpu.save_checkpoint(tmp_path / "last.ckpt")
    again = TactileModule.load_from_checkpoint(tmp_path / "last.ckpt", model=Attention(2, 2))
    batch = next(iter(data.test_dataloader()))
    assert again.eval()(batch).equal(model.eval()(batch))
    with pytest.raises(ValueError, match=r"contains no predictor: .* its samples share no layout"):
        Predictor.from_checkpoint(tmp_path / "last.ckpt")


def test_batches_are_pygs_of_prepared_samples():
    data = parts()
    assert data.layout is None
    data.setup()
    loader = data.train_dataloader()
    assert type(loader) is DataLoader
    batch = next(iter(loader))
    assert isinstance(batch, Batch)
    assert batch.num_graphs == 16
    assert len({*batch.ptr.diff().tolist()}) > 1
    train = data.part("train")
    scale = ZScore(per="channel").fit([train[i] for i in range(len(train))])
    (first,) = data.peek(data.part("test"), 1).to_data_list()
    assert first.x.equal(scale(data.part("test")[0]).x)
    assert len(data.val_dataloader().dataset) == len(data.part("val")) == 36


@pytest.mark.parametrize(
    "samples",
    [
        Gloves(12, 12),
        Subset(gloves(12, 12), range(144)),
        ConcatDataset([gloves(12, 12)[:100], gloves(12, 12)[100:]]),
    ],
    ids=lambda samples: type(samples).__name__,
)
def test_every_kind_of_data_set_gives_the_same_samples(samples):
    expected, found = parts(), parts(samples)
    for name in ("train", "val", "test"):
        one, other = expected.part(name), found.part(name)
        assert one.indices() == other.indices()
        assert one[3].x.equal(other[3].x)


@pytest.mark.filterwarnings("ignore")
def test_samples_without_edges_get_them_from_a_transform():
    samples = gloves(6, 4, edges=False)
    data = parts(samples, transform=KNNGraph(k=2))
    trainer(fast_dev_run=True).fit(module(), data)
    with pytest.raises(ValueError, match=r"the model needs 'edge_index' \(the batch has .*'pos'"):
        trainer(fast_dev_run=True).fit(module(), parts(samples))


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("key", ["x", "edge_attr"])
def test_missing_numbers_are_named_by_their_samples(key):
    samples = gloves(6, 4)
    data = parts(samples, transform=GeometricEdgeAttr())
    train = data.part("train")
    for i in (3, 5):
        bad = samples[train.indices()[i]]
        if key == "x":
            bad.x = bad.x.clone()
            bad.x[0, 0] = torch.nan
        else:
            bad.pos = bad.pos * torch.nan
    model = Attention(2, 2)
    model.modalities = () if key == "x" else ("edge_attr",)
    match = rf"'{key}' of the train part must be finite .* in 2 samples: 3, 5 of trial"
    with pytest.raises(ValueError, match=match):
        trainer(fast_dev_run=True).fit(module(model), data)
    if key == "x":
        filled = parts(samples, transform=FillMissing())
        trainer(fast_dev_run=True).fit(module(), filled)


@pytest.mark.filterwarnings("ignore")
def test_what_cannot_be_trained_on_different_sensors():
    match = r"'model' must accept .*forward\(x, edge_index, batch\), .* 30 to 60 taxels .*"
    with pytest.raises(ValueError, match=rf"{match}OneLayer, without 'batch'"):
        trainer(fast_dev_run=True).fit(module(OneLayer(2, 30, 2)), parts())
    with pytest.raises(ValueError, match="on samples with the same taxels, except with per"):
        trainer(fast_dev_run=True).fit(module(), parts(transform=ZScore()))
    unlabelled = [Data(x=s.x, edge_index=s.edge_index, group=s.group) for s in gloves()]
    with pytest.raises(ValueError, match="the train part must have labels 'y'"):
        trainer(fast_dev_run=True).fit(module(), parts(unlabelled))


@pytest.mark.filterwarnings("ignore")
def test_samples_of_one_sensor_may_be_a_list_for_any_network():
    dataset = FakeTactileDataset(40, pre_transform=KNNGraph(2))
    data = TactileDataModule(list(dataset), split="frame", val=0.2)
    for model in (Ring(dataset.layout, 2, 3), Attention(3, 2)):
        trainer(fast_dev_run=True).fit(module(model), data)


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize(("task", "y"), [("regression", 0.5), ("multilabel", [[1, 0, 1]])])
def test_other_tasks(task, y):
    samples = gloves(6, 4)
    for i, sample in enumerate(samples):
        sample.y = y * i if task == "regression" else torch.tensor(y) * (i % 2)
    model = Attention(2, 1 if task == "regression" else 3)
    data = parts(samples)
    trainer(fast_dev_run=True).fit(TactileModule(model, task=task), data)
    assert DataSizes.from_data(data, task).num_outputs == (1 if task == "regression" else 3)


def test_sizes_of_different_sensors():
    data = parts(gloves())
    sizes = DataSizes.from_data(data)
    assert (sizes.layout, sizes.in_channels, sizes.num_outputs, sizes.num_edges) == (None, 2, 2, 0)
    model = classifier_from_config({"model": "own_models.Attention"}, data).model
    assert model.conv1.in_channels == 2
    match = (
        r"Ring must be a model for any sensor, with forward\(x, edge_index, batch\) and without 'l"
    )
    with pytest.raises(ValueError, match=match):
        fill_sizes({"model": "own_models.Ring"}, data)


@pytest.mark.filterwarnings("ignore")
def test_network_of_pyg_on_static_samples_is_as_on_pygs_batches():
    dataset = FakeTactileDataset(40, pre_transform=KNNGraph(2))
    model = module(Attention(3, 2)).eval()
    static = dataset.batch(torch.arange(5))
    torch.testing.assert_close(model(static), model(Batch.from_data_list([*dataset][:5])))
    data = TactileDataModule(dataset, split="trial", val=0.2)
    trainer(fast_dev_run=True).fit(model, data)


def test_arguments_without_annotation_are_filled_in():
    dataset = StaticDataset.from_arrays(
        torch.rand(6, 24, 3), torch.arange(6) % 2, layout=FakeTactileDataset(2).layout
    )
    own = StaticDataset.from_arrays(torch.rand(6, 4, 1), torch.arange(6) % 2, layout=_square())
    for samples in (dataset, own):
        data = TactileDataModule(samples)
        classifier = classifier_from_config({"model": "own_models.Ring"}, data)
        assert isinstance(classifier.model, Ring)
        assert classifier.model.num_taxels == samples.layout.num_taxels
        again = classifier_from_config(classifier.config, data)  # as a file would hold it
        assert json.dumps(classifier.config)
        assert again.model.num_taxels == samples.layout.num_taxels


def _square():
    from torch_geometric_tactile.sensors import grid

    return grid(2, 2, 0.01)


def test_argument_that_nobody_knows_is_named():
    data = TactileDataModule(FakeTactileDataset(20))
    with pytest.raises(ValueError, match=r"'depth' of Deep must be given or have a default"):
        classifier_from_config({"model": "own_models.Deep"}, data)
    given = {"class_path": "own_models.Deep", "init_args": {"depth": 3}}
    assert isinstance(classifier_from_config({"model": given}, data).model, Ring)


@pytest.fixture(scope="module")
def told(tmp_path_factory):
    """What two processes saw."""
    folder = tmp_path_factory.mktemp("two")
    environment = {key: value for key, value in os.environ.items() if key not in _OF_PROCESSES}
    tests = str(Path(__file__).parents[1])
    environment["PYTHONPATH"] = os.pathsep.join([tests, environment.get("PYTHONPATH", "")])
    done = subprocess.run(
        [sys.executable, str(SCRIPT), str(folder)],
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
        env=environment,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return [json.loads((folder / f"rank{rank}.json").read_text()) for rank in range(2)]


@pytest.mark.full
def test_two_processes_train_one_network_on_every_sample(told):
    data = parts(split=BY_SUBJECT)
    wanted = sorted(data.part("train").column("trial").tolist())
    first, second = told
    assert len(first["train"]) == 3
    for mine, others in zip(first["train"], second["train"], strict=True):
        assert sorted(mine + others) == wanted
    assert first["weights"] == second["weights"]
    assert first["accuracy"] == second["accuracy"] > 0.8
    assert min(first["sizes"]) == 30
    for rank in told:
        losses = [sum(epoch) / len(epoch) for epoch in rank["loss"]]
        assert losses[-1] < 0.9 * losses[0]
