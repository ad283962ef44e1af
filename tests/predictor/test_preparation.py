import numpy as np
import torch
from torch.nn import Module

from torch_geometric_tactile import Predictor
from torch_geometric_tactile.sensors import grid
from torch_geometric_tactile.transforms import FillMissing

LAYOUT = grid(2, 2, pitch=0.01)


class Sum(Module):
    def forward(self, x, edge_index):
        total = x.sum(dim=(1, 2))
        return torch.stack([total, -total], dim=1)


def test_masked_and_infinite_readings_are_missing():
    predictor, x = (
        Predictor(Sum(), LAYOUT, num_channels=2),
        np.random.default_rng(0).normal(size=(3, 4, 2)).astype(np.float32),
    )
    hidden = np.zeros(x.shape, dtype=bool)
    hidden[1, 2, 0] = True
    missing = predictor(np.where(hidden, np.nan, x))
    assert missing.isnan().any(dim=1).tolist() == [False, True, False]
    assert predictor.labels(missing)[1] == []
    for value in (np.ma.masked_array(x, hidden), np.where(hidden, np.inf, x)):
        torch.testing.assert_close(predictor(value), missing, equal_nan=True)
    counts = np.ma.masked_array((10 * x).astype(np.int16), hidden)
    assert predictor(counts).isnan().any(dim=1).tolist() == [False, True, False]
    filled = Predictor(Sum(), LAYOUT, FillMissing(), num_channels=2)
    expected = filled(np.where(hidden, np.nan, x))
    assert filled(np.ma.masked_array(x, hidden)).equal(expected)
    assert filled(np.where(hidden, -np.inf, x)).equal(expected)
