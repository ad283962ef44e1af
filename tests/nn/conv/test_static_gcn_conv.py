import copy
import io
import shutil
from itertools import pairwise

import pytest
import torch
from gcn_pairs import pair
from small_models import samples
from torch_geometric.data import Batch, Data
from torch_geometric.explain.algorithm.utils import clear_masks, set_masks
from torch_geometric.nn import GCNConv

from torch_geometric_tactile.nn.conv import StaticGCNConv, static_gcn_conv
from torch_geometric_tactile.nn.conv import _static_adjacency as static_adjacency
from torch_geometric_tactile.testing import (
    assert_permutation_equivariant,
    assert_static_equals_batched,
)

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


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("channels", [(3, 5), (5, 3)])
def test_static_gcn_conv_gradients(dim, channels):
    edge_index, x = EDGES["one_way"], samples(6, 4, channels[0])
    x = x if dim == 3 else x[0]
    grads = []
    for conv in pair(*channels):
        weight, inputs = weights(edge_index).requires_grad_(), x.clone().requires_grad_()
        for _ in range(2):  # the second pass must not go through the graph of the first
            conv(inputs, edge_index, weight).square().sum().backward()
        grads.append([weight.grad, inputs.grad, conv.lin.weight.grad, conv.bias.grad])
    for ours, theirs in zip(*grads, strict=True):
        assert theirs.abs().max() > 0
        assert torch.allclose(ours, theirs, rtol=1e-4, atol=1e-5)


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


def test_static_gcn_conv_lazy():
    conv = StaticGCNConv(-1, 5)
    assert conv(samples(6, 4, 3), EDGES["one_way"]).shape == (6, 4, 5)
    assert conv.lin.weight.shape == (5, 3)


def test_static_gcn_conv_laws():
    for name, edge_index in EDGES.items():
        x = samples(6, 4, 3)
        assert_static_equals_batched(StaticGCNConv(3, 5), x, edge_index)
        assert_static_equals_batched(StaticGCNConv(3, 5), x, edge_index, weights(edge_index))
        if name != "none":
            assert_permutation_equivariant(StaticGCNConv(3, 5), x, edge_index)


def test_static_gcn_conv_many_nodes():
    edge_index = torch.stack([torch.arange(1100), torch.arange(1100).roll(1)])
    ours, theirs = pair(3, 5)
    x = samples(2, 1100, 3)
    assert torch.allclose(ours(x, edge_index), theirs(x, edge_index), atol=1e-5)
    assert ours._edge_cache.current is not None
    assert ours._edge_cache.current._dense is None  # 4.8 MB


def test_static_gcn_conv_empty_and_single():
    conv = StaticGCNConv(3, 5)
    assert conv(samples(0, 4, 3), EDGES["one_way"]).shape == (0, 4, 5)
    assert torch.allclose(conv(samples(2, 1, 3), EDGES["none"]), conv.lin(samples(2, 1, 3)))


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


def test_static_gcn_conv_sees_changes(count_norm):
    ours, theirs = pair(3, 5)
    x, edge_index, weight = samples(6, 4, 3), EDGES["one_way"].clone(), torch.ones(3)
    steps = [
        lambda: None,
        lambda: edge_index[0].fill_(2),  # in place, through a view
        lambda: weight.mul_(3),
        lambda: edge_index.copy_(EDGES["one_way"]),
    ]
    outs = []
    for i, step in enumerate(steps):
        step()
        outs.append(ours(x, edge_index, weight))
        assert torch.allclose(outs[-1], theirs(x, edge_index, weight), atol=1e-6)
        assert len(count_norm) == i + 1
    assert not any(torch.allclose(a, b) for a, b in pairwise(outs))
    other = EDGES["both_ways"]
    assert torch.allclose(ours(x, other), theirs(x, other), atol=1e-6)
    assert torch.allclose(ours(x, edge_index), theirs(x, edge_index), atol=1e-6)


