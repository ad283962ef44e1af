import pytest
import torch

pytest.importorskip("lightning", reason="needs the extra 'train'")

from torch_geometric_tactile.nn import TaxelNet
from torch_geometric_tactile.papers._grasp_twin import TaxelNetWithoutEdges


def drawn(cls):
    torch.manual_seed(0)
    return cls("biotac_sp", 2, in_channels=2, depth=2).eval()


def test_twin_has_the_same_weights():
    net, twin = drawn(TaxelNet), drawn(TaxelNetWithoutEdges)
    pairs = zip(net.state_dict().items(), twin.state_dict().items(), strict=True)
    assert all(a == b and torch.equal(x, y) for (a, x), (b, y) in pairs)
    assert repr(twin) == repr(net).replace("TaxelNet", "TaxelNetWithoutEdges")


@pytest.mark.parametrize("size", [1, 16])
def test_electrodes_of_the_twin_do_not_see_each_other(size):
    x, other = torch.randn(size, 24, 2), torch.randn(size, 2)
    changed = x.clone()
    changed[:, 5] = other
    for cls, seen in ((TaxelNet, True), (TaxelNetWithoutEdges, False)):
        (level,) = drawn(cls).levels
        before, after = level(x), level(changed)
        differs = ~torch.isclose(before, after).flatten(2).all(2)
        assert differs[:, 5].all()
        assert (differs.sum(1) > 1).all() == seen


def test_twin_is_the_network_whose_neighbours_weigh_nothing():
    net, twin = drawn(TaxelNet), drawn(TaxelNetWithoutEdges)
    with torch.no_grad():
        for block in net.levels[0].blocks:
            block.conv.weight[1:] = 0
    x = torch.randn(16, 24, 2)
    assert torch.allclose(twin(x), net(x), atol=1e-5)
    assert torch.allclose(twin(x[0]), net(x[:1]), atol=1e-5)
