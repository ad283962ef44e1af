from functools import partial

import pytest
import torch

pytest.importorskip("lightning", reason="needs the extra 'train'")

import lightning as L
from training_fixtures import quiet_trainer

from torch_geometric_tactile.datasets import FakeTactileDataset
from torch_geometric_tactile.nn.models import GraspGCN
from torch_geometric_tactile.sensors import biotac
from torch_geometric_tactile.training import (
    CosineAnnealing,
    TactileDataModule,
    TactileModule,
    classifier_from_config,
)
from torch_geometric_tactile.training._checkpoint import AtomicCheckpointIO
from torch_geometric_tactile.transforms import KNNGraph, SessionZScore, ZScore

CONFIG = {
    "model": {"class_path": "torch_geometric_tactile.nn.models.GraspGCN"},
    "optimizer": {"class_path": "torch.optim.Adam", "init_args": {"lr": 0.003}},
}


def fake(split="train", num=120, **kwargs):
    return FakeTactileDataset(num, split, pre_transform=KNNGraph(2), **kwargs)


def trainer(tmp_path, **kwargs):
    return quiet_trainer(tmp_path, plugins=[AtomicCheckpointIO()], **{"max_epochs": 2, **kwargs})


def trained(tmp_path, num=120, **kwargs):
    L.seed_everything(0, verbose=False)
    classifier = classifier_from_config(CONFIG)
    data = TactileDataModule(fake(num=num), fake("test"), transform=SessionZScore(), batch_size=32)
    fitter = trainer(tmp_path, **kwargs)
    fitter.fit(classifier, datamodule=data)
    path = tmp_path / "model.ckpt"
    fitter.save_checkpoint(path)
    return classifier, data, path


def test_classifier_learns_generated_grasps(tmp_path):
    classifier, data, _ = trained(tmp_path, num=600, max_epochs=20)
    (metrics,) = trainer(tmp_path).validate(classifier, data, verbose=False)
    assert metrics["val/accuracy"] > 0.65
    (metrics,) = trainer(tmp_path).test(classifier, data, verbose=False)
    by_session = [value for key, value in metrics.items() if key.startswith("test/accuracy_")]
    assert len(by_session) == 3
    # The sessions of the generated test split have the same number of grasps.
    assert sum(by_session) / 3 == pytest.approx(metrics["test/accuracy"], abs=1e-6)


def test_checkpoint_is_plain_data_and_builds_the_classifier_again(tmp_path):
    classifier, data, path = trained(tmp_path)
    torch.load(path, weights_only=True)
    again = TactileModule.load_from_checkpoint(path, weights_only=True)
    batch = next(iter(data.test_dataloader()))
    torch.testing.assert_close(again.eval()(batch), classifier.eval()(batch), rtol=0, atol=0)
    assert again.layout.matches(data.layout)


def test_checkpoint_restores_the_scaling_of_its_training_part(tmp_path):
    _, data, path = trained(tmp_path)
    other = TactileDataModule(
        fake(num=60, seed=7), fake("test"), transform=SessionZScore(), batch_size=32
    )
    trainer(tmp_path).test(classifier_from_config(CONFIG), other, ckpt_path=path, verbose=False)
    torch.testing.assert_close(other.transform.center[:3], data.transform.center[:3])


def test_checkpoint_of_another_layout_is_refused(tmp_path):
    _, _, path = trained(tmp_path)
    data = TactileDataModule(
        fake(layout=biotac()), fake("test", layout=biotac()), transform=ZScore(), batch_size=32
    )
    classifier = TactileModule(GraspGCN(19))
    with pytest.raises(ValueError, match=r"layout 'biotac' with 19 taxels.*'biotac_sp' with 24"):
        trainer(tmp_path).test(classifier, data, ckpt_path=path)


def test_checkpoint_of_another_transform_is_refused(tmp_path):
    _, _, path = trained(tmp_path)
    data = TactileDataModule(fake(), fake("test"), batch_size=32)
    with pytest.raises(ValueError, match=r"must have 0 fitted transforms.*got 1"):
        trainer(tmp_path).test(classifier_from_config(CONFIG), data, ckpt_path=path)


def test_checkpoint_is_kept_when_writing_the_next_one_fails(tmp_path, monkeypatch):
    _, _, path = trained(tmp_path)
    before = path.read_bytes()

    def break_off(checkpoint, file):
        file.write(b"half")
        raise OSError("disk full")

    monkeypatch.setattr(torch, "save", break_off)
    plugin = AtomicCheckpointIO()
    with pytest.raises(OSError, match="disk full"):
        plugin.save_checkpoint({}, path)
    assert path.read_bytes() == before
    assert [entry.name for entry in tmp_path.iterdir()] == ["model.ckpt"]


def test_classifier_steps_its_scheduler(tmp_path):
    classifier = TactileModule(
        GraspGCN(),
        optimizer=partial(torch.optim.Adam, lr=0.1),
        lr_scheduler=partial(torch.optim.lr_scheduler.CosineAnnealingLR, T_max=2),
    )
    data = TactileDataModule(fake(), transform=ZScore(), batch_size=32)
    fitter = trainer(tmp_path, max_epochs=1)
    fitter.fit(classifier, datamodule=data)
    assert fitter.optimizers[0].param_groups[0]["lr"] == pytest.approx(0.05)


@pytest.mark.parametrize(
    ("arguments", "rates"),
    [({}, [0.075, 0.025, 0.0]), ({"T_max": 2, "eta_min": 0.02}, [0.06, 0.02, 0.06])],
)
def test_learning_rate_falls_over_the_epochs_of_the_run(tmp_path, arguments, rates):
    class Rates(L.Callback):
        def on_train_epoch_start(self, trainer, pl_module):
            seen.append(trainer.optimizers[0].param_groups[0]["lr"])

    seen = []
    classifier = TactileModule(
        GraspGCN(),
        optimizer=partial(torch.optim.Adam, lr=0.1),
        lr_scheduler=partial(CosineAnnealing, **arguments),
    )
    data = TactileDataModule(fake(), transform=ZScore(), batch_size=32)
    fitter = trainer(tmp_path, max_epochs=3, callbacks=[Rates()])
    fitter.fit(classifier, datamodule=data)
    seen.append(fitter.optimizers[0].param_groups[0]["lr"])
    assert seen == pytest.approx([0.1, *rates])


def test_epochs_of_a_checkpoint_are_not_those_of_the_run():
    def scheduler(**arguments):
        parameter = torch.nn.Parameter(torch.zeros(1))
        return CosineAnnealing(torch.optim.SGD([parameter], lr=1.0), **arguments)

    first, longer, given = scheduler(), scheduler(), scheduler(T_max=7)
    first.follow(10)
    longer.follow(20)
    longer.load_state_dict(first.state_dict())
    assert longer.T_max == 20
    given.follow(20)
    assert given.T_max == 7
    with pytest.raises(ValueError, match=r"'max_epochs' must be given .* \(got -1, no end\)"):
        scheduler().follow(-1)
    with pytest.raises(ValueError, match=r"'T_max' must be at least 1 \(got 0\)"):
        scheduler(T_max=0)


def test_the_loss_of_a_validation_batch_is_that_of_all_processes(monkeypatch):
    classifier = TactileModule(GraspGCN())
    logged = {}
    monkeypatch.setattr(
        classifier, "log", lambda name, value, **options: logged.update({name: options})
    )
    batch = fake().batch(range(8))
    classifier.validation_step(batch, 0)
    assert logged == {"val/loss": {"batch_size": 8, "sync_dist": True}}
