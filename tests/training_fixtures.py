import json

import numpy as np
import pytest
import torch

from torch_geometric_tactile.data import Recording, StaticData, StaticDataset
from torch_geometric_tactile.io import write_recording
from torch_geometric_tactile.sensors import grid


def quiet_trainer(tmp_path=None, **settings):
    """A trainer on the CPU that writes and shows nothing unless told otherwise."""
    import lightning as L

    off = ("logger", "enable_checkpointing", "enable_progress_bar", "enable_model_summary")
    usual = {**dict.fromkeys(off, False), "accelerator": "cpu", "devices": 1, "max_epochs": 1}
    return L.Trainer(**{**usual, "default_root_dir": tmp_path, **settings})


class LabelledDataset(StaticDataset):
    """Ten trials of six frames on four taxels, with joints and edge features; label i (of three) is
    whether joint i is positive, and class i is the highest of the three."""

    def __init__(self, task="multilabel", seed=0, names=("hard", "heavy", "slippery"), **kwargs):
        self.layout = grid(2, 2, pitch=0.01)
        self.task = task
        self.seed = seed
        self.label_names = names
        super().__init__(None, **kwargs)

    def read(self):
        generator = torch.Generator().manual_seed(self.seed)
        joint = torch.randn(60, 3, generator=generator)
        data = StaticData(
            x=torch.randn(60, 4, 2, generator=generator),
            edge_index=self.layout.edge_index("original"),
            edge_attr=torch.randn(60, 8, 4, generator=generator),
            y=(joint > 0).float() if self.task == "multilabel" else joint.argmax(1),
            joint=joint,
            trial=torch.arange(60) // 6,
        )
        return data, {"class": list(self.label_names)}


class JointModel(torch.nn.Module):
    """A linear map of the joints that also takes the edge features."""

    modalities = ("edge_attr", "joint")

    def __init__(self, num_classes=3):
        super().__init__()
        self.lin = torch.nn.Linear(3, num_classes)

    def forward(self, x, edge_index, edge_attr=None, joint=None):
        return self.lin(joint) + 0 * edge_attr.mean()


@pytest.fixture
def labelled():
    """The class of a small data set with three labels or classes."""
    return LabelledDataset


@pytest.fixture
def joint_model():
    """The class of a model that needs 'edge_attr' and 'joint'."""
    return JointModel


OBJECTS = ("mayonnaise", "purse", "sponge")


@pytest.fixture(scope="session")
def grasps(tmp_path_factory):
    """A folder of four trials each of three objects: eight frames, in the second half of which
    some taxels tell the object."""
    root = tmp_path_factory.mktemp("grasps")
    draw = np.random.default_rng(0)
    for i, name in enumerate(OBJECTS):
        for number in range(4):
            tactile = draw.normal(1000.0, 5.0, (8, 384, 3))
            tactile[4:, 40 * i : 40 * i + 40] += 50.0
            recording = Recording(
                time=np.arange(8) / 100,
                tactile=tactile,
                joint=draw.normal(0.5, 0.1, (8, 16)),
                meta={"unit": "count", "synthetic": True, "phase_names": ["hover", "hold"]},
                privileged={"phase": np.arange(8) // 4},
            )
            write_recording(recording, root / "raw" / f"{name}_{number:03d}.npz")
    simulation = {"object_set": "paper8", "seed": 7, "mujoco": "3.3.0"}
    simulation["preset"] = {"duration": 0.08, "rate": 100.0}
    (root / "simulation.json").write_text(json.dumps(simulation))
    return root


class NumberedDataset(StaticDataset):
    """Sixty samples in ten trials on four taxels, whose targets are linear in the joints."""

    def __init__(self, targets=1, seed=0, offset=0.0, names=(), **kwargs):
        self.layout = grid(2, 2, pitch=0.01)
        self.targets = targets
        self.seed = seed
        self.offset = offset
        self.target_names = names
        super().__init__(None, **kwargs)

    def read(self):
        generator = torch.Generator().manual_seed(self.seed)
        joint = torch.randn(60, 3, generator=generator)
        y = joint[:, : self.targets] * 2 + self.offset
        data = StaticData(
            x=torch.randn(60, 4, 2, generator=generator),
            edge_index=self.layout.edge_index("original"),
            edge_attr=torch.randn(60, 8, 4, generator=generator),
            y=y[:, 0] if self.targets == 1 else y,
            joint=joint,
            trial=torch.arange(60) // 6,
        )
        return data, {"class": list(self.target_names)}


@pytest.fixture
def numbered():
    """The class of a small data set with one or more numbers as targets."""
    return NumberedDataset
