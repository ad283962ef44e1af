"""PyG's tests of `GCNConv`, for `StaticGCNConv`.

Each test here is written after the one of the same name in PyG's `test/nn/conv/test_gcn_conv.py`
(MIT license, https://github.com/pyg-team/pytorch_geometric),
and runs for one sample and for several. What differs from PyG is a test as well, and stands in
docs/layers.md.
"""

import copy

import pytest
import torch
from gcn_pairs import LEADS, STAR, VALUE, close, pair
from small_models import samples
from torch_geometric.nn import GCNConv, SumAggregation
from torch_geometric.nn.conv.gcn_conv import gcn_norm
from torch_geometric.typing import WITH_TORCH_SPARSE, SparseTensor
from torch_geometric.utils import to_torch_coo_tensor, to_torch_csc_tensor, to_torch_csr_tensor

from torch_geometric_tactile.nn.conv import StaticGCNConv

pytestmark = [
    pytest.mark.filterwarnings("ignore:Sparse"),
    pytest.mark.filterwarnings("ignore:Converting sparse tensor to CSR"),
]


@pytest.mark.parametrize("lead", LEADS)
def test_gcn_conv(lead):
    x = samples(*lead, 4, 16)
    conv, theirs = pair(16, 32)
    assert isinstance(conv, GCNConv)
    assert str(conv) == "StaticGCNConv(16, 32)"
    for value in (None, VALUE):
        out = conv(x, STAR, value)
        assert out.shape == (*lead, 4, 32)
        assert close(out, theirs(x, STAR, value))
        adj_t = to_torch_csc_tensor(STAR, value, size=(4, 4)).t()  # a CSR matrix
        assert close(conv(x, adj_t), out)
        assert close(conv(x, adj_t.to_sparse_coo()), out)
        if WITH_TORCH_SPARSE:
            assert close(conv(x, SparseTensor.from_edge_index(STAR, value, (4, 4)).t()), out)


@pytest.mark.parametrize("lead", LEADS)
def test_gcn_conv_cached(lead):
    x, (conv, theirs) = samples(*lead, 4, 16), pair(16, 32, cached=True)
    first = conv(x, STAR)
    assert conv._cached_edge_index is not None
    assert close(first, theirs(x, STAR))
    # PyG's meaning: from now on, whatever edges come in.
    for edges in (STAR[:, :2], to_torch_csc_tensor(STAR, size=(4, 4)).t()):
        assert close(conv(x, edges), first)
    assert close(theirs(x, STAR[:, :2]), first)
    conv.reset_parameters()
    assert conv._cached_edge_index is None


@pytest.mark.parametrize("sparse", [False, True])
def test_gcn_conv_cached_in_both_forms(sparse):
    # What the first call keeps serves a sample as well as a batch.
    edges = to_torch_csc_tensor(STAR, VALUE, size=(4, 4)).t() if sparse else STAR
    value = None if sparse else VALUE
    x = samples(5, 4, 16)
    expected = pair(16, 32)[1](x, STAR, VALUE)
    for first in (x, x[0]):
        conv, _ = pair(16, 32, cached=True)
        conv(first, edges, value)
        assert close(conv(x, STAR[:, :2]), expected)
        assert close(conv(x[1], STAR[:, :2]), expected[1])


@pytest.mark.parametrize("lead", LEADS)
def test_gcn_conv_with_decomposed_layers(lead):
    x, conv = samples(*lead, 4, 16), StaticGCNConv(16, 32)
    decomposed, calls = copy.deepcopy(conv), []
    decomposed.decomposed_layers = 2
    decomposed.register_message_forward_hook(lambda *args: calls.append(1))
    assert close(decomposed(x, STAR), conv(x, STAR))
    assert len(calls) == 2


def test_gcn_conv_with_sparse_input_feature():
    x = torch.sparse_coo_tensor([[0, 0], [0, 1]], [1.0, 1.0], size=(4, 16))
    conv, theirs = pair(16, 32)
    assert close(conv(x, STAR), theirs(x, STAR))


@pytest.mark.parametrize("lead", LEADS)
@pytest.mark.parametrize("value", [None, VALUE[:3]])
def test_gcn_conv_norm(lead, value):
    x, edge_index = samples(*lead, 4, 16), STAR[:, :3]
    conv, theirs = pair(16, 32, flow="source_to_target")
    out = conv(x, edge_index, value)
    conv.flow = theirs.flow = "target_to_source"
    assert close(conv(x, edge_index.flip(0), value), out)
    assert not close(conv(x, edge_index, value), out)
    assert close(conv(x, edge_index, value), theirs(x, edge_index, value))


