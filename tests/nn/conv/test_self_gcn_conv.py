import pytest
import torch
from small_models import EDGE_INDEX, NUM_EDGES, samples

from torch_geometric_tactile.nn import SelfGCNConv
from torch_geometric_tactile.testing import (
    assert_permutation_equivariant,
    assert_static_equals_batched,
)

WEIGHT = samples(NUM_EDGES, seed=3).exp()


def conv(difference=False, dtype=torch.float, **kwargs):
    torch.manual_seed(0)
    layer = SelfGCNConv(3, 5, difference, **kwargs).to(dtype)
    if layer.lin.bias is not None:
        torch.nn.init.normal_(layer.lin.bias)
    return layer


def formula(layer, x, weight=None):
    """The formulas of the docstring, with a dense adjacency of targets and sources."""
    a = torch.zeros(11, 11, dtype=x.dtype)
    weight = torch.ones(NUM_EDGES) if weight is None else weight
    for (source, target), value in zip(EDGE_INDEX.t().tolist(), weight.tolist(), strict=True):
        a[target, source] += value
    degree = a.sum(1)
    if layer.difference:
        a = torch.diag((degree > 0).to(x.dtype)) - a / degree.clamp(min=1e-9).view(-1, 1)
    else:
        scale = degree.pow(-0.5).masked_fill(degree == 0, 0.0)
        a = scale.view(-1, 1) * a * scale
    return layer.lin(x) + a @ layer.conv.lin(x)


def test_self_gcn_conv_repr():
    assert str(SelfGCNConv(3, 8)) == "SelfGCNConv(3, 8)"
    assert str(SelfGCNConv(3, 8, difference=True)) == "SelfGCNConv(3, 8, difference=True)"


@pytest.mark.parametrize(
    ("difference", "expected"),
    [(False, [2.5 + 40, 4.5 + 20, 7.5]), (True, [2.5 - 20, 4.5 + 20, 7.5])],
)
def test_self_gcn_conv_by_hand(difference, expected):
    layer = SelfGCNConv(1, 1, difference)
    with torch.no_grad():
        layer.lin.weight.fill_(1.0)
        layer.lin.bias.fill_(0.5)
        layer.conv.lin.weight.fill_(10.0)
    # 0 and 1 are neighbours, 2 is alone.
    x, edge_index = torch.tensor([[2.0], [4.0], [7.0]]), torch.tensor([[0, 1], [1, 0]])
    for form in (x, x[None], x.expand(9, 3, 1)):
        assert torch.allclose(layer(form, edge_index), torch.tensor(expected).view(3, 1))


@pytest.mark.parametrize("fast", [True, False])
@pytest.mark.parametrize("weight", [None, WEIGHT])
@pytest.mark.parametrize("difference", [False, True])
def test_self_gcn_conv_equals_the_formula(difference, weight, fast):
    layer, x = conv(difference, fast=fast), samples(9, 11, 3)
    expected = formula(layer, x, weight)
    assert torch.allclose(layer(x, EDGE_INDEX, weight), expected, atol=1e-5)
    assert torch.allclose(layer(x[3], EDGE_INDEX, weight), expected[3], atol=1e-5)


def test_self_gcn_conv_differences_do_not_see_an_offset():
    layer = conv(True)
    torch.nn.init.zeros_(layer.lin.weight)
    x = samples(9, 11, 3)
    assert torch.allclose(layer(x + 100, EDGE_INDEX), layer(x, EDGE_INDEX), atol=1e-3)


@pytest.mark.parametrize("difference", [False, True])
def test_self_gcn_conv_gradients(difference):
    x, found = samples(9, 11, 3, dtype=torch.double), []
    for form in (lambda layer: layer(x, EDGE_INDEX), lambda layer: formula(layer, x)):
        layer = conv(difference, torch.double)
        found.append(torch.autograd.grad(form(layer).square().sum(), list(layer.parameters())))
    for ours, theirs in zip(*found, strict=True):
        assert theirs.abs().max() > 0
        assert torch.allclose(ours, theirs, rtol=1e-6)


@pytest.mark.parametrize("difference", [False, True])
def test_self_gcn_conv_laws(difference):
    for batch_size in (2, 9):
        x = samples(batch_size, 11, 3)
        for weight in (None, WEIGHT):
            assert_static_equals_batched(conv(difference), x, EDGE_INDEX, weight)
            assert_permutation_equivariant(conv(difference), x, EDGE_INDEX, edge_attr=weight)


@pytest.mark.parametrize("difference", [False, True])
def test_self_gcn_conv_sparse_matrix(difference):
    layer, x = conv(difference), samples(9, 11, 3)
    adj_t = torch.sparse_coo_tensor(EDGE_INDEX.flip(0), torch.ones(NUM_EDGES), (11, 11))
    expected = layer(x, EDGE_INDEX)
    assert torch.allclose(layer(x, adj_t.to_sparse_csr()), expected, atol=1e-5)
    assert torch.allclose(layer(x, adj_t), expected, atol=1e-5)


@pytest.mark.parametrize("difference", [False, True])
def test_self_gcn_conv_compile(difference):
    torch.compiler.reset()
    layer, x = conv(difference), samples(9, 11, 3)
    compiled = torch.compile(layer, fullgraph=True, backend="aot_eager")
    assert torch.allclose(compiled(x, EDGE_INDEX), layer(x, EDGE_INDEX), atol=1e-5)


def test_self_gcn_conv_parameter_count():
    for difference in (False, True):
        layer = SelfGCNConv(3, 8, difference)
        assert sum(p.numel() for p in layer.parameters()) == 2 * 3 * 8 + 8
    assert SelfGCNConv(3, 8, bias=False).lin.bias is None


def test_self_gcn_conv_reset():
    layer = conv()
    before = [p.clone() for p in layer.parameters()]
    layer.reset_parameters()
    assert not any(torch.equal(p, old) for p, old in zip(layer.parameters(), before, strict=True))


def test_self_gcn_conv_empty():
    none = torch.empty(2, 0, dtype=torch.long)
    for difference in (False, True):
        layer, x = conv(difference), samples(9, 11, 3)
        assert torch.allclose(layer(x, none), layer.lin(x), atol=1e-6)
        assert layer(x[:0], EDGE_INDEX).shape == (0, 11, 5)
        assert layer(samples(9, 1, 3), none).shape == (9, 1, 5)


@pytest.mark.parametrize("difference", [False, True])
def test_self_gcn_conv_bad_input(difference):
    layer, x = conv(difference), samples(9, 11, 3)
    for name in ("in_channels", "out_channels"):
        with pytest.raises(ValueError, match=rf"'{name}' must be at least 1 \(got 0\)"):
            SelfGCNConv(**{"in_channels": 3, "out_channels": 5, name: 0}, difference=difference)
    bad = [
        ((x[..., :2], EDGE_INDEX), r"'x' must have 3 features \(got shape \(9, 11, 2\)\)"),
        ((x[0, 0], EDGE_INDEX), r"'x' must have shape .*\(got \(3,\)\)"),
        ((x, EDGE_INDEX[0]), r"'edge_index' must have shape \(2, num_edges\)"),
        ((x, EDGE_INDEX + 1), r"'edge_index' must hold node numbers from 0 to 10"),
        ((x, EDGE_INDEX, WEIGHT[1:]), r"'edge_weight' must have shape"),
    ]
    for arguments, match in bad:
        with pytest.raises(ValueError, match=match):
            layer(*arguments)
