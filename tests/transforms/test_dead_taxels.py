import pytest
import torch
from torch_geometric.data import Batch, Data
from torch_geometric.transforms import Compose

from torch_geometric_tactile.data import StaticData
from torch_geometric_tactile.sensors import TaxelLayout, allegro_uskin
from torch_geometric_tactile.transforms import DropPatches, DropTaxels

# Four taxels in three patches: one, two and one.
LAYOUT = TaxelLayout(
    "trio",
    pos=torch.arange(12.0).view(4, 3),
    patch=torch.tensor([0, 1, 1, 2]),
    patch_names=("palm", "tip", "nail"),
)


def samples(num_samples=3, num_taxels=4):
    generator = torch.Generator().manual_seed(0)
    return StaticData(x=1 + torch.rand(num_samples, num_taxels, 2, generator=generator))


def drawn(p, **kwargs):
    return [DropTaxels(p, **kwargs), DropPatches(LAYOUT, p, **kwargs)]


def test_drop_taxels_by_hand():
    data = Data(x=torch.arange(1.0, 9.0).view(4, 2))
    out = DropTaxels(taxels=[0, 2], value=-1.0)(data)
    assert out.x.tolist() == [[-1, -1], [3, 4], [-1, -1], [7, 8]]
    assert out.dropped.tolist() == [True, False, True, False]
    out = DropTaxels(taxels=[3], value=torch.nan)(data)
    assert out.x.isnan().any(dim=1).tolist() == [False, False, False, True]


def test_drop_patches_by_hand():
    data = Data(x=torch.ones(4, 1))
    assert DropPatches(LAYOUT, patches=["tip"])(data).x.view(-1).tolist() == [1, 0, 0, 1]
    assert DropPatches(LAYOUT, patches=[2, 0])(data).dropped.tolist() == [True, False, False, True]
    hand = allegro_uskin()
    out = DropPatches(hand, patches=[0, 3])(StaticData(x=torch.ones(2, 384, 3)))
    assert torch.equal(out.dropped[0], (hand.patch == 0) | (hand.patch == 3))
    assert out.dropped.sum() == 2 * (16 + 24)


@pytest.mark.parametrize("index", [0, 1])
def test_dead_taxels_random(index):
    data = samples(4000)
    transform = drawn(0.25)[index]
    torch.manual_seed(1)
    first, second = transform(data), transform(data)
    torch.manual_seed(1)
    again = transform(data)
    assert torch.equal(first.dropped, again.dropped)
    assert torch.equal(first.x, again.x)
    assert not torch.equal(first.dropped, second.dropped)
    rate = first.dropped.float().mean(0)
    assert ((rate - 0.25).abs() < 0.04).all()
    assert torch.equal(first.x == 0, first.dropped.unsqueeze(-1).expand(-1, -1, 2))
    # Patches fail as one, taxels one by one.
    together = torch.equal(first.dropped[:, 1], first.dropped[:, 2])
    assert together == (index == 1)
    assert not torch.equal(first.dropped[:, 0], first.dropped[:, 1])


def test_dead_taxels_never_and_always():
    for never, always in zip(drawn(0.0), drawn(1.0), strict=True):
        assert not never(samples()).dropped.any()
        assert always(samples()).dropped.all()


def test_dead_taxels_marks_add_up():
    transform = Compose([DropTaxels(taxels=[3]), DropPatches(LAYOUT, patches=["palm"])])
    assert transform(samples().sample(0)).dropped.tolist() == [True, False, False, True]


def test_drop_taxels_batch_of_sensors():
    batch = Batch.from_data_list([Data(x=torch.ones(2, 1)), Data(x=torch.ones(3, 1))])
    out = DropTaxels(taxels=[1])(batch)
    assert out.dropped.tolist() == [False, True, False, True, False]
    with pytest.raises(ValueError, match=r"'taxels' must be below 2 \(got 2\)"):
        DropTaxels(taxels=[2])(batch)


def test_dead_taxels_single_taxel_and_types():
    data = Data(x=torch.ones(1, 1, dtype=torch.double))
    out = DropTaxels(taxels=[0])(data)
    assert out.x.tolist() == [[0]]
    assert out.x.dtype == torch.double
    counts = Data(x=torch.tensor([[3], [4]]))
    assert DropTaxels(taxels=[0], value=0.5)(counts).x.view(-1).tolist() == [0.5, 4]


def test_dead_taxels_bad_input():
    for wrong in (-0.1, 1.5, float("nan")):
        for make in (DropTaxels, lambda p: DropPatches(LAYOUT, p)):
            with pytest.raises(ValueError, match=rf"'p' must be a probability.*\(got {wrong}\)"):
                make(wrong)
    with pytest.raises(ValueError, match="only one of 'p' and 'taxels' may be given"):
        DropTaxels(0.1, taxels=[0])
    with pytest.raises(ValueError, match="only one of 'p' and 'patches' may be given"):
        DropPatches(LAYOUT, 0.1, patches=[0])
    with pytest.raises(ValueError, match=r"'taxels' must be numbered from 0 \(got -1\)"):
        DropTaxels(taxels=[-1])
    for wrong in ([0.5], [True], [[0, 1]]):
        with pytest.raises(ValueError, match="'taxels' must be a list of indices"):
            DropTaxels(taxels=wrong)
    with pytest.raises(ValueError, match=r"'taxels' must be below 4 \(got 4\)"):
        DropTaxels(taxels=[4])(samples())
    with pytest.raises(ValueError, match=r"layout 'trio': palm, tip, nail \(got 'wrist'\)"):
        DropPatches(LAYOUT, patches=["palm", "wrist"])
    with pytest.raises(ValueError, match=r"'patches' must be a list .* \(got 'palm'\)"):
        DropPatches(LAYOUT, patches="palm")
    for wrong in (-1, 3):
        with pytest.raises(ValueError, match=rf"'patches' must be 0 to 2 \(got {wrong}\)"):
            DropPatches(LAYOUT, patches=[wrong])
    for transform in (DropPatches(LAYOUT), DropPatches(LAYOUT, patches=[0])):
        with pytest.raises(ValueError, match=r"4 taxels, as in layout 'trio' \(got 5\)"):
            transform(samples(num_taxels=5))
    with pytest.raises(ValueError, match=r"'x' must have shape .* \(got \(4,\)\)"):
        DropTaxels()(Data(x=torch.zeros(4)))


def test_patches_of_a_layout_by_name():
    data = DropPatches("allegro_uskin", patches=["index_1"])(Data(x=torch.ones(384, 3)))
    assert data.dropped.nonzero().view(-1).tolist() == list(range(16))
