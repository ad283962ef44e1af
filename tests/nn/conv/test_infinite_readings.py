"""Infinite and missing readings, and roots of negative sums, go along edges and nowhere else."""

import math

import pytest
import torch
from torch_geometric.nn import GCNConv
from torch_geometric.utils import subgraph

from torch_geometric_tactile.nn import (
    SegmentedGCNConv,
    SegmentedThread,
    SelfGCNConv,
    StaticGATConv,
    StaticGATv2Conv,
    StaticGCNConv,
    TaxelPool,
)
from torch_geometric_tactile.nn.conv._static_adjacency import contained_product, edge_pattern
from torch_geometric_tactile.sensors import grid

# Two islands and a taxel without an edge.
EDGES = torch.tensor([[0, 1, 1, 2, 3, 4, 0], [1, 0, 2, 1, 4, 3, 0]])
WEIGHTS = {
    "none": None,
    "positive": torch.tensor([0.5, 1.0, 2.0, 0.25, 3.0, 1.0, 2.0]),
    "negative": torch.tensor([1.0, 1.0, -3.0, -3.0, 1.0, 1.0, 2.0]),
    "zero": torch.tensor([1.0, 0.0, 1.0, 1.0, 0.0, 0.0, 1.0]),
}
BAD = [math.inf, -math.inf, math.nan]
DTYPES = [torch.float32, torch.float64]


def samples(num_samples, width, dtype, bad=None, taxels=(0,)):
    x = torch.randn(num_samples, 6, width, generator=torch.Generator().manual_seed(0), dtype=dtype)
    if bad is not None:
        for taxel in taxels:
            x[0, taxel, 0] = bad
    return x


def assert_same(found, expected):
    kind = {"atol": 1e-5, "rtol": 1e-4} if found.dtype == torch.float32 else {"atol": 1e-9}
    assert found.isnan().equal(expected.isnan())
    assert torch.allclose(found, expected, equal_nan=True, **kind)


@pytest.mark.parametrize("dtype", DTYPES)
@pytest.mark.parametrize("bad", [None, *BAD])
@pytest.mark.parametrize("weight", WEIGHTS)
@pytest.mark.parametrize(("width", "out"), [(2, 5), (5, 2)])
@pytest.mark.parametrize("norm", [{}, {"add_self_loops": False}, {"normalize": False}])
def test_static_gcn_conv_gives_the_numbers_of_pyg(dtype, bad, weight, width, out, norm):
    like = GCNConv(width, out, **norm).to(dtype)
    conv = StaticGCNConv(width, out, **norm).to(dtype)
    conv.load_state_dict(like.state_dict())
    weight = None if WEIGHTS[weight] is None else WEIGHTS[weight].to(dtype)
    x = samples(10, width, dtype, bad)
    expected = like(x, EDGES, weight)
    assert_same(conv(x, EDGES, weight), expected)
    assert_same(conv(x, EDGES, weight), expected)  # of what was kept
    assert_same(conv(x[:1], EDGES, weight), expected[:1])
    if weight is not None:  # never kept, where it needs a gradient
        assert_same(conv(x, EDGES, weight.clone().requires_grad_()), expected)


@pytest.mark.parametrize("dtype", DTYPES)
def test_overflow_in_the_linear_map_stays_at_its_neighbours(dtype):
    conv = StaticGCNConv(4, 2).to(dtype)
    torch.nn.init.constant_(conv.lin.weight, 1.0)
    x = torch.ones(1, 6, 4, dtype=dtype)
    x[0, 0] = torch.finfo(dtype).max
    found = conv(x, EDGES)
    assert found.isfinite().all(dim=-1).tolist() == [[False, False, True, True, True, True]]


@pytest.mark.parametrize("dtype", DTYPES)
def test_sum_that_overflows_changes_nothing(dtype):
    like, conv = GCNConv(2, 3).to(dtype), StaticGCNConv(2, 3).to(dtype)
    conv.load_state_dict(like.state_dict())
    x = torch.full((2, 6, 2), torch.finfo(dtype).max / 4, dtype=dtype)
    assert torch.allclose(conv(x, EDGES), like(x, EDGES))


@pytest.mark.parametrize("dtype", DTYPES)
@pytest.mark.parametrize("bad", [None, *BAD])
@pytest.mark.parametrize("difference", [False, True])
@pytest.mark.parametrize("weight", ["none", "positive", "negative"])
def test_self_gcn_conv_is_the_same_in_both_forms(dtype, bad, difference, weight):
    conv = SelfGCNConv(3, 4, difference=difference).to(dtype)
    slow = SelfGCNConv(3, 4, difference=difference, fast=False).to(dtype)
    slow.load_state_dict(conv.state_dict())
    weight = None if WEIGHTS[weight] is None else WEIGHTS[weight].to(dtype)
    x = samples(10, 3, dtype, bad)
    assert_same(conv(x, EDGES, weight), slow(x, EDGES, weight))
    one_by_one = torch.stack([slow(sample, EDGES, weight) for sample in x])
    assert_same(conv(x, EDGES, weight), one_by_one)
    assert conv(x, EDGES, weight)[:, 3:].isfinite().all()
    assert conv(x, EDGES, weight)[1:].isfinite().all() or weight is not None


