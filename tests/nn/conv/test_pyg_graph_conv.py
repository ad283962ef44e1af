"""PyG's tests of `GraphConv`, for `SelfGCNConv`.

`SelfGCNConv` is `GraphConv` whose edges have the weights that `gcn_norm` gives them. Each test here
is written after the one of the same name in PyG's `test/nn/conv/test_graph_conv.py` (MIT license,
https://github.com/pyg-team/pytorch_geometric), and runs for one sample and for several. Bipartite
graphs, for which `gcn_norm` has no meaning, are not among them.
"""

import pytest
import torch
from small_models import samples
from torch_geometric.nn import GraphConv
from torch_geometric.nn.conv.gcn_conv import gcn_norm
from torch_geometric.utils import to_torch_csc_tensor

from torch_geometric_tactile.nn import SelfGCNConv

pytestmark = pytest.mark.filterwarnings("ignore:Sparse")

EDGES = torch.tensor([[0, 1, 2, 3], [0, 0, 1, 1]])
# Each node has one edge in and one edge out, so that `gcn_norm` changes no weight of one.
RING = torch.tensor([[0, 1, 2, 3], [1, 2, 3, 0]])
VALUE = torch.tensor([0.3, 0.9, 0.1, 0.7])
LEADS = [(), (3,), (2, 3)]


def pair():
    torch.manual_seed(0)
    ours, theirs = SelfGCNConv(8, 32), GraphConv(8, 32)
    torch.nn.init.normal_(theirs.lin_rel.bias)
    weights = theirs.state_dict()
    ours.load_state_dict(
        {
            "lin.weight": weights["lin_root.weight"],
            "lin.bias": weights["lin_rel.bias"],
            "conv.lin.weight": weights["lin_rel.weight"],
        }
    )
    return ours, theirs


def close(a, b):
    return torch.allclose(a, b, atol=1e-6)


@pytest.mark.parametrize("lead", LEADS)
@pytest.mark.parametrize("value", [None, VALUE])
def test_graph_conv(lead, value):
    x, (conv, theirs) = samples(*lead, 4, 8), pair()
    assert str(conv) == str(theirs).replace("GraphConv", "SelfGCNConv")
    out = conv(x, EDGES, value)
    assert out.size() == (*lead, 4, 32)
    normed = gcn_norm(EDGES, value, 4, add_self_loops=False, dtype=x.dtype)
    assert close(out, theirs(x, *normed))
    assert close(conv(x, to_torch_csc_tensor(EDGES, value, size=(4, 4)).t()), out)


@pytest.mark.parametrize("lead", LEADS)
def test_graph_conv_without_weights(lead):
    x, (conv, theirs) = samples(*lead, 4, 8), pair()
    assert close(conv(x, RING), theirs(x, RING))
    assert close(conv(x, EDGES[:, :0]), theirs(x, EDGES[:, :0]))
