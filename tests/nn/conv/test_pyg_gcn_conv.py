"""PyG's tests of `GCNConv` and of the parts of `MessagePassing` that it uses, for `StaticGCNConv`.

Each test here is written after the one of the same name in PyG's `test/nn/conv/test_gcn_conv.py` or
`test/nn/conv/test_message_passing.py` (MIT license, https://github.com/pyg-team/pytorch_geometric),
and runs for one sample and for several. What differs from PyG is a test as well, and stands in
docs/layers.md.
"""

import copy

import pytest
import torch
from torch_geometric import EdgeIndex
from torch_geometric.nn import GCNConv, SumAggregation, aggr
from torch_geometric.nn.conv.gcn_conv import gcn_norm
from torch_geometric.typing import WITH_TORCH_SPARSE, SparseTensor
from torch_geometric.utils import to_torch_coo_tensor, to_torch_csc_tensor, to_torch_csr_tensor

from torch_geometric_tactile.nn.conv import StaticGCNConv

STAR = torch.tensor([[0, 0, 0, 1, 2, 3], [1, 2, 3, 0, 0, 0]])
VALUE = torch.tensor([0.3, 0.9, 0.1, 0.7, 0.2, 0.6])
LEADS = [(), (3,), (2, 3)]
pytestmark = [
    pytest.mark.filterwarnings("ignore:Sparse"),
    pytest.mark.filterwarnings("ignore:Converting sparse tensor to CSR"),
]


def samples(*size):
    return torch.randn(size, generator=torch.Generator().manual_seed(0))


def pair(*args, **kwargs):
    torch.manual_seed(0)
    theirs = GCNConv(*args, **kwargs)
    ours = StaticGCNConv(*args, **kwargs)
    if theirs.bias is not None:
        torch.nn.init.normal_(theirs.bias)
    ours.load_state_dict(theirs.state_dict())
    return ours, theirs


def close(a, b):
    return torch.allclose(a, b, atol=1e-6)


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


def test_static_gcn_conv():
    # The test that gave the form (B, N, F) its name.
    conv, theirs = pair(16, 32)
    x = samples(3, 4, 16)
    assert conv(x, STAR).shape == (3, 4, 32)
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
    assert (conv._kept.current is None) == (expected or not lead)


# Of test_message_passing.py


def test_my_conv_basic():
    # An unfused product of a sparse matrix is the same.
    conv, x = StaticGCNConv(8, 32), samples(4, 8)
    adj_t = to_torch_csc_tensor(STAR, VALUE, size=(4, 4)).t()
    out = conv(x, adj_t)
    conv.fuse = False
    assert close(conv(x, adj_t), out)
    assert close(conv(x.expand(3, 4, 8), adj_t)[2], out)


@pytest.mark.parametrize("lead", LEADS)
@pytest.mark.parametrize("edges", [[[-1, 1, 2, 2], [0, 0, 1, 1]], [[0, 1, 2, 3], [0, 0, 1, 1]]])
def test_my_conv_out_of_bounds(lead, edges):
    # PyG raises IndexError from `propagate`, here it is a ValueError of the same meaning.
    with pytest.raises(ValueError, match=r"'edge_index' must hold node numbers from 0 to 2, .*got"):
        StaticGCNConv(8, 32)(samples(*lead, 3, 8), torch.tensor(edges), samples(4))


def test_my_conv_jittable():
    # TorchScript takes PyG's layer with the same weights, not ours.
    ours, theirs = pair(8, 32)
    with pytest.raises(torch.jit.frontend.NotSupportedError):
        torch.jit.script(ours)
    theirs.load_state_dict(ours.state_dict())
    x = samples(4, 8)
    assert close(torch.jit.script(theirs)(x, STAR, VALUE), ours(x, STAR, VALUE))


@pytest.mark.parametrize("aggregation", ["add", "sum", "mean", "min", "max", "mul"])
def test_my_conv_aggr(aggregation):
    ours, theirs = pair(8, 32, aggr=aggregation)
    x = samples(3, 4, 8)
    assert close(ours(x, STAR, VALUE), theirs(x, STAR, VALUE))


