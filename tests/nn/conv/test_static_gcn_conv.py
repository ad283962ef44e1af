import pytest
import torch
from gcn_pairs import pair
from small_models import samples
from torch_geometric.data import Batch, Data
from torch_geometric.nn import GCNConv

from torch_geometric_tactile.nn.conv import StaticGCNConv, static_gcn_conv
from torch_geometric_tactile.nn.conv import _static_adjacency as static_adjacency

EDGES = {
    "both_ways": torch.tensor([[0, 1, 1, 2], [1, 0, 2, 1]]),
    "one_way": torch.tensor([[0, 1, 3], [1, 2, 2]]),
    "self_loops": torch.tensor([[0, 1, 2, 2], [0, 2, 2, 3]]),
    "twice": torch.tensor([[0, 0, 1], [1, 1, 0]]),
    "none": torch.empty(2, 0, dtype=torch.long),
}


def weights(edge_index, dtype=torch.float):
    return 0.5 + torch.arange(edge_index.size(1), dtype=dtype)


def block_diagonal(x, edge_index, edge_weight=None):
    parts = [Data(x=row, edge_index=edge_index, edge_weight=edge_weight) for row in x]
    return Batch.from_data_list(parts)


@pytest.fixture
def count_norm(monkeypatch):
    calls, norm = [], static_adjacency.edge_norm

    def counted(*args, **kwargs):
        calls.append(args)
        return norm(*args, **kwargs)

    monkeypatch.setattr(static_adjacency, "edge_norm", counted)
    return calls


def test_static_gcn_conv_by_hand():
    # Both nodes have degree 2 with their self loop: each output is the mean times W.
    conv = StaticGCNConv(1, 1, bias=False)
    torch.nn.init.constant_(conv.lin.weight, 10.0)
    edge_index = torch.tensor([[0, 1], [1, 0]])
    x = torch.tensor([[1.0], [4.0]])
    assert torch.allclose(conv(x, edge_index), torch.full((2, 1), 25.0))
    assert torch.allclose(conv(x[None], edge_index), torch.full((1, 2, 1), 25.0))


def test_static_gcn_conv_runs_from_source_to_target():
    conv = StaticGCNConv(1, 1, bias=False)
    torch.nn.init.ones_(conv.lin.weight)
    for x in (torch.tensor([[1.0], [0.0]]), torch.tensor([[[1.0], [0.0]]])):
        out = conv(x, torch.tensor([[0], [1]])).view(-1)  # degrees 1 and 2
        assert torch.allclose(out, torch.tensor([1.0, 0.5**0.5]))


@pytest.mark.parametrize("name", EDGES)
@pytest.mark.parametrize("weighted", [False, True])
@pytest.mark.parametrize("channels", [(3, 5), (5, 3)])
def test_static_gcn_conv_equals_gcn_conv(name, weighted, channels):
    edge_index, x = EDGES[name], samples(6, 4, channels[0])
    weight = weights(edge_index) if weighted else None
    ours, theirs = pair(*channels)
    expected = theirs(x, edge_index, weight)
    batch = block_diagonal(x, edge_index, weight)
    assert torch.allclose(ours(x, edge_index, weight), expected, atol=1e-6)
    assert torch.allclose(ours(x[2], edge_index, weight), expected[2], atol=1e-6)
    out = ours(batch.x, batch.edge_index, batch.edge_weight)
    assert torch.allclose(out.view_as(expected), expected, atol=1e-6)


def test_static_gcn_conv_dtypes():
    edge_index, x = EDGES["one_way"], samples(6, 4, 3, dtype=torch.double)
    ours, theirs = (conv.double() for conv in pair(3, 5))
    weight = weights(edge_index, torch.double)
    assert torch.allclose(ours(x, edge_index, weight), theirs(x, edge_index, weight), atol=1e-12)
    # Weights in single precision go with readings in double.
    out = ours(x, edge_index, weight.float())
    assert out.dtype == torch.double
    assert torch.allclose(out, theirs(x, edge_index, weight.float()), atol=1e-6)
    ours(x, edge_index)
    assert ours.float()(x.float(), edge_index).dtype == torch.float


def test_static_gcn_conv_many_nodes():
    edge_index = torch.stack([torch.arange(1100), torch.arange(1100).roll(1)])
    ours, theirs = pair(3, 5)
    x = samples(2, 1100, 3)
    assert torch.allclose(ours(x, edge_index), theirs(x, edge_index), atol=1e-5)
    assert ours._edge_cache.current is not None
    assert ours._edge_cache.current._dense is None  # 4.8 MB


