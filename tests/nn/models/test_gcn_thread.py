import pytest
import torch
from small_models import EDGE_INDEX, NUM_EDGES, samples
from torch_geometric.nn import GCNConv

from torch_geometric_tactile.nn.models import GCNThread

WEIGHT = samples(NUM_EDGES, seed=3).exp()


def thread(fast=True, dtype=torch.float):
    torch.manual_seed(0)
    layer = GCNThread(3, (4, 8, 8), (1, 2, 4), fast=fast)
    for conv in layer.convs:
        torch.nn.init.normal_(conv.bias)
    return layer.to(dtype)


def test_gcn_thread_repr():
    paper = "GCNThread(3, widths=(14, 28, 56, 112, 112), pools=(1, 1, 2, 4, 16))"
    assert str(GCNThread(3)) == paper
    assert str(thread()) == "GCNThread(3, widths=(4, 8, 8), pools=(1, 2, 4))"


@pytest.mark.parametrize("in_channels", [3, 7, 8, 11])
def test_gcn_thread_paper_size(in_channels):
    layer = GCNThread(in_channels)
    assert layer.out_channels == 7
    sizes = [(in_channels, 14), (14, 28), (28, 56), (28, 112), (28, 112)]
    total = sum(first * second + second for first, second in sizes)
    assert sum(parameter.numel() for parameter in layer.parameters()) == total


def test_gcn_thread_by_hand():
    # Two joined taxels share their mean 3: channels 3 and -6, then -3 + 1 and 9 + 1.
    layer = GCNThread(1, (2, 2), (1, 2))
    with torch.no_grad():
        layer.convs[0].lin.weight.copy_(torch.tensor([[1.0], [-2.0]]))
        layer.convs[1].lin.weight.copy_(torch.tensor([[-1.0, 5.0], [3.0, 5.0]]))
        layer.convs[1].bias.fill_(1.0)
    x, edge_index = torch.tensor([[2.0], [4.0]]), torch.tensor([[0, 1], [1, 0]])
    for form in (x, x[None], x.expand(9, 2, 1)):
        assert torch.allclose(layer(form, edge_index), torch.tensor(10.0))


@pytest.mark.parametrize("fast", [True, False])
@pytest.mark.parametrize("weight", [None, WEIGHT])
def test_gcn_thread_equals_pyg(weight, fast):
    layer, x = thread(fast), samples(9, 11, 3)
    expected = x
    for conv, pool in zip(layer.convs, layer.pool_sizes, strict=True):
        theirs = GCNConv(conv.in_channels, conv.out_channels)
        theirs.load_state_dict(conv.state_dict())
        out = theirs(expected, EDGE_INDEX, weight)
        expected = out.unflatten(-1, (-1, pool)).amax(dim=-1).relu()
    for given, wanted in ((x, expected), (x[:2], expected[:2]), (x[3], expected[3])):
        assert torch.allclose(layer(given, EDGE_INDEX, weight), wanted, atol=1e-5)


def test_gcn_thread_makes_its_adjacency_once():
    layer = thread()
    layer(samples(9, 11, 3), EDGE_INDEX)
    kept = layer._edge_cache.current
    layer(samples(20, 11, 3), EDGE_INDEX)
    assert layer._edge_cache.current is kept
    layer(samples(9, 11, 3), EDGE_INDEX.clone())
    assert layer._edge_cache.current is kept
    layer(samples(9, 11, 3), EDGE_INDEX[:, 1:])
    assert layer._edge_cache.current is not kept


@pytest.mark.parametrize(
    ("arguments", "match"),
    [
        ((3, (4, 8), (1,)), r"'pools' must have a size for each of 2 widths \(got \(1,\)\)"),
        ((3, (4, 8), (1, 3)), r"'pools' must divide 'widths' \(got 3 for 8\)"),
        ((3, (4, 8), (0, 2)), r"'pools' must divide 'widths' \(got 0 for 4\)"),
    ],
)
def test_gcn_thread_bad_layers(arguments, match):
    with pytest.raises(ValueError, match=match):
        GCNThread(*arguments)


@pytest.mark.parametrize("size", [(3,), (11, 4), (9, 11, 2), (1, 9, 11, 3)])
def test_gcn_thread_bad_shape(size):
    with pytest.raises(ValueError, match=r"'x' must have shape \(num_nodes, 3\) or .*got \("):
        thread()(torch.zeros(size), EDGE_INDEX)