@pytest.mark.parametrize("mode", [{"mode": "cat"}, {"mode": "sum"}])
def test_my_multiple_aggr_conv(mode):
    ours, theirs = pair(8, 32, bias=False, aggr=["add", "mean", "max"], aggr_kwargs=mode)
    x = samples(3, 4, 8)
    assert close(ours(x, STAR), theirs(x, STAR))


def test_copy():
    conv, x = StaticGCNConv(8, 32), samples(3, 4, 8)
    expected = conv(x, STAR, VALUE)
    shallow, deep = copy.copy(conv), copy.deepcopy(conv)
    assert shallow.lin.weight is conv.lin.weight
    assert deep.lin.weight is not conv.lin.weight
    shallow.improved = True  # shares what is kept, but not the settings
    assert not close(shallow(x, STAR, VALUE), expected)
    for one in (conv, deep):
        assert close(one(x, STAR, VALUE), expected)


@pytest.mark.parametrize("lead", LEADS)
def test_message_passing_hooks(lead):
    conv, theirs = pair(8, 32)
    x, adj_t = samples(*lead, 4, 8), to_torch_csc_tensor(STAR, VALUE, size=(4, 4)).t()
    calls, handles = [], []
    for name in ("propagate", "message", "aggregate", "message_and_aggregate"):
        for kind in ("forward_pre_hook", "forward_hook"):
            register = getattr(conv, f"register_{name}_{kind}")
            handles.append(register(lambda *args, n=(name, kind): calls.append(n)))
    out = conv(x, STAR, VALUE)
    passed = [("propagate", "message", "aggregate"), ("propagate", "message_and_aggregate")]
    assert [name for name, kind in calls if kind == "forward_pre_hook"] == list(passed[0])
    assert len(calls) == 6
    calls.clear()
    assert close(conv(x, adj_t), out)
    # A sparse matrix is applied to one sample whole, and to several message by message.
    expected = passed[0] if lead else passed[1]
    assert [name for name, kind in calls if kind == "forward_pre_hook"] == list(expected)
    for handle in handles:
        handle.remove()
    calls.clear()
    assert close(conv(x, STAR, VALUE), theirs(x, STAR, VALUE))
    assert calls == []


@pytest.mark.parametrize("lead", LEADS)
def test_modified_message_passing_hook(lead):
    found = []
    for conv in pair(8, 32):
        seen = []

        def hook(module, inputs, output, seen=seen):
            seen.append(set(inputs[-1]))
            return output + 1.0

        plain = conv(samples(*lead, 4, 8), STAR, VALUE)
        conv.register_message_forward_hook(hook)
        found.append(conv(samples(*lead, 4, 8), STAR, VALUE))
        assert seen == [{"x_j", "edge_weight"}]
        assert not close(found[-1], plain)
    assert close(*found)


class Scaled(StaticGCNConv):
    def message(self, x_j, edge_weight, scale: float = 3.0):
        return scale * super().message(x_j, edge_weight)


class ScaledOfPyG(GCNConv):
    def message(self, x_j, edge_weight, scale: float = 3.0):
        return scale * super().message(x_j, edge_weight)


class Stored:
    def aggregate(self, inputs, index, dim_size=None):
        self.stored = inputs
        return super().aggregate(inputs, index, dim_size=dim_size)


class WithMixin(Stored, StaticGCNConv):
    pass


class Updated(StaticGCNConv):
    def update(self, inputs):
        return 2 * inputs


class Propagated(StaticGCNConv):
    def propagate(self, edge_index, size=None, **kwargs):
        return 2 * super().propagate(edge_index, size=size, **kwargs)


@pytest.mark.parametrize("lead", LEADS)
def test_my_default_arg_conv(lead):
    # A subclass with a message of its own, and a default argument in it.
    x, ours, theirs = samples(*lead, 4, 8), Scaled(8, 32), ScaledOfPyG(8, 32)
    ours.load_state_dict(theirs.state_dict())
    assert close(ours(x, STAR), theirs(x, STAR))
    assert not close(ours(x, STAR), StaticGCNConv.forward(pair(8, 32)[0], x, STAR))


