"""Samples of subjects with gloves of their own, of 30 to 60 taxels."""

import torch
from torch_geometric.data import Data, InMemoryDataset

from torch_geometric_tactile.transforms import KNNGraph


def gloves(num_subjects=12, per_subject=6, edges=True, seed=0):
    """Touches with the upper or the lower half of a glove, as a list."""
    draw = torch.Generator().manual_seed(seed)
    samples = []
    for subject in range(num_subjects):
        size = (30, 60, *torch.randint(30, 61, (num_subjects,), generator=draw).tolist())[subject]
        pos = 0.1 * torch.rand(size, 3, generator=draw)
        found = KNNGraph(k=3)(Data(pos=pos)).edge_index if edges else None
        for touch in range(per_subject):
            y = touch % 2
            x = torch.randn(size, 2, generator=draw)
            x[:, 0] += 2.0 * y * (pos[:, 0] > 0.05)
            sample = Data(x=x, pos=pos, y=y, group=subject, trial=subject * per_subject + touch)
            sample.session = f"day {subject % 3}"
            if found is not None:
                sample.edge_index = found
            samples.append(sample)
    return samples


class Gloves(InMemoryDataset):
    """The same as a data set of PyG."""

    def __init__(self, num_subjects=12, per_subject=6, transform=None):
        super().__init__(None, transform)
        samples = gloves(num_subjects, per_subject)
        for sample in samples:  # which PyG would keep as texts
            sample.session = int(sample.session.removeprefix("day "))
        self.data, self.slices = self.collate(samples)


def texts():
    """No samples."""
    return ["a"]
