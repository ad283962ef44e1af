"""PyG's tests of `GATv2Conv`, for `StaticGATv2Conv`.

Each test here is written after the one of the same name in PyG's `test/nn/conv/test_gatv2_conv.py`
(MIT license, https://github.com/pyg-team/pytorch_geometric), and runs for one sample and for
several. What differs from PyG is a test as well, and stands in docs/layers.md.
"""

import pytest
import torch
from attention_pairs import pair
from small_models import samples
from torch_geometric.nn import GATv2Conv
from torch_geometric.typing import WITH_TORCH_SPARSE, SparseTensor
from torch_geometric.utils import to_torch_csc_tensor

from torch_geometric_tactile.nn.conv import StaticGATv2Conv

pytestmark = pytest.mark.filterwarnings("ignore:Sparse")

EDGES = torch.tensor([[0, 1, 2, 3], [0, 0, 1, 1]])
LEADS = [(), (3,), (2, 3)]


def close(a, b):
    return torch.allclose(a, b, atol=1e-6)


@pytest.mark.parametrize("lead", LEADS)
@pytest.mark.parametrize("residual", [False, True])
def test_gatv2_conv(residual, lead):
    x = samples(*lead, 4, 8)
    conv, theirs = pair("gatv2", 8, 32, heads=2, residual=residual, dtype=torch.float)
    assert isinstance(conv, GATv2Conv)
    assert str(conv) == "StaticGATv2Conv(8, 32, heads=2)"
    out = conv(x, EDGES)
    assert out.size() == (*lead, 4, 64)
    for found, sample in zip(out.view(-1, 4, 64), x.view(-1, 4, 8), strict=True):
        assert close(found, theirs(sample, EDGES))
    assert close(conv(x, EDGES), out)
    assert close(conv(x, to_torch_csc_tensor(EDGES, size=(4, 4)).t()), out)
    if WITH_TORCH_SPARSE and not lead:
        adj = SparseTensor.from_edge_index(EDGES, sparse_sizes=(4, 4))
        assert close(conv(x, adj.t()), out)


@pytest.mark.parametrize("lead", LEADS)
def test_gatv2_conv_return_attention_weights(lead):
    x, conv = samples(*lead, 4, 8), StaticGATv2Conv(8, 32, heads=2)
    out = conv(x, EDGES)
    result = conv(x, EDGES, return_attention_weights=True)
    assert close(result[0], out)
    assert result[1][0].size() == (2, 7)
    assert result[1][1].size() == (*lead, 7, 2)
    assert result[1][1].min() >= 0
    assert result[1][1].max() <= 1
    result = conv(x, to_torch_csc_tensor(EDGES, size=(4, 4)).t(), return_attention_weights=True)
    assert close(result[0], out)
    if lead:  # of several samples, the edges and not a matrix
        assert result[1][0].size() == (2, 7)
        assert result[1][1].size() == (*lead, 7, 2)
    else:
        assert result[1][0].size() == (4, 4, 2)
        assert result[1][0]._nnz() == 7


@pytest.mark.parametrize("residual", [False, True])
def test_gatv2_conv_bipartite(residual):
    x1, x2 = samples(4, 8), samples(2, 8, seed=1)
    conv, theirs = pair("gatv2", 8, 32, heads=2, residual=residual, dtype=torch.float)
    out = conv((x1, x2), EDGES)
    assert out.size() == (2, 64)
    assert close(out, theirs((x1, x2), EDGES))
    assert close(conv((x1, x2), to_torch_csc_tensor(EDGES, size=(4, 2)).t()), out)


@pytest.mark.parametrize("lead", LEADS)
@pytest.mark.parametrize("fill_value", [0.5, "mean"])
@pytest.mark.parametrize("edge_dim", [1, 4])
def test_gatv2_conv_with_edge_attr(edge_dim, fill_value, lead):
    x, edge_index = samples(*lead, 4, 8), torch.tensor([[0, 1, 2, 3], [1, 0, 1, 1]])
    attr = samples(4, seed=1) if edge_dim == 1 else samples(4, 4, seed=1)
    conv, theirs = pair(
        "gatv2", 8, 32, heads=2, edge_dim=edge_dim, fill_value=fill_value, dtype=torch.float
    )
    out = conv(x, edge_index, attr)
    assert out.size() == (*lead, 4, 64)
    for found, sample in zip(out.view(-1, 4, 64), x.view(-1, 4, 8), strict=True):
        assert close(found, theirs(sample, edge_index, attr))


def test_gatv2_conv_jittable():
    # TorchScript takes no layer of this package, and PyG's only with some releases of PyTorch.
    with pytest.raises((RuntimeError, torch.jit.frontend.NotSupportedError)):
        torch.jit.script(pair("gatv2", 8, 32, heads=2)[0])
