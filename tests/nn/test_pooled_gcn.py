import pytest
import torch
from small_models import EDGE_INDEX, NUM_EDGES, assert_close, samples

from torch_geometric_tactile.nn._pooled_gcn import pooled_gcn
from torch_geometric_tactile.nn.conv._static_adjacency import StaticAdjacency, edge_norm


def adjacency(edge_index=EDGE_INDEX, edge_weight=None, num_nodes=11, dtype=torch.double):
    return StaticAdjacency(*edge_norm(edge_index, edge_weight, num_nodes, dtype), num_nodes)


def plain(h, adj, weight, bias=None, pool=1, segment=None):
    """The formula, step by step."""
    segment = torch.zeros(len(h), dtype=torch.long) if segment is None else segment
    lead = (-1, *weight.shape[-2:])
    u = torch.einsum("nm,mfb->nfb", adj.dense, h)
    z = torch.einsum("nfb,nof->nob", u, weight.reshape(lead)[segment])
    if bias is not None:
        z = z + bias.reshape(-1, bias.size(-1))[segment].unsqueeze(-1)
    return z.unflatten(1, (-1, pool)).amax(dim=2).relu()


def segments(num_nodes):
    return (5 * torch.arange(num_nodes)) % 3


def arguments(num_nodes=11, own=False, batch_size=2, width=4, dtype=torch.double):
    lead = (3,) if own else ()
    sizes = ((num_nodes, 3, batch_size), (*lead, width, 3), (*lead, width))
    given = [samples(*size, dtype=dtype, seed=i) for i, size in enumerate(sizes)]
    return [value.requires_grad_() for value in given]


def results(function, given, adj, pool, own=False):
    h, *weights = given
    out = function(h, adj, *weights, pool, segments(len(h)) if own else None)
    grads = torch.autograd.grad((out * samples(*out.shape, dtype=out.dtype)).sum(), given)
    names = ("h", "weight", "bias")
    return {"out": out.detach(), **dict(zip(names, grads, strict=False))}


def test_pooled_gcn_by_hand():
    # Two joined taxels share their mean 3; channels 3 and -6, then 9 and 4 with their biases.
    adj = adjacency(torch.tensor([[0, 1], [1, 0]]), num_nodes=2)
    h = torch.tensor([[[2.0]], [[4.0]]], dtype=torch.double)
    weight = torch.tensor([[1.0], [-2.0], [3.0], [1.0]], dtype=torch.double)
    bias = torch.tensor([0.0, 0.0, 0.0, 1.0], dtype=torch.double)
    out = pooled_gcn(h, adj, weight, bias)
    assert torch.allclose(out[:, :, 0], torch.tensor([[3.0, 0.0, 9.0, 4.0]] * 2).double())
    out = pooled_gcn(h, adj, weight, bias, 2)
    assert torch.allclose(out[:, :, 0], torch.tensor([[3.0, 9.0]] * 2).double())
    out = pooled_gcn(h, adj, -weight, None, 2)
    assert torch.allclose(out[:, :, 0], torch.tensor([[6.0, 0.0]] * 2).double())


@pytest.mark.parametrize("pool", [1, 2, 4])
@pytest.mark.parametrize("own", [False, True])
def test_pooled_gcn_gradcheck(own, pool):
    edge_index = torch.tensor([[0, 1, 2, 3], [1, 2, 1, 0]])
    adj = adjacency(edge_index, samples(4).exp(), num_nodes=4)
    given = arguments(4, own)
    assert torch.autograd.gradcheck(
        lambda h, *weights: pooled_gcn(h, adj, *weights, pool, segments(4) if own else None), given
    )


@pytest.mark.parametrize("dtype", [torch.float, torch.double])
@pytest.mark.parametrize("pool", [1, 2, 4])
@pytest.mark.parametrize("own", [False, True])
def test_pooled_gcn_equals_the_formula(own, pool, dtype):
    adj = adjacency(EDGE_INDEX, samples(NUM_EDGES).exp(), dtype=dtype)
    given = arguments(own=own, batch_size=9, width=8, dtype=dtype)
    rtol, atol = (1e-4, 1e-5) if dtype == torch.float else (1e-9, 1e-11)
    expected = results(plain, given, adj, pool, own)
    assert_close(results(pooled_gcn, given, adj, pool, own), expected, rtol, atol)
    segment = segments(11) if own else None
    out, expected = (
        function(given[0], adj, given[1], None, pool, segment) for function in (pooled_gcn, plain)
    )
    assert torch.allclose(out, expected, rtol=rtol, atol=atol)


@pytest.mark.parametrize("own", [False, True])
def test_pooled_gcn_in_several_blocks(own):
    # The widest activation of 37 taxels does not fit into one block, nor into several equal ones.
    edge_index = torch.stack([torch.arange(37), torch.arange(37).roll(3)])
    adj = adjacency(edge_index, num_nodes=37)
    given = arguments(37, own, batch_size=512, width=16)
    expected = results(plain, given, adj, 4, own)
    assert_close(results(pooled_gcn, given, adj, 4, own), expected)


def test_pooled_gcn_some_gradients():
    adj, given = adjacency(), arguments()
    expected = results(plain, given, adj, 2)
    for name, value in zip(("h", "weight", "bias"), given, strict=True):
        fixed = [other if other is value else other.detach() for other in given]
        out = pooled_gcn(fixed[0], adj, *fixed[1:], 2)
        (grad,) = torch.autograd.grad((out * samples(*out.shape, dtype=out.dtype)).sum(), value)
        assert_close({name: grad}, {name: expected[name]})


def test_pooled_gcn_equal_channels():
    # Where several channels are the maximum, the gradient goes to all of them.
    adj = adjacency(EDGE_INDEX[:, :0], num_nodes=1)
    h, weight = torch.ones(1, 1, 1).double(), torch.ones(2, 1).double().requires_grad_()
    pooled_gcn(h, adj, weight, None, 2).backward(torch.ones(1, 1, 1).double())
    assert torch.equal(weight.grad, torch.ones(2, 1).double())


def test_pooled_gcn_not_contiguous():
    adj, given = adjacency(), arguments(batch_size=11)
    turned = given[0].detach().permute(2, 1, 0).contiguous().permute(2, 1, 0).requires_grad_()
    assert not turned.is_contiguous()
    weight = given[1].detach().t().contiguous().t().requires_grad_()
    expected = results(plain, given, adj, 2)
    assert_close(results(pooled_gcn, [turned, weight, given[2]], adj, 2), expected)


def test_pooled_gcn_no_samples():
    given = arguments(own=True, batch_size=0)
    for pool in (1, 2):
        found = results(pooled_gcn, given, adjacency(), pool, own=True)
        assert found["out"].shape == (11, 4 // pool, 0)
        assert found["weight"].abs().max() == 0


def test_pooled_gcn_no_second_derivative():
    given = arguments()
    out = pooled_gcn(given[0], adjacency(), *given[1:], 2).square().sum()
    (grad,) = torch.autograd.grad(out, given[0], create_graph=True)
    with pytest.raises(RuntimeError, match="once_differentiable"):
        grad.sum().backward()
