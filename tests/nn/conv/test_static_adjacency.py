import copy
import gc
import pickle
import threading

import pytest
import torch
from torch_geometric.nn import GCNConv
from torch_geometric.nn.conv.gcn_conv import gcn_norm
from torch_geometric.utils import to_dense_adj

from torch_geometric_tactile.nn.conv import StaticGCNConv
from torch_geometric_tactile.nn.conv import _edge_cache as edge_cache
from torch_geometric_tactile.nn.conv import _static_adjacency as static_adjacency
from torch_geometric_tactile.nn.conv._static_adjacency import (
    AdjacencyCache,
    GCNNorm,
    StaticAdjacency,
    dense_norm,
    edge_norm,
)

EDGES = torch.tensor([[0, 1, 3, 2], [1, 2, 2, 2]])
WEIGHT = torch.tensor([0.5, 2.0, 1.5, 3.0])


def get(cache, edge_index=EDGES, edge_weight=None, num_nodes=4, dtype=torch.float, **kwargs):
    return cache.get(edge_index, edge_weight, num_nodes, dtype, **kwargs)


def through_data(tensor):
    tensor.data[..., 0] = 3


def through_numpy(tensor):
    tensor.numpy()[..., 0] = 3


def in_place(tensor):
    tensor[..., 0] = 3


def new_data(tensor):
    tensor.data = tensor.flip(-1)


@pytest.mark.parametrize("which", ["edge_index", "edge_weight"])
@pytest.mark.parametrize("change", [through_data, through_numpy, in_place, new_data])
@pytest.mark.parametrize("inference", [False, True])
def test_static_gcn_conv_is_never_stale(which, change, inference):
    theirs = GCNConv(3, 5)
    ours = StaticGCNConv(3, 5)
    ours.load_state_dict(theirs.state_dict())
    x = torch.randn(6, 4, 3, generator=torch.Generator().manual_seed(0))
    with torch.inference_mode(inference):
        given = {"edge_index": EDGES.clone(), "edge_weight": WEIGHT.clone()}
        before = ours(x, **given)
        change(given[which])
        out = ours(x, **given)
        assert torch.allclose(out, theirs(x, **given), atol=1e-6)
        assert not torch.allclose(out, before)


@pytest.mark.parametrize("which", ["edge_index", "edge_weight"])
def test_adjacency_cache_outlives_the_callers_tensors(which):
    # Tensors die and others are born at their address: only the values count.
    cache = AdjacencyCache()
    kept = get(cache, EDGES.clone(), WEIGHT.clone())
    gc.collect()
    assert get(cache, EDGES.clone(), WEIGHT.clone()) is kept
    for _ in range(20):
        given = {"edge_index": EDGES.clone(), "edge_weight": WEIGHT.clone()}
        given[which] = given[which].flip(-1)
        other = get(cache, **given)
        assert other is not kept
        assert torch.equal(other.dense, dense_norm(*given.values(), 4, torch.float))
        kept = get(cache, EDGES.clone(), WEIGHT.clone())


def test_adjacency_cache_tells_apart():
    cache, whole = AdjacencyCache(), torch.tensor([1, 1, 1, 1])
    calls = [
        {},
        {"edge_weight": WEIGHT},
        {"edge_weight": whole},
        {"edge_weight": whole.float()},
        {"edge_index": EDGES[:, :3]},
        {"edge_index": EDGES.int()},
        {"num_nodes": 5},
        {"dtype": torch.double},
        {"norm": GCNNorm(improved=True)},
        {"norm": GCNNorm(flow="target_to_source")},
        {"norm": GCNNorm(add_self_loops=False)},
        {"norm": GCNNorm(normalize=False)},
        {"edge_index": torch.eye(4).to_sparse()},
        {"edge_index": 2 * torch.eye(4).to_sparse()},
        {"edge_index": torch.eye(4).to_sparse_csr()},
    ]
    last = None
    for call in calls:
        kept = get(cache, **call)
        assert kept is not last
        assert get(cache, **call) is kept
        last = kept


def test_adjacency_cache_keeps_one(monkeypatch):
    cache = AdjacencyCache()
    first = get(cache)
    get(cache, EDGES[:, :3])
    assert cache.current is not first
    assert get(cache) is not first


def test_static_adjacency_keeps_few_rows(monkeypatch):
    monkeypatch.setattr(static_adjacency, "_MAX_ROW_BLOCKS", 3)
    adjacency = StaticAdjacency(*edge_norm(EDGES, WEIGHT, 4, torch.float), 4)
    for start in range(4):
        for _ in range(2):
            rows = adjacency.rows(start, 4)
            assert torch.equal(rows.to_dense(), adjacency.dense[start:])
    assert adjacency.rows(3, 4) is rows
    assert len(adjacency._rows) <= 3


def test_adjacency_cache_is_not_kept():
    cache = AdjacencyCache()
    assert get(cache, edge_weight=WEIGHT.clone().requires_grad_()) is None
    assert get(cache, EDGES.to("meta"), dtype=torch.float) is None
    assert cache.current is None


