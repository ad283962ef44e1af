import pytest
import torch
from small_models import EDGE_INDEX, NUM_EDGES, samples
from torch.func import jacrev, vmap
from torch_geometric.explain.algorithm.utils import clear_masks, set_masks
from torch_geometric.nn.dense.linear import Linear

from torch_geometric_tactile.nn import SelfGCNConv, StaticGCNConv

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
    x, edges = samples(2, 4, 11, 3), EDGE_INDEX
    weights = torch.stack([WEIGHT, WEIGHT + 1])
    found = vmap(lambda one, weight: layer(one, edges, weight))(x, weights)
    expected = torch.stack([layer(x[i], edges, weights[i]) for i in range(2)])
    assert torch.allclose(found, expected, atol=1e-5)
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
