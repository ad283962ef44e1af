import pytest
import torch
from torch_geometric.data import Data
from torch_geometric.transforms import Compose

from torch_geometric_tactile.data import StaticData
from torch_geometric_tactile.transforms import DropTaxels, FillMissing, ZScore, fit_transform

NAN = torch.nan


def samples():
    x = torch.arange(24.0).view(3, 4, 2)
    x[0, 1, 0] = NAN
    x[2, 3] = NAN
    return StaticData(x=x)


def test_fill_missing_by_hand():
    out = FillMissing(-1.0)(Data(x=torch.tensor([[1.0, NAN], [2.0, 3.0], [NAN, NAN]])))
    assert out.x.tolist() == [[1, -1], [2, 3], [-1, -1]]
    assert out.missing.tolist() == [True, False, True]
    assert out.missing.sum() == 2


def test_fill_missing_infinity_stays():
    out = FillMissing()(Data(x=torch.tensor([[torch.inf], [-torch.inf]])))
    assert out.x.view(-1).tolist() == [torch.inf, -torch.inf]
    assert not out.missing.any()


def test_fill_missing_behind_others():
    assert fit_transform(Compose([ZScore(), FillMissing()]), samples()).x[0, 1, 0] == 0
    transform = Compose([DropTaxels(taxels=[2], value=NAN), FillMissing(7.0), FillMissing(8.0)])
    out = transform(samples())
    assert out.x[:, 2].tolist() == [[7, 7]] * 3
    assert out.missing.sum(0).tolist() == [0, 1, 3, 1]  # the second one found nothing more


def test_fill_missing_in_whole_counts():
    assert FillMissing()(Data(x=torch.tensor([[3]]))).missing.tolist() == [False]


def test_fill_missing_bad_input():
    with pytest.raises(ValueError, match=r"'value' must be finite \(got nan\)"):
        FillMissing(NAN)
    with pytest.raises(ValueError, match=r"'x' must have shape .* \(got \(3,\)\)"):
        FillMissing()(Data(x=torch.zeros(3)))
