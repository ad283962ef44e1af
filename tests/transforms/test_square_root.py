import torch
from torch_geometric.data import Data

from torch_geometric_tactile.data import StaticData
from torch_geometric_tactile.transforms import SquareRoot


def test_square_root_keeps_signs_and_nan():
    x = torch.tensor([[4.0, -9.0], [0.0, torch.nan]])
    out = SquareRoot()(Data(x=x)).x
    assert out.nan_to_num(7.0).tolist() == [[2, -3], [0, 7]]


def test_spread_of_counts_is_the_same():
    rate = torch.tensor([9.0, 100.0, 900.0]).repeat(4000, 1).unsqueeze(-1)
    counts = torch.poisson(rate, generator=torch.Generator().manual_seed(0))
    spread = SquareRoot()(StaticData(x=counts)).x.std(dim=0).view(-1)
    assert torch.allclose(spread, torch.full((3,), 0.5), atol=0.05)