@pytest.mark.parametrize("weighted", [False, True])
def test_static_gcn_conv_trains_after_inference_mode(weighted, count_norm):
    conv, edge_index = StaticGCNConv(5, 3), EDGES["one_way"].clone()
    weight = torch.ones(3) if weighted else None
    with torch.inference_mode():
        before = conv(samples(6, 4, 5), edge_index, weight)
    after = conv(samples(6, 4, 5), edge_index, weight)
    after.sum().backward()
    assert torch.equal(after, before)
    assert len(count_norm) == 1


def test_static_gcn_conv_sees_changes_in_inference_mode():
    ours, theirs = pair(3, 5)
    x = samples(6, 4, 3)
    with torch.inference_mode():
        edge_index = EDGES["one_way"].clone()
        ours(x, edge_index)
        edge_index[0] = 3
        assert torch.allclose(ours(x, edge_index), theirs(x, edge_index), atol=1e-6)


def test_static_gcn_conv_explained():
    ours, theirs = pair(3, 5)
    x, edge_index = samples(6, 4, 3), EDGES["one_way"]
    unmasked = ours(x, edge_index)
    mask = torch.nn.Parameter(torch.tensor([0.0, 0.5, 1.0]))
    for conv in (ours, theirs):
        set_masks(conv, mask, edge_index, apply_sigmoid=False)
    masked = ours(x, edge_index)
    assert torch.allclose(masked, theirs(x, edge_index), atol=1e-6)
    assert not torch.allclose(masked, unmasked)
    clear_masks(ours)
    assert torch.equal(ours(x, edge_index), unmasked)


def test_static_gcn_conv_copies():
    conv, x, edge_index = StaticGCNConv(3, 5), samples(6, 4, 3), EDGES["one_way"]
    expected = conv(x, edge_index)
    assert conv._edge_cache.current is not None
    file = io.BytesIO()
    torch.save(conv, file)
    file.seek(0)
    for other in (copy.deepcopy(conv), torch.load(file, weights_only=False)):
        assert other._edge_cache.current is None  # copies carry no edges along
        assert torch.equal(other(x, edge_index), expected)
    conv.reset_parameters()
    assert not torch.allclose(conv(x, edge_index), expected)
    assert torch.equal(conv.bias, torch.zeros(5))


@pytest.mark.full
@pytest.mark.parametrize("backend", ["eager", "inductor"])
def test_static_gcn_conv_compile(backend):
    if backend == "inductor" and not any(shutil.which(name) for name in ("c++", "g++", "clang++")):
        pytest.skip("no C++ compiler")
    torch.compiler.reset()
    conv, edge_index = StaticGCNConv(3, 5), EDGES["one_way"]
    compiled = torch.compile(conv, fullgraph=True, backend=backend)
    sizes = ((6, 4, 3), (4, 3)) if backend == "eager" else ((6, 4, 3),)
    for size in sizes:
        x = samples(*size)
        assert torch.allclose(compiled(x, edge_index), conv(x, edge_index), atol=1e-6)


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


def test_static_gcn_conv_export():
    conv, x, edge_index = StaticGCNConv(3, 5), samples(6, 4, 3), EDGES["one_way"]
    exported = torch.export.export(
        conv,
        (x, edge_index),
        dynamic_shapes={"x": {0: torch.export.Dim("batch")}, "edge_index": None},
    ).module()
    x = samples(9, 4, 3)
    assert torch.allclose(exported(x, edge_index), conv(x, edge_index), atol=1e-6)


