r"""Random readings in the form of the hand, and a training step, for benchmarks of models."""

from typing import Any

import torch
from torch import nn
from torch_geometric.data import Data
from torch_geometric.transforms import Compose

from torch_geometric_tactile.data import StaticData, StaticDataset
from torch_geometric_tactile.sensors import HandKinematics, allegro_uskin
from torch_geometric_tactile.transforms import GeometricEdgeAttr, TaxelPose

LAYOUT = allegro_uskin()


class Frames(StaticDataset):
    r"""Random readings and joint angles in the form of AllegroUSkin."""

    layout = LAYOUT

    def __init__(self, num_frames: int, root: str | None = None, **kwargs: Any) -> None:
        self.num_frames = num_frames
        super().__init__(root, **kwargs)

    @property
    def raw_file_names(self) -> list[str]:
        return []

    @property
    def processed_file_names(self) -> str:
        return "frames.pt"

    def read(self) -> tuple[StaticData, dict[str, list[str]]]:
        generator = torch.Generator().manual_seed(0)
        data = StaticData(
            x=torch.randn(self.num_frames, 384, 3, generator=generator) * 100 + 30_000,
            edge_index=LAYOUT.edge_index("original"),
            y=torch.randint(0, 8, (self.num_frames,), generator=generator),
            joint=torch.rand(self.num_frames, 16, generator=generator) * 0.3,
        )
        return data, {}


def pose_and_edges() -> Compose:
    return Compose([TaxelPose(LAYOUT, HandKinematics.allegro(), normal=False), GeometricEdgeAttr()])


def train_step(
    model: nn.Module, optimizer: torch.optim.Optimizer, batch: Data, device: str
) -> None:
    batch = batch.to(device)
    optimizer.zero_grad()
    nn.functional.cross_entropy(model(batch.x, batch.edge_index), batch.y).backward()
    optimizer.step()


def fused_adam(model: nn.Module) -> torch.optim.Optimizer:
    return torch.optim.Adam(model.parameters(), fused=True)