@pytest.mark.parametrize("lead", LEADS)
def test_overridden_methods(lead):
    x, (plain, _) = samples(*lead, 4, 8), pair(8, 32, bias=False)
    for layer, factor in ((Updated, 2), (Propagated, 2), (WithMixin, 1)):
        conv = layer(8, 32, bias=False)
        conv.load_state_dict(plain.state_dict())
        assert close(conv(x, STAR), factor * plain(x, STAR))
    assert conv.stored.shape == (*lead, 6 + 4, 32)


def test_edge_updater():
    # A subclass computes its weights from the nodes, edge by edge.
    class Learned(StaticGCNConv):
        def forward(self, x, edge_index, edge_weight=None):
            # edge_updater_type: (x: Tensor)
            weight = self.edge_updater(edge_index, x=x)
            return super().forward(x, edge_index, weight)

        def edge_update(self, x_j: torch.Tensor, x_i: torch.Tensor) -> torch.Tensor:
            return (x_j - x_i).abs().sum(-1)

    x, conv = samples(4, 8), Learned(8, 32)
    weight = (x[STAR[0]] - x[STAR[1]]).abs().sum(-1)
    expected = StaticGCNConv.forward(conv, x, STAR, weight)
    calls = []
    conv.register_edge_update_forward_hook(lambda *args: calls.append(1))
    assert close(conv(x, STAR), expected)
    assert calls == [1]


@pytest.mark.parametrize("lead", LEADS)
def test_explain_message(lead):
    x, conv = samples(*lead, 4, 8), StaticGCNConv(8, 32, normalize=False, bias=False)
    assert conv(x, STAR).abs().sum() != 0
    conv.explain = True
    with pytest.raises(ValueError, match="pre-defined 'edge_mask'"):
        conv(x, STAR)
    conv._edge_mask = torch.zeros(6)
    conv._apply_sigmoid = False
    assert conv(x, STAR).abs().sum() == 0
    conv.explain = False
    assert conv(x, STAR).abs().sum() != 0


@pytest.mark.parametrize(
    "module",
    [
        aggr.MeanAggregation(),
        aggr.SumAggregation(),
        aggr.MaxAggregation(),
        aggr.SoftmaxAggregation(),
        aggr.PowerMeanAggregation(),
    ],
)
def test_message_passing_with_aggr_module(module):
    ours, theirs = pair(8, 32, aggr=module)
    x = samples(4, 8)
    assert close(ours(x, STAR).nan_to_num(), theirs(x, STAR).nan_to_num())


@pytest.mark.parametrize("lead", LEADS)
@pytest.mark.parametrize("dtype", [torch.int32, torch.int16, torch.uint8])
def test_message_passing_int32_edge_index(lead, dtype):
    # PyG on a processor needs a hook that casts the index; here, any integer will do.
    conv, x = StaticGCNConv(8, 32), samples(*lead, 4, 8)
    assert close(conv(x, STAR.to(dtype), VALUE), conv(x, STAR, VALUE))


@pytest.mark.parametrize("lead", LEADS)
def test_edge_index_of_pyg(lead):
    conv, x = StaticGCNConv(8, 32), samples(*lead, 4, 8)
    edges = EdgeIndex(STAR, sparse_size=(4, 4))
    expected = conv(x, STAR, VALUE)
    for _ in range(2):
        assert close(conv(x, edges, VALUE), expected)


def test_node_dim():
    # Samples behind the nodes (N, B, F): PyG's own message does not broadcast over them.
    x, weight = samples(4, 3, 8), torch.ones(6)
    for conv in pair(8, 32, node_dim=0):
        with pytest.raises(RuntimeError):
            conv(x, STAR, weight)
    ours, theirs = pair(8, 32, node_dim=0, normalize=False)
    assert close(ours(x, STAR), theirs(x, STAR))
    assert ours(x, STAR).shape == (4, 3, 32)
