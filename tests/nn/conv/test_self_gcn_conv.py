import pytest
import torch
from small_models import EDGE_INDEX, NUM_EDGES, samples
from torch.func import functional_call, grad, jacrev, vmap
from torch_geometric.explain.algorithm.utils import clear_masks, set_masks
from torch_geometric.nn.dense.linear import Linear

from torch_geometric_tactile.nn import SelfGCNConv, StaticGCNConv
from torch_geometric_tactile.testing import (
    assert_permutation_equivariant,
    assert_static_equals_batched,
)

WEIGHT = samples(NUM_EDGES, seed=3).exp()


def conv(difference=False, dtype=torch.float, **kwargs):
    torch.manual_seed(0)
    layer = SelfGCNConv(3, 5, difference, **kwargs).to(dtype)
    if layer.lin_rel.bias is not None:
        torch.nn.init.normal_(layer.lin_rel.bias)
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
    return layer.lin_root(x) + a @ x @ layer.lin_rel.weight.t() + layer.lin_rel.bias


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
        layer.lin_root.weight.fill_(1.0)
        layer.lin_rel.bias.fill_(0.5)
        layer.lin_rel.weight.fill_(10.0)
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
    torch.nn.init.zeros_(layer.lin_root.weight)
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
    assert SelfGCNConv(3, 8, bias=False).lin_rel.bias is None


def test_self_gcn_conv_reset():
    layer = conv()
    before = [p.clone() for p in layer.parameters()]
    layer.reset_parameters()
    assert not any(torch.equal(p, old) for p, old in zip(layer.parameters(), before, strict=True))


def test_self_gcn_conv_empty():
    none = torch.empty(2, 0, dtype=torch.long)
    for difference in (False, True):
        layer, x = conv(difference), samples(9, 11, 3)
        expected = layer.lin_root(x) + layer.lin_rel.bias
        assert torch.allclose(layer(x, none), expected, atol=1e-6)
        assert layer(x[:0], EDGE_INDEX).shape == (0, 11, 5)
        assert layer(samples(9, 1, 3), none).shape == (9, 1, 5)


@pytest.mark.parametrize("difference", [False, True])
def test_self_gcn_conv_bad_input(difference):
    layer, x = conv(difference), samples(9, 11, 3)
    bad = [
        ((x[..., :2], EDGE_INDEX), r"'x' must have 3 features \(got shape \(9, 11, 2\)\)"),
        ((x[0, 0], EDGE_INDEX), r"'x' must have shape .*\(got \(3,\)\)"),
        ((x, EDGE_INDEX[0]), r"'edge_index' must have shape \(2, num_edges\)"),
        ((x, EDGE_INDEX + 1), r"'edge_index' must hold node indices from 0 to 10"),
        ((x, EDGE_INDEX, WEIGHT[1:]), r"'edge_weight' must have shape"),
    ]
    for arguments, match in bad:
        with pytest.raises(ValueError, match=match):
            layer(*arguments)


@pytest.mark.parametrize("edges", [[[0], [1]], [[0, 1], [1, 1]], [[0, 1, 2], [1, 1, 1]]])
@pytest.mark.parametrize("lead", [(), (5,)])
def test_difference_that_is_masked_is_left_out(edges, lead):
    layer, edges = conv(difference=True), torch.tensor(edges)
    x = samples(*lead, 3, 3)
    expected = layer(x, edges)
    set_masks(layer, torch.ones(edges.size(1)), edges, apply_sigmoid=False)
    assert torch.allclose(layer(x, edges), expected, atol=1e-6)
    set_masks(layer, torch.zeros(edges.size(1)), edges, apply_sigmoid=False)
    assert torch.allclose(layer(x, edges), layer.lin_root(x) + layer.lin_rel.bias)
    clear_masks(layer)
    assert layer(x, edges).equal(expected)


def test_each_difference_has_its_own_mask():
    layer, edges = conv(difference=True), torch.tensor([[0, 1, 2], [1, 1, 1]])
    x = samples(3, 3)
    set_masks(layer, torch.tensor([0.0, 1.0, 0.5]), edges, apply_sigmoid=False)
    expected = layer.lin_root(x) + layer.lin_rel.bias
    expected[1] += (x[1] - x[2]) @ layer.lin_rel.weight.t() / 6
    assert torch.allclose(layer(x, edges), expected, atol=1e-6)


@pytest.mark.parametrize("difference", [False, True])
def test_torch_func_transforms(difference):
    layer = conv(difference)
    x, edges, state = samples(2, 4, 11, 3), EDGE_INDEX, dict(layer.named_parameters())
    expected = layer(x.flatten(0, 1), edges).view(2, 4, 11, 5)
    assert torch.allclose(vmap(lambda one: layer(one, edges))(x), expected, atol=1e-6)
    weights = torch.stack([WEIGHT, WEIGHT + 1])
    found = vmap(lambda one, weight: layer(one, edges, weight))(x, weights)
    expected = torch.stack([layer(x[i], edges, weights[i]) for i in range(2)])
    assert torch.allclose(found, expected, atol=1e-5)
    found = grad(lambda state: functional_call(layer, state, (x[0], edges)).sum())(state)
    layer(x[0], edges).sum().backward()
    for name, value in layer.named_parameters():
        assert torch.allclose(found[name], value.grad, atol=1e-4)
    one = x[0, :1].clone()
    by_reverse = jacrev(lambda x: layer(x, edges))(one)
    by_autograd = torch.autograd.functional.jacobian(lambda x: layer(x, edges), one)
    assert torch.allclose(by_reverse, by_autograd, atol=1e-5)


@pytest.mark.parametrize("difference", [False, True])
def test_double_weights_give_double(difference):
    layer, x, weight = conv(difference), samples(2, 11, 3), WEIGHT.double() + 1e-9
    exact = conv(difference, torch.double)(x.double(), EDGE_INDEX, weight)
    for form in (x, x[0]):
        found = layer(form, EDGE_INDEX, weight)
        assert found.dtype == torch.double
        assert torch.allclose(found, exact if form is x else exact[0], atol=1e-5)


def test_other_inputs_and_sizes_are_refused():
    with pytest.raises(ValueError, match=r"'x' must be a tensor, .* \(got tuple\)"):
        conv()((samples(11, 3), samples(11, 3)), EDGE_INDEX)
    with pytest.raises(ValueError, match=r"'in_channels' must be .*-2\), or -1 to infer it from"):
        SelfGCNConv(-2, 5)


def test_weights_of_files_before_it_passed_messages():
    layer = conv()
    state = layer.state_dict()
    old = {
        "lin.weight": state["lin_root.weight"],
        "lin.bias": state["lin_rel.bias"],
        "conv.lin.weight": state["lin_rel.weight"],
    }
    other = torch.nn.Sequential(SelfGCNConv(3, 5))
    other.load_state_dict({f"0.{name}": value for name, value in old.items()})
    x = samples(9, 11, 3)
    assert other[0](x, EDGE_INDEX).equal(layer(x, EDGE_INDEX))
    assert set(old) == {"lin.weight", "lin.bias", "conv.lin.weight"}


def test_seed_gives_the_weights_of_earlier_versions():
    torch.manual_seed(0)
    layer = SelfGCNConv(3, 5, bias=False)
    torch.manual_seed(0)
    root = Linear(3, 5, False, weight_initializer="glorot")
    conv = StaticGCNConv(3, 5, add_self_loops=False, bias=False)
    assert layer.lin_root.weight.equal(root.weight)
    assert layer.lin_rel.weight.equal(conv.lin.weight)
