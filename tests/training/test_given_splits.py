r"""A data set that splits itself, from a YAML to tested properties."""

import numpy as np
import pytest
import torch

pytest.importorskip("lightning", reason="needs the extra 'train'")

import yaml
from fake_configs import fake_config

from torch_geometric_tactile.data import Recording
from torch_geometric_tactile.datasets import AllegroUSkin
from torch_geometric_tactile.io import write_recording
from torch_geometric_tactile.training._lightning_cli import TactileCLI


@pytest.fixture(scope="module")
def root(tmp_path_factory):
    """Two objects with ten trials of four frames."""
    root = tmp_path_factory.mktemp("allegro")
    draw = np.random.default_rng(0)
    for name, level in (("sponge", 0.0), ("mango_replica", 1.0)):
        for number in range(10):
            recording = Recording(
                time=np.arange(4) / 100,
                tactile=draw.normal(level, 1.0, (4, 384, 3)),
                joint=draw.normal(0.0, 0.1, (4, 16)),
            )
            write_recording(recording, root / f"{name}_{number:03d}.npz")
    return root


def config(root):
    def part(split):
        arguments = {"root": str(root), "task": "property", "split": split}
        return {
            "class_path": "torch_geometric_tactile.datasets.AllegroUSkin",
            "init_args": arguments,
        }

    return {
        "model": {
            "model": {
                "class_path": "torch_geometric_tactile.nn.models.GraspGCN",
                "init_args": {"layout": 384, "out_channels": 6, "hidden_channels": 4},
            },
            "task": "multilabel",
        },
        "data": {
            "dataset": part("train"),
            "val_dataset": part("val"),
            "test_dataset": part("test"),
            "val": 0,
            "transform": {"class_path": "torch_geometric_tactile.transforms.ZScore"},
        },
        "trainer": fake_config("GraspGCN", 1)["trainer"],
    }


def test_given_splits_are_trained_validated_and_tested(root, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "property.yaml"
    path.write_text(yaml.safe_dump(config(root)))
    cli = TactileCLI(["--config", str(path)], run=False)
    cli.trainer.fit(cli.model, datamodule=cli.datamodule)
    assert cli.model.num_classes == 6
    assert "val/label_accuracy_non-slippery" in cli.trainer.callback_metrics
    train = AllegroUSkin(root, "property", "train")
    center = cli.datamodule.transform.center[0]
    torch.testing.assert_close(center, train.data.x.double().mean(0), rtol=1e-5, atol=1e-6)
    (tested,) = cli.trainer.test(cli.model, datamodule=cli.datamodule, verbose=False)
    assert 0 <= tested["test/accuracy"] <= 1
    assert sum(len(batch.y) for batch in cli.datamodule.test_dataloader()) == 16
    assert sum(len(batch.y) for batch in cli.datamodule.val_dataloader()) == 8
