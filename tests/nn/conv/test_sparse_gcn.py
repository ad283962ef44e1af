"""Layers by a sparse product against PyG's messages."""

import warnings

import pytest
import torch
from small_models import EDGE_INDEX, NUM_EDGES, samples
from torch.autograd import forward_ad
from torch_geometric.data import Batch, Data
from torch_geometric.nn import GCNConv, GraphConv

from torch_geometric_tactile.nn import SegmentedGCNConv, SelfGCNConv, StaticGCNConv
from torch_geometric_tactile.nn.conv import _sparse_gcn

POSITIVE = samples(NUM_EDGES, seed=3, dtype=torch.double).exp()
WEIGHTS = {
    "none": None,
    "positive": POSITIVE,
    "zero": POSITIVE * (torch.arange(NUM_EDGES) % 3 > 0),
    "negative": POSITIVE * torch.where(torch.arange(NUM_EDGES) == 4, -50.0, 1.0),
    "missing": POSITIVE.clone().index_fill_(0, torch.tensor([2]), torch.nan),
    "infinite": POSITIVE.clone().index_fill_(0, torch.tensor([2]), torch.inf),
}
FORMS = {
    "blocks": {"_BLOCK_BYTES": 1, "_MAX_DIRECT_ROWS": 0},
    "narrow": {"_BLOCK_BYTES": 1, "_MAX_DIRECT_ROWS": 1024},
    "small": {"_BLOCK_BYTES": 2**20, "_MAX_DIRECT_ROWS": 0},
    "few": {},
}
# On either side of the linear map.
WIDTHS = [(3, 16), (8, 8), (6, 2)]


def pair(kind, widths, dtype=torch.double):
    if kind == "gcn":
        ours, theirs = StaticGCNConv(*widths), GCNConv(*widths)
    else:
        ours, theirs = SelfGCNConv(*widths, normalize=False), GraphConv(*widths)
    ours.load_state_dict(theirs.state_dict())
    torch.nn.init.normal_(ours.bias if kind == "gcn" else ours.lin_rel.bias)
    theirs.load_state_dict(ours.state_dict())
    return ours.to(dtype), theirs.to(dtype)


def on_batch(layer, x, weight):
    parts = [Data(x=row, edge_index=EDGE_INDEX, edge_weight=weight) for row in x]
    batch = Batch.from_data_list(parts)
    return layer(batch.x, batch.edge_index, batch.edge_weight).view(*x.shape[:2], -1)


def gradients(layer, out, x):
    scale = torch.arange(out.numel(), dtype=out.dtype).view_as(out).cos()
    return torch.autograd.grad(
        (out * scale).sum(), [x, *(p for _, p in sorted(layer.named_parameters()))]
    )


@pytest.mark.parametrize("kind", ["gcn", "self"])
@pytest.mark.parametrize("widths", WIDTHS)
@pytest.mark.parametrize("weight", WEIGHTS)
@pytest.mark.parametrize("num_samples", [1, 2, 9])
@pytest.mark.parametrize("form", FORMS)
def test_numbers_and_gradients_of_pyg(kind, widths, weight, num_samples, form, monkeypatch):
    for name, value in FORMS[form].items():
        monkeypatch.setattr(_sparse_gcn, name, value)
    ours, theirs = pair(kind, widths)
    weight = WEIGHTS[weight]
    x = samples(num_samples, 11, widths[0], dtype=torch.double).requires_grad_()
    out, expected = ours(x, EDGE_INDEX, weight), on_batch(theirs, x, weight)
    assert out.is_contiguous()
    assert torch.allclose(out, expected, rtol=1e-10, equal_nan=True)
    for mine, other in zip(gradients(ours, out, x), gradients(theirs, expected, x), strict=True):
        assert torch.allclose(mine, other, rtol=1e-9, atol=1e-12, equal_nan=True)


@pytest.mark.parametrize("bad", [torch.nan, torch.inf, -torch.inf])
@pytest.mark.parametrize("kind", ["gcn", "self"])
@pytest.mark.parametrize("widths", WIDTHS)
@pytest.mark.parametrize("num_samples", [1, 9])
def test_missing_and_infinite_readings_reach_the_taxels_of_pyg(kind, widths, bad, num_samples):
    ours, theirs = pair(kind, widths)
    x = samples(num_samples, 11, widths[0], dtype=torch.double)
    x[0, 3, 0] = bad
    out, expected = ours(x, EDGE_INDEX, POSITIVE), on_batch(theirs, x, POSITIVE)
    assert 0 < (~expected.isfinite()).sum() < expected.numel()
    assert torch.allclose(out, expected, equal_nan=True)


