import pytest
import torch
from torch_geometric.data import Data
from torch_geometric.transforms import Compose

from torch_geometric_tactile.data import StaticData
from torch_geometric_tactile.testing import assert_transform_static_equals_batched
from torch_geometric_tactile.transforms import DropTaxels, FillMissing, ZScore, fit_transform

NAN = torch.nan


def samples(num_samples=3):
    x = torch.arange(num_samples * 8.0).view(num_samples, 4, 2)
    x[:1, 1, 0] = NAN
    x[2:, 3] = NAN
    return StaticData(x=x)


def test_fill_missing_by_hand():
    out = FillMissing(-1.0)(Data(x=torch.tensor([[1.0, NAN], [2.0, 3.0], [NAN, NAN]])))
    assert out.x.tolist() == [[1, -1], [2, 3], [-1, -1]]
    assert out.missing.tolist() == [True, False, True]
    assert out.missing.sum() == 2


@pytest.mark.parametrize("num_samples", [1, 3, 4])
def test_fill_missing_laws(num_samples):
    data = samples(num_samples)
    assert_transform_static_equals_batched(FillMissing(0.5), data)
    out = FillMissing()(data)
    assert torch.equal(out.missing, data.x.isnan().any(-1))
    assert out.sample(0).missing.tolist() == [False, True, False, False]
    assert out.index_select(slice(0, 1)).missing.shape == (1, 4)
    assert not out.x.isnan().any()


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


def test_fill_missing_single_taxel_and_types():
    out = FillMissing()(Data(x=torch.tensor([[NAN]], dtype=torch.double)))
    assert out.x.dtype == torch.double
    assert out.missing.tolist() == [True]
    assert FillMissing()(Data(x=torch.tensor([[3]]))).missing.tolist() == [False]  # raw counts


def test_fill_missing_bad_input():
    with pytest.raises(ValueError, match=r"'value' must be finite \(got nan\)"):
        FillMissing(NAN)
    with pytest.raises(ValueError, match=r"'x' must have shape .* \(got \(3,\)\)"):
        FillMissing()(Data(x=torch.zeros(3)))