@pytest.mark.parametrize("bad", BAD)
def test_self_gcn_conv_of_a_taxel_without_neighbours(bad):
    conv = SelfGCNConv(3, 4, difference=True)
    x = samples(3, 3, torch.float32, bad, taxels=(5,))
    found = conv(x, EDGES)
    assert_same(found[0, 5], conv.lin_root(x[0, 5]) + conv.lin_rel.bias)
    assert found[:, :5].isfinite().all()


@pytest.mark.parametrize("dtype", DTYPES)
@pytest.mark.parametrize("bad", [None, *BAD])
@pytest.mark.parametrize("weight", ["none", "negative"])
@pytest.mark.parametrize("num_samples", [2, 10])
def test_segments_give_the_numbers_of_pyg_on_each(dtype, bad, weight, num_samples):
    segment = torch.tensor([0, 0, 1, 1, 1, 0])  # which the edges between 1 and 2 cross
    conv = SegmentedGCNConv(segment, 2, 3).to(dtype)
    thread = SegmentedThread(2, segment, widths=[3], pools=[1]).to(dtype)
    thread.layers()[0][0].load_state_dict(conv.state_dict())
    weight = None if WEIGHTS[weight] is None else WEIGHTS[weight].to(dtype)
    x = samples(num_samples, 2, dtype, bad, taxels=(0, 2))
    expected = x.new_zeros(num_samples, 6, 3)
    for number in range(2):
        like = GCNConv(2, 3).to(dtype)
        like.lin.weight.data, like.bias.data = conv.weight[number].data, conv.bias[number].data
        nodes = (segment == number).nonzero().view(-1)
        edges, part = subgraph(nodes, EDGES, weight, relabel_nodes=True, num_nodes=6)
        expected[:, nodes] = like(x[:, nodes], edges, part)
    assert_same(conv(x, EDGES, weight), expected)
    one_by_one = torch.stack([conv(sample, EDGES, weight) for sample in x])
    assert_same(one_by_one, expected)
    assert_same(thread(x, EDGES, weight), expected.relu())


@pytest.mark.parametrize("bad", BAD)
def test_mean_of_clusters_of_several_sizes(bad):
    layout = grid(3, 3, pitch=0.002)
    pool = TaxelPool(layout, by=0.004, aggr="mean")  # of 4, 2, 2 and 1 taxels
    x = torch.ones(2, 9, 1)
    expected = pool(x).clone()
    for taxel in range(9):
        one = x.clone()
        one[0, taxel] = bad
        found = pool(one)
        changed = ~(found == expected)
        assert int(changed.sum()) == 1
        assert torch.allclose(found[changed], torch.tensor([bad]), equal_nan=True)


@pytest.mark.parametrize("dtype", DTYPES)
@pytest.mark.parametrize("bad", BAD)
def test_product_without_a_branch(dtype, bad):
    adjacency = torch.tensor([[1.0, -2.0, 0.0], [0.0, 1.0, 0.0], [0.5, 0.0, 1.0]], dtype=dtype)
    x = torch.tensor([[[1.0, 2.0], [3.0, 4.0], [5.0, 6.0]]], dtype=dtype)
    pattern = edge_pattern(adjacency)
    assert contained_product(adjacency, pattern, x).equal(adjacency @ x)
    x[0, 1, 0] = bad
    found = contained_product(adjacency, pattern, x)
    assert found.isnan().all(dim=-1).tolist() == [[True, True, False]]
    assert found[0, 2].tolist() == [5.5, 7.0]


@pytest.mark.parametrize("make", [StaticGCNConv, SelfGCNConv, StaticGATConv, StaticGATv2Conv])
def test_exported_and_mapped_forms_keep_other_taxels(make):
    conv = make(2, 3).eval()
    x = samples(2, 2, torch.float32)
    exported = torch.export.export(conv, (x, EDGES)).module()
    assert torch.allclose(exported(x, EDGES), conv(x, EDGES), atol=1e-6)
    x[0, 0] = math.inf
    expected = conv(x, EDGES)
    mapped = torch.func.vmap(lambda one: conv(one, EDGES))(x.unsqueeze(1)).squeeze(1)
    for found in (exported(x, EDGES), mapped):
        assert found.isfinite().equal(expected.isfinite())
        assert torch.allclose(found[0, 2:], expected[0, 2:], atol=1e-6)
        assert torch.allclose(found[1], expected[1], atol=1e-6)
