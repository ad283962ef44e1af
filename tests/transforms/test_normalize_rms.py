import torch
from torch_geometric.data import Data

from torch_geometric_tactile.data import StaticData
from torch_geometric_tactile.transforms import NormalizeRMS


def test_each_sample_has_size_one_whatever_its_strength():
    x = torch.randn(4, 6, 2)
    strength = torch.tensor([1e-6, 0.5, 1.0, 1e6]).view(-1, 1, 1)
    out = NormalizeRMS()(StaticData(x=strength * x)).x
    assert torch.allclose(out.square().mean((1, 2)), torch.ones(4))
    assert torch.allclose(out, NormalizeRMS()(StaticData(x=x)).x, atol=1e-6)


def test_missing_readings_do_not_count_and_zeros_stay():
    x = torch.tensor([[3.0], [torch.nan], [4.0]])
    out = NormalizeRMS()(Data(x=x)).x.view(-1)
    assert out[1].isnan()
    assert torch.allclose(out[[0, 2]], x[[0, 2]].view(-1) / 12.5**0.5)
    assert NormalizeRMS()(Data(x=torch.zeros(3, 1))).x.tolist() == [[0.0]] * 3