@pytest.mark.filterwarnings("ignore")
def test_static_gcn_conv_traced():
    # A trace records the edges as an input, not the matrix of those it saw.
    conv, x = StaticGCNConv(3, 5), torch.ones(6, 4, 3)
    conv(x, EDGES)
    traced = torch.jit.trace(conv, (x, EDGES))
    other = EDGES.flip(-1).contiguous() % 3
    assert torch.allclose(traced(x, other), conv(x, other), atol=1e-6)


def test_adjacency_cache_copies_are_empty():
    cache = AdjacencyCache()
    get(cache)
    for other in (copy.deepcopy(cache), pickle.loads(pickle.dumps(cache))):
        assert other.current is None
        assert torch.equal(get(other).dense, get(cache).dense)


def test_adjacency_cache_in_threads():
    cache, errors = AdjacencyCache(), []
    graphs = [EDGES[:, : i + 1].contiguous() for i in range(4)]
    expected = [dense_norm(graph, None, 4, torch.float) for graph in graphs]

    def work(i):
        for j in range(100):
            k = (i + j) % 4
            if not torch.equal(get(cache, graphs[k]).dense, expected[k]):
                errors.append(k)

    threads = [threading.Thread(target=work, args=(i,)) for i in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert errors == []


@pytest.mark.parametrize("device", ["cpu", "other"])
def test_kept_tensor_on_other_devices(device, monkeypatch):
    # On a GPU, the same object that was not written to needs no comparison, which would wait.
    class Other(torch.Tensor):
        @property
        def device(self):
            return torch.device("cuda" if device == "other" else "cpu")

        @property
        def is_cpu(self):
            return device == "cpu"

    monkeypatch.setattr(edge_cache, "_TENSOR_TYPES", (Other,))
    compared, equal = [], torch.equal
    monkeypatch.setattr(torch, "equal", lambda a, b: compared.append(1) or equal(a, b))
    tensor = EDGES.clone().as_subclass(Other)
    kept = edge_cache.TensorSnapshot(tensor)
    assert kept.equals(tensor)
    assert len(compared) == (device == "cpu")
    compared.clear()
    same = tensor.clone()
    assert kept.equals(same)  # another object with the same values is compared once
    assert kept.equals(same)
    assert len(compared) == (1 if device == "other" else 2)
    same[0, 0] = 2  # a write is compared
    assert not kept.equals(same)
    same.data = tensor.data.clone()  # and so is other memory
    assert kept.equals(same)


@pytest.mark.parametrize("weighted", [False, True])
@pytest.mark.parametrize("dtype", [torch.float, torch.double])
@pytest.mark.parametrize(
    "norm",
    [
        GCNNorm(),
        GCNNorm(improved=True),
        GCNNorm(add_self_loops=False),
        GCNNorm(flow="target_to_source"),
        GCNNorm(True, True, True, "target_to_source"),
    ],
)
def test_dense_norm_equals_gcn_norm(norm, dtype, weighted):
    weight = WEIGHT.to(dtype) if weighted else None
    edges = torch.cat([EDGES, EDGES[:, :1]], dim=1)  # an edge twice
    weight = torch.cat([weight, weight[:1]]) if weighted else None
    dense = dense_norm(edges, weight, 5, dtype, norm=norm)
    index, value = gcn_norm(edges, weight, 5, norm.improved, norm.add_self_loops, norm.flow, dtype)
    expected = to_dense_adj(index, edge_attr=value, max_num_nodes=5)[0]
    if norm.flow == "source_to_target":
        expected = expected.t()  # rows are targets
    assert dense.dtype == dtype
    assert torch.allclose(dense, expected)


def test_dense_norm_segment():
    # Edges between segments do not count, of a sparse matrix as of a list.
    segment = torch.tensor([0, 0, 1, 1])
    dense = dense_norm(EDGES, WEIGHT, 4, torch.float, segment)
    assert torch.equal(dense, dense_norm(EDGES[:, [0, 2, 3]], WEIGHT[[0, 2, 3]], 4, torch.float))
    adj_t = torch.sparse_coo_tensor(EDGES.flip(0), WEIGHT, (4, 4))
    for form in (adj_t, adj_t.to_sparse_csr()):
        assert torch.equal(dense_norm(form, None, 4, torch.float, segment), dense)


@pytest.mark.parametrize("widths", [(2, 5), (5, 2)])
def test_double_weights_give_double_as_in_pyg(widths):
    conv, like = StaticGCNConv(*widths), GCNConv(*widths)
    like.load_state_dict(conv.state_dict())
    x, edges = torch.randn(4, 3, widths[0]), torch.tensor([[0, 1, 2], [1, 2, 0]])
    for weight in (torch.rand(3).double(), torch.rand(3).double().requires_grad_()):
        found, expected = conv(x, edges, weight), like(x, edges, weight)
        assert found.dtype == expected.dtype == torch.double
        assert torch.allclose(found, expected, atol=1e-6)
        assert conv(x, edges, weight).equal(found)
    assert conv(x, edges, torch.rand(3).half()).dtype == torch.float
