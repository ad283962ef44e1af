import pytest
import torch

from torch_geometric_tactile.data import StaticData, StaticDataset
from torch_geometric_tactile.sensors import grid


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
