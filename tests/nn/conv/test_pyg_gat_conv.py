"""PyG's tests of `GATConv`, for `StaticGATConv`.

Each test here is written after the one of the same name in PyG's `test/nn/conv/test_gat_conv.py`
(MIT license, https://github.com/pyg-team/pytorch_geometric), and runs for one sample and for
several. What differs from PyG is a test as well, and stands in docs/layers.md. Its later tests of
`normalize` are not among them, since no release that we support has that argument.
"""

import pytest
import torch
from attention_pairs import pair
from small_models import samples
from torch_geometric.nn import GATConv
from torch_geometric.typing import WITH_TORCH_SPARSE, SparseTensor
from torch_geometric.utils import to_torch_csc_tensor

from torch_geometric_tactile.nn.conv import StaticGATConv

pytestmark = pytest.mark.filterwarnings("ignore:Sparse")

EDGES = torch.tensor([[0, 1, 2, 3], [0, 0, 1, 1]])
LEADS = [(), (3,), (2, 3)]


def close(a, b):
    return torch.allclose(a, b, atol=1e-6)


@pytest.mark.parametrize("lead", LEADS)
@pytest.mark.parametrize("residual", [False, True])
def test_gat_conv(residual, lead):
    x = samples(*lead, 4, 8)
    conv, theirs = pair("gat", 8, 32, heads=2, residual=residual, dtype=torch.float)
    assert isinstance(conv, GATConv)
    assert str(conv) == "StaticGATConv(8, 32, heads=2)"
    out = conv(x, EDGES)
    assert out.size() == (*lead, 4, 64)
    for found, sample in zip(out.view(-1, 4, 64), x.view(-1, 4, 8), strict=True):
        assert close(found, theirs(sample, EDGES))
    assert close(conv(x, EDGES, size=(4, 4)), out)
    adj = to_torch_csc_tensor(EDGES, size=(4, 4))
    assert close(conv(x, adj.t()), out)
    if WITH_TORCH_SPARSE and not lead:
        adj = SparseTensor.from_edge_index(EDGES, sparse_sizes=(4, 4))
        assert close(conv(x, adj.t()), out)


@pytest.mark.parametrize("lead", LEADS)
@pytest.mark.parametrize("residual", [False, True])
def test_gat_conv_return_attention_weights(residual, lead):
    x, conv = samples(*lead, 4, 8), StaticGATConv(8, 32, heads=2, residual=residual)
    out = conv(x, EDGES)
    result = conv(x, EDGES, return_attention_weights=True)
    assert close(result[0], out)
    assert result[1][0].size() == (2, 7)
    assert result[1][1].size() == (*lead, 7, 2)
    assert result[1][1].min() >= 0
    assert result[1][1].max() <= 1
    if lead:  # for one sample, it depends on the release of PyG
        assert isinstance(conv(x, EDGES, return_attention_weights=False), torch.Tensor)
    result = conv(x, to_torch_csc_tensor(EDGES, size=(4, 4)).t(), return_attention_weights=True)
    assert close(result[0], out)
    if lead:  # of several samples, the edges and not a matrix
        assert result[1][0].size() == (2, 7)
        assert result[1][1].size() == (*lead, 7, 2)
    else:
        assert result[1][0].size() == (4, 4, 2)
        assert result[1][0]._nnz() == 7


@pytest.mark.parametrize("residual", [False, True])
def test_gat_conv_bipartite(residual):
    x1, x2 = samples(4, 8), samples(2, 16, seed=1)
    adj = to_torch_csc_tensor(EDGES, size=(4, 2))
    conv, theirs = pair("gat", (8, 16), 32, heads=2, residual=residual, dtype=torch.float)
    assert str(conv) == "StaticGATConv((8, 16), 32, heads=2)"
    out = conv((x1, x2), EDGES)
    assert out.size() == (2, 64)
    assert close(out, theirs((x1, x2), EDGES))
    assert close(conv((x1, x2), EDGES, size=(4, 2)), out)
    assert close(conv((x1, x2), adj.t()), out)
    out = conv((x1, None), EDGES, size=(4, 2))
    assert out.size() == (2, 64)
    assert close(out, theirs((x1, None), EDGES, size=(4, 2)))
    assert close(conv((x1, None), adj.t()), out)


@pytest.mark.parametrize("lead", LEADS)
@pytest.mark.parametrize("fill_value", [0.5, "mean"])
@pytest.mark.parametrize("edge_dim", [1, 4])
def test_gat_conv_with_edge_attr(edge_dim, fill_value, lead):
    x, edge_index = samples(*lead, 4, 8), torch.tensor([[0, 1, 2, 3], [1, 0, 1, 1]])
    attr = samples(4, seed=1) if edge_dim == 1 else samples(4, 4, seed=1)
    conv, theirs = pair(
        "gat", 8, 32, heads=2, edge_dim=edge_dim, fill_value=fill_value, dtype=torch.float
    )
    out = conv(x, edge_index, attr)
    assert out.size() == (*lead, 4, 64)
    for found, sample in zip(out.view(-1, 4, 64), x.view(-1, 4, 8), strict=True):
        assert close(found, theirs(sample, edge_index, attr))
    if WITH_TORCH_SPARSE and not lead:
        adj = SparseTensor.from_edge_index(edge_index, attr, (4, 4))
        with pytest.raises(NotImplementedError):
            conv(x, adj.t())


@pytest.mark.parametrize("lead", LEADS)
def test_gat_conv_empty_edge_index(lead):
    x, edge_index = samples(*lead, 0, 8), torch.empty(2, 0, dtype=torch.long)
    assert StaticGATConv(8, 32, heads=2)(x, edge_index).size() == (*lead, 0, 64)


def test_gat_conv_jittable():
    # TorchScript takes no layer of this package, and PyG's only with some releases of PyTorch.
    with pytest.raises((RuntimeError, torch.jit.frontend.NotSupportedError)):
        torch.jit.script(pair("gat", 8, 32, heads=2)[0])
