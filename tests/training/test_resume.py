"""Killed and resumed at the end of an epoch, a training ends with the same weights."""

import random

import numpy as np
import pytest

pytest.importorskip("lightning", reason="needs the extra 'train'")

import lightning as L
import torch
import yaml
from lightning.pytorch.callbacks import ModelCheckpoint
from torch import nn
from torch_geometric.transforms import BaseTransform, Compose
from training_fixtures import LabelledDataset, quiet_trainer

from torch_geometric_tactile.training import TactileDataModule, TactileModule
from torch_geometric_tactile.training._lightning_cli import TactileCLI
from torch_geometric_tactile.transforms import DropTaxels, ZScore

EPOCHS, BATCHES = 3, 4
STEP = {"every_n_train_steps": 1}


class Dropping(nn.Module):
    """A linear map with dropout and running statistics."""

    def __init__(self):
        super().__init__()
        self.norm = nn.BatchNorm1d(8)
        self.lin = nn.Linear(8, 3)

    def forward(self, x, edge_index):
        return self.lin(nn.functional.dropout(self.norm(x.flatten(1)), 0.3, self.training))


class Noise(BaseTransform):
    """Draws from all three global sources, for each sample."""

    def forward(self, data):
        by = random.gauss(0, 0.1) + np.random.normal(0, 0.1)  # noqa: NPY002
        data.x = data.x + by + 0.1 * torch.randn(data.x.shape)
        return data


class KilledError(Exception):
    pass


class Kill(L.Callback):
    """Ends a training before a batch of it."""

    def __init__(self, batch):
        self.batch = batch

    def on_train_batch_start(self, trainer, *args):
        if trainer.fit_loop.total_batch_idx == self.batch:
            raise KilledError


def data_of(**kwargs):
    transform = Compose([Noise(), DropTaxels(0.2, generator=torch.Generator().manual_seed(5))])
    kwargs = {"split": "frame", "val": 0.2, "train_transform": transform, **kwargs}
    return TactileDataModule(
        LabelledDataset("multiclass"), transform=ZScore(), batch_size=12, **kwargs
    )


def weights(folder, resume=None, *, seed=4, callback=None, workers=0, saved=None, **settings):
    """The weights after a training whose checkpoints are in a folder."""
    L.seed_everything(seed, verbose=False)
    callbacks = [ModelCheckpoint(folder, "{step}", save_last=True, save_top_k=-1, **(saved or {}))]
    callbacks += [] if callback is None else [callback]
    settings = {"max_epochs": EPOCHS, "enable_checkpointing": True, **settings}
    trainer = quiet_trainer(callbacks=callbacks, **settings)
    module = TactileModule(
        Dropping(), lr_scheduler=lambda optimizer: torch.optim.lr_scheduler.StepLR(optimizer, 1)
    )
    trainer.fit(module, datamodule=data_of(num_workers=workers), ckpt_path=resume)
    return module.state_dict()


def assert_same(found, expected):
    assert found.keys() == expected.keys()
    for name, value in expected.items():
        assert found[name].equal(value), name


@pytest.fixture(scope="module")
def through(tmp_path_factory):
    """The weights of a training that was never stopped, and its checkpoints by their steps."""
    folder = tmp_path_factory.mktemp("through")
    return folder, weights(folder)


@pytest.mark.parametrize("epoch", [1, 2, 3])
def test_resumed_after_an_epoch(through, tmp_path, epoch):
    folder, expected = through
    found = weights(tmp_path, folder / f"step={epoch * BATCHES}.ckpt", seed=99)
    assert_same(found, expected)


def test_writing_checkpoints_draws_no_random_number(through, tmp_path):
    assert_same(weights(tmp_path, saved=STEP), through[1])


@pytest.mark.full
def test_killed_twice(through, tmp_path):
    newest = None
    for seed, killed in ((4, 5), (98, 9)):
        with pytest.raises(KilledError):
            weights(tmp_path, newest, seed=seed, callback=Kill(killed))
        newest = tmp_path / "last.ckpt"
    assert torch.load(newest, weights_only=True)["global_step"] == 8
    assert_same(weights(tmp_path, newest, seed=99), through[1])


@pytest.mark.full
def test_resumed_with_a_worker_is_what_it_is_without(through, tmp_path):
    with pytest.raises(KilledError):
        weights(tmp_path, callback=Kill(5), workers=1)
    assert_same(weights(tmp_path, tmp_path / "last.ckpt", seed=99, workers=1), through[1])


@pytest.mark.parametrize(
    ("settings", "step"),
    [
        ({"max_epochs": -1, "max_steps": 11}, 4),
        ({"limit_train_batches": 3}, 3),
        ({"val_check_interval": 0.5}, 4),
        ({"check_val_every_n_epoch": 2}, 8),
        ({"accumulate_grad_batches": 2}, 2),
    ],
)
def test_resumed_under_other_settings_of_the_trainer(tmp_path, settings, step):
    expected = weights(tmp_path, **settings)
    found = weights(tmp_path / "again", tmp_path / f"step={step}.ckpt", seed=99, **settings)
    assert_same(found, expected)