@pytest.mark.parametrize("lead", LEADS)
@pytest.mark.parametrize(
    "kwargs",
    [
        {"improved": True},
        {"add_self_loops": False},
        {"normalize": False},
        {"bias": False},
        {"aggr": "mean"},
        {"aggr": "max"},
        {"aggr": SumAggregation()},
        {"normalize": False, "flow": "target_to_source"},
    ],
)
@pytest.mark.parametrize("value", [None, torch.tensor([0.3, 0.9, 2.0, 0.5, 0.7])])
def test_gcn_conv_arguments(lead, kwargs, value):
    # With a self-loop, an edge twice, and a node without an edge.
    edge_index = torch.tensor([[0, 0, 2, 1, 1], [1, 2, 2, 0, 0]])
    ours, theirs = pair(3, 5, **kwargs)
    x = samples(*lead, 4, 3)
    assert close(ours(x, edge_index, value), theirs(x, edge_index, value))
    if ours.flow == "source_to_target":
        # PyG multiplies one sample by a sparse matrix.
        adj_t = to_torch_csr_tensor(edge_index.flip(0), value, size=(4, 4))
        expected = [theirs(row, adj_t) for row in x.reshape(-1, 4, 3)]
        assert close(ours(x, adj_t).reshape(-1, 4, 5), torch.stack(expected))


def test_gcn_conv_positional_arguments():
    conv = StaticGCNConv(3, 5, True, True, False, True, False)
    assert (conv.improved, conv.cached, conv.add_self_loops) == (True, True, False)
    assert (conv.normalize, conv.bias) == (True, None)


def test_gcn_conv_refuses_what_pyg_refuses():
    with pytest.raises(ValueError, match="does not support adding self-loops"):
        StaticGCNConv(3, 5, add_self_loops=True, normalize=False)
    with pytest.raises(ValueError, match="Expected 'flow' to be either"):
        StaticGCNConv(3, 5, flow="sideways")
    conv, x = StaticGCNConv(3, 5), samples(4, 3)
    with pytest.raises(ValueError, match="received a tuple"):
        conv((x, x), STAR)
    conv.flow = "target_to_source"
    for one in (x, x[None]):
        with pytest.raises(ValueError, match='"target_to_source" is invalid'):
            conv(one, to_torch_csr_tensor(STAR, size=(4, 4)))
    with pytest.raises(NotImplementedError, match="CSC"):
        StaticGCNConv(3, 5)(x[None], to_torch_csc_tensor(STAR, size=(4, 4)))


def test_gcn_conv_state_dict_both_ways():
    torch.manual_seed(0)
    ours = StaticGCNConv(3, 5)
    torch.manual_seed(0)
    theirs = GCNConv(3, 5)
    assert ours.state_dict().keys() == theirs.state_dict().keys()
    for name, value in ours.state_dict().items():  # the same seed draws the same weights
        assert torch.equal(value, theirs.state_dict()[name])
    torch.nn.init.normal_(ours.bias)
    theirs.load_state_dict(ours.state_dict())
    x = samples(2, 4, 3)
    assert close(theirs(x, STAR), ours(x, STAR))


@pytest.mark.parametrize("lead", [(), (3,)])
@pytest.mark.parametrize("requires_grad", [False, True])
@pytest.mark.parametrize("layout", [torch.sparse_coo, torch.sparse_csr])
def test_gcn_norm_gradient(requires_grad, layout, lead):
    adj = to_torch_coo_tensor(STAR, VALUE.clone().requires_grad_(requires_grad))
    if layout == torch.sparse_csr:
        adj = adj.to_sparse_csr()
    expected = adj.requires_grad  # of a CSR matrix, as the version of PyTorch has it
    assert expected == requires_grad or layout == torch.sparse_csr
    assert gcn_norm(adj)[0].requires_grad == expected
    conv = StaticGCNConv(16, 32).requires_grad_(False)
    for _ in range(2):
        assert conv(samples(*lead, 4, 16), adj).requires_grad == expected
    assert (conv._edge_cache.current is None) == (expected or not lead)