@pytest.mark.parametrize("kind", ["gcn", "self"])
@pytest.mark.parametrize("block", [1, 2**20])
@pytest.mark.parametrize("widths", [(2, 2), (3, 2)])
def test_second_and_forward_derivatives(kind, widths, block, monkeypatch):
    monkeypatch.setattr(_sparse_gcn, "_BLOCK_BYTES", block)
    ours, _ = pair(kind, widths)
    parameters = list(ours.parameters())
    x = samples(2, 11, widths[0], dtype=torch.double).requires_grad_()

    def compute(x, *values):
        state = dict(zip(dict(ours.named_parameters()), values, strict=True))
        return torch.func.functional_call(ours, state, (x, EDGE_INDEX, POSITIVE))

    torch.autograd.gradcheck(compute, (x, *parameters), check_forward_ad=True)
    torch.autograd.gradgradcheck(compute, (x, *parameters))


def test_forward_derivative_of_the_input_alone():
    ours, theirs = pair("gcn", (8, 8))
    x, tangent = (
        samples(2, 11, 8, dtype=torch.double),
        samples(2, 11, 8, seed=1, dtype=torch.double),
    )
    with forward_ad.dual_level():
        dual = forward_ad.make_dual(x, tangent)
        found = forward_ad.unpack_dual(ours(dual, EDGE_INDEX)).tangent
        expected = forward_ad.unpack_dual(theirs(dual, EDGE_INDEX)).tangent
    assert torch.allclose(found, expected)


@pytest.mark.parametrize("kind", ["gcn", "self"])  # with the edges of the caller: "self"
def test_gradients_of_edges_written_to_before_the_backward_pass(kind):
    ours, theirs = pair(kind, (8, 8))
    edges, weight = EDGE_INDEX.clone(), POSITIVE.clone()
    x = samples(4, 11, 8, dtype=torch.double).requires_grad_()
    out, expected = ours(x, edges, weight), theirs(x, EDGE_INDEX, POSITIVE)
    edges.fill_(0)
    weight.fill_(0)
    for mine, other in zip(gradients(ours, out, x), gradients(theirs, expected, x), strict=True):
        assert torch.allclose(mine, other)


@pytest.mark.parametrize("kind", ["gcn", "self"])
@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("widths", WIDTHS)
def test_results_may_be_written_to(kind, widths, form, monkeypatch):
    for name, value in FORMS[form].items():
        monkeypatch.setattr(_sparse_gcn, name, value)
    ours, theirs = pair(kind, widths)
    x = samples(4, 11, widths[0], dtype=torch.double).requires_grad_()
    out, expected = ours(x, EDGE_INDEX).relu_(), on_batch(theirs, x, None).relu()
    assert torch.allclose(out, expected)
    for mine, other in zip(gradients(ours, out, x), gradients(theirs, expected, x), strict=True):
        assert torch.allclose(mine, other)


def test_batches_of_many_sizes():
    ours, theirs = pair("gcn", (8, 8))
    for num_samples in [*range(1, 14), 3]:
        x = samples(num_samples, 11, 8, seed=num_samples, dtype=torch.double)
        assert torch.allclose(ours(x, EDGE_INDEX, POSITIVE), on_batch(theirs, x, POSITIVE))