class Seen(L.Callback):
    """Lists the samples of each batch."""

    def __init__(self):
        self.batches = []

    def on_train_batch_start(self, trainer, module, batch, *args):
        self.batches.append(batch.joint[:, 0].tolist())


def test_resumed_in_the_middle_of_an_epoch_draws_as_many_batches_as_were_left(tmp_path):
    weights(tmp_path, saved=STEP)
    seen = Seen()
    with pytest.warns(UserWarning, match="resuming from a checkpoint that ended before the epoch"):
        weights(tmp_path / "again", tmp_path / "step=1.ckpt", callback=seen)
    assert [len(batch) for batch in seen.batches] == [12] * 11
    for batches in (seen.batches[:3], seen.batches[3:7], seen.batches[7:]):  # none comes twice
        assert len({value for batch in batches for value in batch}) == sum(map(len, batches))
    assert torch.load(tmp_path / "again" / "last.ckpt", weights_only=True)["global_step"] == 12


def test_checkpoint_with_the_state_of_a_loader_is_resumed(tmp_path):
    # Version 0.2.1 wrote such states. Lightning reads them if 'max_steps' is given.
    settings = {"max_epochs": -1, "max_steps": 11}
    expected = weights(tmp_path, **settings)
    checkpoint = torch.load(tmp_path / "step=4.ckpt", weights_only=True)
    loaders = [{"num_batches": 4, "start": checkpoint["random_states"], "generator": None}]
    checkpoint["loops"]["fit_loop"]["state_dict"]["combined_loader"] = loaders
    torch.save(checkpoint, tmp_path / "old.ckpt")
    assert_same(weights(tmp_path / "again", tmp_path / "old.ckpt", **settings), expected)


def test_numbers_of_a_training_that_goes_through_are_those_before(tmp_path):
    # From before checkpoints kept random states, without a transform that draws.
    L.seed_everything(4, verbose=False)
    module = TactileModule(Dropping())
    quiet_trainer(max_epochs=2).fit(module, datamodule=data_of(train_transform=None))
    found = module.model.lin.weight.detach().flatten()[:4]
    torch.testing.assert_close(
        found, torch.tensor([0.046659, 0.041953, -0.282960, -0.206535]), rtol=0, atol=1e-6
    )


def test_checkpoint_without_random_states_is_resumed(through, tmp_path):
    folder, expected = through
    checkpoint = torch.load(folder / f"step={BATCHES}.ckpt", weights_only=True)
    del checkpoint["random_states"]
    torch.save(checkpoint, tmp_path / "old.ckpt")
    found = weights(tmp_path, tmp_path / "old.ckpt", seed=99)
    assert found.keys() == expected.keys()


def test_random_states_that_were_changed_are_an_error(through, tmp_path):
    folder, _ = through
    checkpoint = torch.load(folder / "last.ckpt", weights_only=True)
    checkpoint["random_states"]["torch"] = torch.zeros(3, dtype=torch.uint8)
    torch.save(checkpoint, tmp_path / "odd.ckpt")
    with pytest.raises(ValueError, match=r"odd.ckpt' cannot be resumed: the random states must be"):
        weights(tmp_path, tmp_path / "odd.ckpt")


def test_validating_a_checkpoint_leaves_the_random_states_alone(through):
    def drawn(checkpoint):
        trainer = quiet_trainer()
        module = TactileModule(Dropping())
        torch.manual_seed(3)
        trainer.validate(module, data_of(), ckpt_path=checkpoint, verbose=False)
        return torch.rand(2)

    assert drawn(through[0] / "last.ckpt").equal(drawn(None))


@pytest.mark.full
def test_command_line_goes_on_as_if_never_stopped(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    package = "torch_geometric_tactile"
    neighbours = {"class_path": f"{package}.transforms.KNNGraph", "init_args": {"k": 2}}
    config = {
        "model": {"model": {"class_path": f"{package}.nn.models.GraspGCN"}},
        "data": {
            "dataset": {
                "class_path": f"{package}.datasets.FakeTactileDataset",
                "init_args": {"num_samples": 40, "pre_transform": neighbours},
            },
            "split": "frame",
            "val": 0.2,
            "batch_size": 16,
            "transform": {"class_path": f"{package}.transforms.ZScore"},
            "train_transform": {"class_path": f"{package}.transforms.DropTaxels"},
        },
        "trainer": {
            "accelerator": "cpu",
            "logger": False,
            "enable_progress_bar": False,
            "enable_model_summary": False,
        },
    }
    (tmp_path / "fit.yaml").write_text(yaml.safe_dump(config))

    def fit(folder, epochs, *more):
        args = ["fit", "--config", "fit.yaml", "--trainer.default_root_dir", folder]
        TactileCLI([*args, "--trainer.max_epochs", epochs, *more])
        return tmp_path / folder / "checkpoints" / "last.ckpt"

    whole = fit("whole", "2")
    begun = fit("begun", "1")
    again = fit("again", "2", "--seed_everything", "99", "--ckpt_path", str(begun))
    found, expected = (torch.load(path, weights_only=True)["state_dict"] for path in (again, whole))
    assert_same(found, expected)
