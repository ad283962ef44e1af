import pytest
import torch

pytest.importorskip("lightning", reason="needs the extra 'train'")

from torch_geometric_tactile.nn import TaxelNet
from torch_geometric_tactile.papers._taxel_net_without_edges import TaxelNetWithoutEdges


def drawn(cls):
    torch.manual_seed(0)
    return cls("biotac_sp", 2, in_channels=2, depth=2).eval()


def test_weights_are_the_same():
    net, net_without_edges = drawn(TaxelNet), drawn(TaxelNetWithoutEdges)
    pairs = zip(net.state_dict().items(), net_without_edges.state_dict().items(), strict=True)
    assert all(a == b and torch.equal(x, y) for (a, x), (b, y) in pairs)
    assert repr(net_without_edges) == repr(net).replace("TaxelNet", "TaxelNetWithoutEdges")


@pytest.mark.parametrize("size", [1, 16])
def test_electrodes_without_edges_do_not_see_each_other(size):
    x, other = torch.randn(size, 24, 2), torch.randn(size, 2)
    changed = x.clone()
    changed[:, 5] = other
    for cls, seen in ((TaxelNet, True), (TaxelNetWithoutEdges, False)):
        (level,) = drawn(cls).levels
        before, after = level(x), level(changed)
        differs = ~torch.isclose(before, after).flatten(2).all(2)
        assert differs[:, 5].all()
        assert (differs.sum(1) > 1).all() == seen


def test_output_is_that_of_a_network_whose_neighbours_have_zero_weight():
    net, net_without_edges = drawn(TaxelNet), drawn(TaxelNetWithoutEdges)
    with torch.no_grad():
        for block in net.levels[0].blocks:
            block.conv.weight[1:] = 0
    x = torch.randn(16, 24, 2)
    assert torch.allclose(net_without_edges(x), net(x), atol=1e-5)
    assert torch.allclose(net_without_edges(x[0]), net(x[:1]), atol=1e-5)