def test_static_gcn_conv_normalises_once(count_norm):
    conv, edge_index, weight = StaticGCNConv(3, 5), EDGES["one_way"].clone(), torch.ones(3)
    for _ in range(3):
        conv(samples(6, 4, 3), edge_index)
        conv(samples(2, 4, 3), edge_index)
    assert len(count_norm) == 1
    for _ in range(3):
        conv(samples(6, 4, 3), edge_index, weight)
    assert len(count_norm) == 2
    conv(samples(6, 5, 3), edge_index, weight)  # one node more
    assert len(count_norm) == 3


@pytest.mark.parametrize("improved", [False, True])
def test_compiled_self_loops_are_those_of_pyg(improved):
    torch.compiler.reset()
    conv, x = StaticGCNConv(3, 5, improved=improved), samples(4, 3)
    like = GCNConv(3, 5, improved=improved)
    like.load_state_dict(conv.state_dict())
    edge_index = torch.tensor([[0, 1, 1, 3, 0], [1, 1, 2, 3, 2]])  # two loops, and a taxel without
    compiled = torch.compile(conv, fullgraph=True, backend="eager")
    for weight in (None, torch.tensor([0.5, 3.0, 1.0, 0.25, 2.0])):
        expected = like(x, edge_index, weight)
        assert torch.allclose(compiled(x, edge_index, weight), expected, atol=1e-6)


def test_static_gcn_conv_fast(count_norm):
    slow, fast = StaticGCNConv(3, 5, fast=False), StaticGCNConv(3, 5)
    fast.load_state_dict(slow.state_dict())
    x, edge_index = samples(6, 4, 3), EDGES["one_way"]
    expected = slow(x, edge_index)
    assert count_norm == []
    assert torch.allclose(fast(x, edge_index), expected, atol=1e-6)
    assert len(count_norm) == 1


def test_static_gcn_conv_calls_its_linear_map():
    # On either side of the product with the adjacency, with what PyG's layer calls it with if it
    # is watched.
    x = samples(6, 4, 3)
    for width in (2, 5):
        seen, conv = [], StaticGCNConv(3, width)
        conv.lin.register_forward_pre_hook(lambda module, args, seen=seen: seen.append(args[0]))
        conv(x, EDGES["one_way"])
        assert len(seen) == 1
        assert torch.equal(seen[0], x)


FORMS = [(4, 3), (6, 4, 3)]


@pytest.mark.parametrize("size", FORMS)
def test_static_gcn_conv_bad_edges_of_weights_that_learn(size):
    # Nothing is kept, and the edges are checked all the same, also after a write.
    conv, weight = StaticGCNConv(3, 5), torch.ones(1, requires_grad=True)
    edge_index = torch.tensor([[0], [1]])
    conv(samples(*size), edge_index, weight)
    edge_index[0] = 4
    with pytest.raises(ValueError, match=r"from 0 to 3, the rows of 'x' \(got 1 to 4\)"):
        conv(samples(*size), edge_index, weight)


@pytest.mark.parametrize("size", FORMS)
def test_static_gcn_conv_whole_weights(size):
    # Whole numbers and a column are weights as well.
    conv, edge_index = StaticGCNConv(3, 5), EDGES["one_way"]
    expected = conv(samples(*size), edge_index, torch.tensor([1.0, 2.0, 3.0]))
    for weight in (torch.tensor([1, 2, 3]), torch.tensor([[1.0], [2.0], [3.0]])):
        assert torch.allclose(conv(samples(*size), edge_index, weight), expected)


def test_whole_numbers_are_no_features():
    with pytest.raises(ValueError, match=r"'x' must hold floating-point .*\(got torch.int64\)"):
        StaticGCNConv(3, 5)(torch.zeros(6, 4, 3, dtype=torch.long), EDGES["one_way"])


@pytest.mark.parametrize("flow", ["source_to_target", "target_to_source"])
@pytest.mark.parametrize("with_weight", [False, True])
@pytest.mark.parametrize("edges", EDGES)
def test_messages_of_gpus_normalize_edges_once(monkeypatch, count_norm, edges, with_weight, flow):
    # As more than 1,024 taxels on a GPU, where each normalisation waits.
    monkeypatch.setattr(static_gcn_conv, "may_multiply", lambda x: False)
    monkeypatch.setattr(static_gcn_conv, "may_cache_edges", lambda x: True)
    edge_index = EDGES[edges]
    weight = weights(edge_index) if with_weight else None
    ours, theirs = pair(3, 5, flow=flow)
    x = samples(2, 4, 3)
    expected = theirs(x, edge_index, weight)
    count_norm.clear()
    results = [ours(x, edge_index, weight) for _ in range(2)]
    assert len(count_norm) == 1
    for out in results:
        torch.testing.assert_close(out, expected)
    loops = ours.propagate
    monkeypatch.setattr(ours, "propagate", lambda *args, **kwargs: 2 * loops(*args, **kwargs))
    assert not torch.allclose(ours(x, edge_index, weight), expected)  # messages are passed