@pytest.mark.parametrize("kind", ["gcn", "self", "segmented"])
@pytest.mark.parametrize("lead", [(1,), (5,), (2, 3)])
def test_strided_features_and_contiguous_results(kind, lead):
    torch.manual_seed(0)
    layer = {
        "gcn": StaticGCNConv(6, 7),
        "self": SelfGCNConv(6, 7),
        "segmented": SegmentedGCNConv(torch.arange(11) // 4, 6, 7),
    }[kind]
    if kind == "segmented" and len(lead) > 1:
        pytest.skip("three dimensions at most")
    x = samples(*lead, 6, 11).transpose(-1, -2)
    out = layer(x, EDGE_INDEX)
    assert out.is_contiguous()
    assert torch.allclose(out, layer(x.contiguous(), EDGE_INDEX), atol=1e-6)
    one_by_one = torch.stack([layer(row, EDGE_INDEX) for row in x.reshape(-1, 11, 6)])
    assert torch.allclose(out.flatten(0, -3), one_by_one, atol=1e-6)


# In order or not, of equal sizes, similar ones and very different ones.
SEGMENTS = {
    "equal": [0] * 11,
    "alike": [0, 0, 0, 0, 1, 1, 1, 1, 2, 2, 2],
    "mixed": [2, 0, 1, 0, 2, 1, 0, 2, 1, 0, 2],
    "swapped": [1, 0, 3, 2, 5, 4, 7, 6, 9, 8, 10],
    "single": [0, 0, 0, 0, 0, 0, 1, 2, 3, 4, 5],
}


@pytest.mark.parametrize("num_samples", [1, 9])
@pytest.mark.parametrize("segment", SEGMENTS)
@pytest.mark.parametrize("bias", [True, False])
def test_segments_have_the_gradients_of_messages(num_samples, segment, bias):
    fast = SegmentedGCNConv(SEGMENTS[segment], 6, 7, bias).double()
    slow = SegmentedGCNConv(SEGMENTS[segment], 6, 7, bias, fast=False).double()
    if bias:
        torch.nn.init.normal_(fast.bias)
    slow.load_state_dict(fast.state_dict())
    x = samples(num_samples, 11, 6, dtype=torch.double).requires_grad_()
    found = gradients(fast, fast(x, EDGE_INDEX, POSITIVE), x)
    expected = gradients(slow, slow(x, EDGE_INDEX, POSITIVE), x)
    for mine, other in zip(found, expected, strict=True):
        assert torch.allclose(mine, other)


@pytest.mark.parametrize("segment", SEGMENTS)
def test_missing_readings_of_a_segment_leave_the_weights_of_others(segment):
    conv = SegmentedGCNConv(SEGMENTS[segment], 6, 7)
    x = samples(9, 11, 6)
    x[0, 0] = torch.nan  # often the taxel that fills up its segment
    conv(x, EDGE_INDEX).sum().backward()
    is_lost = ~conv.weight.grad.isfinite().all(dim=(1, 2))
    assert is_lost.nonzero().flatten().tolist() == [SEGMENTS[segment][0]]


@pytest.mark.parametrize("kind", ["gcn", "self"])
def test_frozen_layers_and_inputs(kind):
    ours, theirs = pair(kind, (8, 8))
    x = samples(4, 11, 8, dtype=torch.double)
    for frozen in ([], ["bias"], ["weight"], ["bias", "weight"]):
        for layer in (ours, theirs):
            for name, parameter in layer.named_parameters():
                parameter.requires_grad_(not any(name.endswith(end) for end in frozen))
        inputs = x.clone().requires_grad_()
        outs = ours(inputs, EDGE_INDEX), theirs(inputs, EDGE_INDEX)
        grads = [
            torch.autograd.grad(
                out.cos().sum(),
                [inputs, *(p for _, p in sorted(layer.named_parameters()) if p.requires_grad)],
            )
            for out, layer in zip(outs, (ours, theirs), strict=True)
        ]
        for mine, other in zip(*grads, strict=True):
            assert torch.allclose(mine, other)
    with torch.no_grad():
        assert torch.allclose(ours(x, EDGE_INDEX), theirs(x, EDGE_INDEX))


@pytest.mark.parametrize("kind", ["gcn", "self", "segmented"])
def test_no_warning_of_sparse_tensors(kind):
    layer = {
        "gcn": StaticGCNConv(6, 7),
        "self": SelfGCNConv(6, 7),
        "segmented": SegmentedGCNConv(torch.arange(11) // 4, 6, 7),
    }[kind]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        layer(samples(9, 11, 6), EDGE_INDEX).sum().backward()


@pytest.mark.parametrize("kind", ["gcn", "self"])
def test_autocast_gives_the_numbers_of_pyg(kind):
    ours, theirs = pair(kind, (8, 8), torch.float)
    x = samples(9, 11, 8)
    with torch.autocast("cpu", torch.bfloat16):
        found, expected = ours(x, EDGE_INDEX), theirs(x, EDGE_INDEX)
    assert found.dtype == expected.dtype
    assert torch.allclose(found.float(), expected.float(), atol=0.05)