def test_static_gcn_conv_any_leading_shape():
    conv, x = StaticGCNConv(3, 5), samples(2, 6, 4, 3)
    out = conv(x, EDGES["one_way"])
    assert torch.allclose(out, conv(x.flatten(0, 1), EDGES["one_way"]).view(2, 6, 4, 5), atol=1e-6)


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
BAD_EDGES = [
    (torch.zeros(7, 2, dtype=torch.long), r"shape \(2, num_edges\) \(got \(7, 2\)\)"),
    (torch.zeros(2, dtype=torch.long), r"shape \(2, num_edges\) \(got \(2,\)\)"),
    (torch.zeros(1, 2, 3, dtype=torch.long), r"shape \(2, num_edges\) \(got \(1, 2, 3\)\)"),
    (torch.zeros(2, 3), r"hold integers \(got torch.float32\)"),
    (torch.zeros(2, 3, dtype=torch.bool), r"hold integers \(got torch.bool\)"),
    (torch.tensor([[4], [0]]), r"node indices from 0 to 3, the rows of 'x' \(got 0 to 4\)"),
    (torch.tensor([[0], [4]]), r"node indices from 0 to 3, the rows of 'x' \(got 0 to 4\)"),
    (torch.tensor([[-1], [0]]), r"node indices from 0 to 3, the rows of 'x' \(got -1 to 0\)"),
    (torch.tensor([[0], [-1]]), r"node indices from 0 to 3, the rows of 'x' \(got -1 to 0\)"),
    (torch.eye(5).to_sparse(), r"shape \(4, 4\) if it is sparse.*\(got \(5, 5\)\)"),
]


@pytest.mark.parametrize("kwargs", [{}, {"normalize": False}, {"cached": True}, {"fast": False}])
@pytest.mark.parametrize("size", FORMS)
@pytest.mark.parametrize(("edge_index", "match"), BAD_EDGES)
def test_static_gcn_conv_bad_edges(size, edge_index, match, kwargs):
    conv = StaticGCNConv(3, 5, **kwargs)
    for _ in range(2):  # the first failure leaves nothing behind
        with pytest.raises(ValueError, match=f"'edge_index' must .*{match}"):
            conv(samples(*size), edge_index)
    conv(samples(*size), EDGES["one_way"])


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
@pytest.mark.parametrize(
    ("weight", "match"),
    [
        (torch.ones(4), r"shape \(3,\), one weight per edge \(got \(4,\)\)"),
        (torch.ones(3, 2), r"shape \(3,\), one weight per edge \(got \(3, 2\)\)"),
        (torch.tensor(1.0), r"shape \(3,\), one weight per edge \(got \(\)\)"),
        (torch.ones(3, dtype=torch.bool), r"hold real numbers \(got torch.bool\)"),
        (torch.ones(3, dtype=torch.cfloat), r"hold real numbers \(got torch.complex64\)"),
    ],
)
def test_static_gcn_conv_bad_weights(size, weight, match):
    with pytest.raises(ValueError, match=f"'edge_weight' must .*{match}"):
        StaticGCNConv(3, 5)(samples(*size), EDGES["one_way"], weight)


@pytest.mark.parametrize("size", FORMS)
def test_static_gcn_conv_weights_beside_a_sparse_matrix(size):
    with pytest.raises(ValueError, match=r"'edge_weight' must be None if 'edge_index' is sparse"):
        StaticGCNConv(3, 5)(samples(*size), torch.eye(4).to_sparse(), torch.ones(4))


@pytest.mark.parametrize("size", FORMS)
def test_static_gcn_conv_whole_weights(size):
    # Whole numbers and a column are weights as well.
    conv, edge_index = StaticGCNConv(3, 5), EDGES["one_way"]
    expected = conv(samples(*size), edge_index, torch.tensor([1.0, 2.0, 3.0]))
    for weight in (torch.tensor([1, 2, 3]), torch.tensor([[1.0], [2.0], [3.0]])):
        assert torch.allclose(conv(samples(*size), edge_index, weight), expected)


def test_static_gcn_conv_bad_x():
    conv = StaticGCNConv(3, 5)
    with pytest.raises(ValueError, match=r"'x' must have shape .* \(got \(3,\)\)"):
        conv(torch.zeros(3), EDGES["one_way"])
    for size in ((4, 2), (6, 4, 2)):
        with pytest.raises(ValueError, match=r"'x' must have 3 features \(got shape \(.*4, 2\)\)"):
            conv(torch.zeros(size), EDGES["one_way"])
    with pytest.raises(ValueError, match=r"'x' must hold floating-point .*\(got torch.int64\)"):
        conv(torch.zeros(6, 4, 3, dtype=torch.long), EDGES["one_way"])


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
