"""PyG's tests of what `GCNConv` uses of `MessagePassing`, for `StaticGCNConv`.

Each test here is written after the one of the same name in PyG's
`test/nn/conv/test_message_passing.py` (MIT license, https://github.com/pyg-team/pytorch_geometric),
and runs for one sample and for several. What differs from PyG is a test as well, and stands in
docs/layers.md.
"""

import copy

import pytest
import torch
from gcn_pairs import LEADS, STAR, VALUE, close, pair
from small_models import samples
from torch_geometric import EdgeIndex
from torch_geometric.nn import GCNConv, aggr
from torch_geometric.utils import to_torch_csc_tensor

from torch_geometric_tactile.nn.conv import StaticGCNConv

pytestmark = [
    pytest.mark.filterwarnings("ignore:Sparse"),
    pytest.mark.filterwarnings("ignore:Converting sparse tensor to CSR"),
]


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
    with pytest.raises(ValueError, match=r"'edge_index' must hold node indices from 0 to 2, .*got"):
        StaticGCNConv(8, 32)(samples(*lead, 3, 8), torch.tensor(edges), samples(4))


def test_my_conv_jittable():
    # TorchScript takes PyG's layer with the same weights, not ours.
    ours, theirs = pair(8, 32)
    with pytest.raises((RuntimeError, torch.jit.frontend.NotSupportedError)):
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


def test_explain_message_of_subclasses():
    # PyG compiles `propagate` into a class at its first use; a subclass must not inherit that.
    class Child(StaticGCNConv):
        pass

    class GrandChild(Child):
        pass

    class Doubled(Propagated):
        pass

    x = samples(3, 4, 8)
    for layer in (GCNConv, StaticGCNConv, Child, GrandChild):
        conv = layer(8, 32, normalize=False, bias=False)
        assert conv(x, STAR).abs().sum() != 0
        conv.explain, conv._edge_mask, conv._apply_sigmoid = True, torch.zeros(6), False
        assert conv(x, STAR).abs().sum() == 0
    assert not Child._overrides_messages
    assert not GrandChild._overrides_messages
    assert Doubled._overrides_messages


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
