import pytest
import torch

from torch_geometric_tactile.data import StaticData
from torch_geometric_tactile.transforms import Normalize, base

NAN = torch.nan


def random_data(num_samples=20, dtype=torch.float):
    generator = torch.Generator().manual_seed(0)
    x = 3000 + 5 * torch.randn(num_samples, 4, 2, generator=generator, dtype=torch.double)
    return StaticData(x=x.to(dtype))


def column(*values):
    return StaticData(x=torch.tensor(values).view(-1, 1, 1))


def test_normalize_by_hand():
    # Taxel 0 from 10 to 30, taxel 1 from -1 to 3.
    train = StaticData(x=torch.tensor([[10.0, -1.0], [15.0, 3.0], [30.0, 1.0]]).unsqueeze(-1))
    out = Normalize().fit(train)(train).x.view(3, 2)
    assert out.tolist() == [[-1, -1], [-0.5, 1], [1, 0]]
    out = Normalize(0.0, 10.0).fit(train)(train).x.view(3, 2)
    assert out.tolist() == [[0, 0], [2.5, 10], [10, 5]]


def test_normalize_beyond_the_range():
    assert Normalize().fit(column(0.0, 2.0))(column(5.0, -1.0)).x.view(-1).tolist() == [4, -2]


def test_normalize_reaches_both_ends_of_the_range():
    data = random_data()
    data.x[3, 1, 0] = NAN
    x = Normalize(-2.0, 5.0).fit(data)(data).x
    present = x.masked_fill(x.isnan(), 0)
    assert x.isnan().sum() == 1
    assert torch.allclose(present.amin(0), torch.full((4, 2), -2.0), atol=1e-4)
    assert torch.allclose(present.amax(0), torch.full((4, 2), 5.0), atol=1e-4)


def test_normalize_parts(monkeypatch):
    whole = Normalize().fit(random_data())
    monkeypatch.setattr(base, "_MAX_CHUNK", 3)
    parts = Normalize().fit(random_data())
    assert torch.equal(parts.center, whole.center)
    assert torch.equal(parts.scale, whole.scale)


def test_normalize_units_do_not_matter():
    counts = random_data(dtype=torch.double)
    newtons = StaticData(x=counts.x * 0.013 - 7)
    a, b = Normalize().fit(counts)(counts).x, Normalize().fit(newtons)(newtons).x
    assert a.dtype == torch.double
    assert torch.allclose(a, b, atol=1e-9)
    ones = torch.ones(4, 2, dtype=torch.double)
    assert torch.allclose(a.amax(0), ones, rtol=0, atol=1e-12)


@pytest.mark.parametrize(("low", "high", "middle"), [(-1.0, 1.0, 0.0), (0.0, 1.0, 0.5)])
def test_normalize_constant_taxel(low, high, middle):
    transform = Normalize(low, high).fit(column(7.0, 7.0, NAN))
    assert transform(column(7.0, 8.0)).x.view(-1).tolist() == [middle, middle + 1]
    single = Normalize(low, high).fit(column(3.0))
    assert single(column(3.0)).x.item() == middle


def test_normalize_missing_readings():
    transform = Normalize().fit(column(NAN, 2.0, NAN, 4.0))
    assert transform(column(2.0, 3.0, 4.0)).x.view(-1).tolist() == [-1, 0, 1]
    never = Normalize(0.0, 1.0).fit(column(NAN, NAN))
    assert never(column(1.0, NAN)).x[0].item() == 1.5
    assert never.center.isfinite().all()


def test_normalize_bad_input():
    for low, high in ((1.0, 1.0), (2.0, 1.0), (NAN, 1.0), (0.0, torch.inf)):
        with pytest.raises(ValueError, match="'low' must be below 'high', both finite"):
            Normalize(low, high)
