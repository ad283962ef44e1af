import copy

import pytest
import torch
from small_models import EDGE_INDEX, NUM_EDGES, PATCH, samples
from torch_geometric.nn import GCNConv
from torch_geometric.utils import subgraph

from torch_geometric_tactile.nn.conv import SegmentedGCNConv, segmented_gcn_conv
from torch_geometric_tactile.nn.conv import _static_adjacency as static_adjacency
from torch_geometric_tactile.nn.models import SegmentedThread
from torch_geometric_tactile.sensors import allegro_uskin

WEIGHT = samples(NUM_EDGES, seed=3).exp()
WITHIN = PATCH[EDGE_INDEX[0]] == PATCH[EDGE_INDEX[1]]


def conv(segment=PATCH, in_channels=3, out_channels=4, **kwargs):
    torch.manual_seed(0)
    layer = SegmentedGCNConv(segment, in_channels, out_channels, **kwargs)
    if layer.bias is not None:
        torch.nn.init.normal_(layer.bias)
    return layer


def thread(segment=PATCH, fast=True, dtype=torch.float):
    torch.manual_seed(0)
    layer = SegmentedThread(3, segment, (4, 8), (1, 4), fast=fast)
    for one in layer.convs:
        torch.nn.init.normal_(one.bias)
    return layer.to(dtype)


def one_by_one(layer, x, edge_index, edge_weight=None):
    """PyG's layer for each segment, on its induced subgraph."""
    out = x.new_empty(*x.shape[:-1], layer.out_channels)
    for s in range(layer.num_segments):
        theirs = GCNConv(layer.in_channels, layer.out_channels).to(x.dtype)
        theirs.load_state_dict({"lin.weight": layer.weight[s], "bias": layer.bias[s]})
        nodes = (layer.segment == s).nonzero().view(-1)
        edges, weight = subgraph(
            nodes, edge_index, edge_weight, relabel_nodes=True, num_nodes=x.size(-2)
        )
        out[..., nodes, :] = theirs(x[..., nodes, :], edges, weight)
    return out


def test_segmented_gcn_conv_by_hand():
    # Taxels 0 and 1 share their mean 3; taxel 2 is alone, whatever joins it.
    layer = SegmentedGCNConv([0, 0, 1], 1, 1)
    with torch.no_grad():
        layer.weight.copy_(torch.tensor([[[1.0]], [[10.0]]]))
        layer.bias.copy_(torch.tensor([[0.5], [-0.5]]))
    x, edge_index = torch.tensor([[2.0], [4.0], [7.0]]), torch.tensor([[0, 1, 1], [1, 0, 2]])
    expected = torch.tensor([[3.5], [3.5], [69.5]])
    assert torch.allclose(layer(x, edge_index), expected)
    assert torch.allclose(layer(x[None], edge_index), expected[None])


def test_segmented_thread_by_hand():
    layer = SegmentedThread(1, [0, 0, 1], (2,), (2,))
    with torch.no_grad():
        layer.convs[0].weight.copy_(torch.tensor([[[1.0], [-1.0]], [[-10.0], [-20.0]]]))
        layer.convs[0].bias.copy_(torch.tensor([[0.0, 0.0], [0.0, 100.0]]))
    x, edge_index = torch.tensor([[2.0], [4.0], [-7.0]]), torch.tensor([[0, 1, 1], [1, 0, 2]])
    expected = torch.tensor([[3.0], [3.0], [240.0]])  # the larger of 70 and 240
    for form in (x, x[None], x.expand(9, 3, 1)):
        assert torch.allclose(layer(form, edge_index), expected)


@pytest.mark.parametrize("weight", [None, WEIGHT])
def test_segmented_gcn_conv_equals_one_conv_each(weight):
    layer, x = conv(), samples(5, 11, 3)
    expected = one_by_one(layer, x, EDGE_INDEX, weight)
    assert torch.allclose(layer(x, EDGE_INDEX, weight), expected, atol=1e-6)


@pytest.mark.parametrize(
    ("weight", "learns"), [(None, False), (WEIGHT.double(), False), (WEIGHT.double(), True)]
)
@pytest.mark.parametrize("segment", [PATCH, [0] * 10 + [1]])
def test_segmented_dense_form_of_gpus_equals_messages(monkeypatch, segment, weight, learns):
    monkeypatch.setattr(segmented_gcn_conv, "may_multiply", lambda x: False)
    monkeypatch.setattr(segmented_gcn_conv, "may_multiply_dense", lambda x: True)
    layer = conv(segment).double()
    messages = copy.deepcopy(layer)
    messages.fast = False
    monkeypatch.setattr(layer, "propagate", None)  # no message is passed
    x = samples(3, 11, 3).double()
    results = []
    for each in (layer, messages):
        leaf = None if weight is None else weight.clone().requires_grad_(learns)
        taxels = x.clone().requires_grad_()
        out = each(taxels, EDGE_INDEX, leaf)
        out.square().sum().backward()
        leaves = [taxels, *each.parameters(), *([leaf] if learns else [])]
        results.append([out, *(value.grad for value in leaves)])
    for ours, theirs in zip(*results, strict=True):
        torch.testing.assert_close(ours, theirs)


@pytest.mark.parametrize("flow", ["source_to_target", "target_to_source"])
@pytest.mark.parametrize("weight", [None, WEIGHT])
def test_segmented_messages_of_gpus_normalize_edges_once(monkeypatch, weight, flow):
    # As more than 1,024 taxels on a GPU, where each normalisation waits.
    monkeypatch.setattr(segmented_gcn_conv, "may_multiply", lambda x: False)
    monkeypatch.setattr(segmented_gcn_conv, "may_cache_edges", lambda x: True)
    layer, x = conv(flow=flow), samples(2, 11, 3)
    expected = conv(flow=flow, fast=False)(x, EDGE_INDEX, weight)
    torch.testing.assert_close(layer(x, EDGE_INDEX, weight), expected)
    monkeypatch.setattr(segmented_gcn_conv, "gcn_norm", None)
    monkeypatch.setattr(static_adjacency, "gcn_norm", None)
    torch.testing.assert_close(layer(x, EDGE_INDEX, weight), expected)


def test_segmented_dense_form_keeps_missing_readings_in_their_segment(monkeypatch):
    monkeypatch.setattr(segmented_gcn_conv, "may_multiply", lambda x: False)
    monkeypatch.setattr(segmented_gcn_conv, "may_multiply_dense", lambda x: True)
    layer, x = conv(), samples(2, 11, 3)
    x[0, 0, 0] = torch.nan
    out = layer(x, EDGE_INDEX)
    layer.fast = False
    is_lost = layer(x, EDGE_INDEX).isnan().any(dim=-1)
    assert is_lost.any()
    assert torch.equal(out.isnan().any(dim=-1), is_lost)


@pytest.mark.parametrize("fast", [True, False])
@pytest.mark.parametrize("weight", [None, WEIGHT])
def test_segmented_thread_equals_one_conv_each(weight, fast):
    layer, x = thread(fast=fast), samples(9, 11, 3)
    expected = x
    for one, pool in zip(layer.convs, layer.pools, strict=True):
        expected = pool(one_by_one(one, expected, EDGE_INDEX, weight)).relu()
    for given, wanted in ((x, expected), (x[:2], expected[:2]), (x[3], expected[3])):
        assert torch.allclose(layer(given, EDGE_INDEX, weight), wanted, atol=1e-5)


@pytest.mark.parametrize("by", ["digit", "patch"])
@pytest.mark.parametrize("shuffled", [False, True])
def test_segmented_thread_of_the_hand(by, shuffled):
    layout = allegro_uskin()
    segment, edge_index = layout.segments(by), layout.edge_index("dense")
    if shuffled:
        order = torch.randperm(384, generator=torch.Generator().manual_seed(0))
        segment, edge_index = segment[order], order.argsort()[edge_index]
    layer, x = thread(segment), samples(8, 384, 3)
    groups = [tuple(getattr(layer, f"nodes_{i}").shape) for i in range(layer.num_groups)]
    assert (
        groups
        == {
            "patch": [(18, 16), (4, 24)],
            "digit": [(1, 56), (3, 72), (1, 112)],
        }[by]
    )
    expected = x
    for one, pool in zip(layer.convs, layer.pools, strict=True):
        expected = pool(one_by_one(one, expected, edge_index)).relu()
    assert torch.allclose(layer(x, edge_index), expected, atol=1e-5)
    assert torch.allclose(layer(x[:2], edge_index), expected[:2], atol=1e-5)


@pytest.mark.parametrize("layer", [conv(), thread(), thread(fast=False)])
def test_segmented_ignores_edges_between(layer):
    x = samples(9, 11, 3)
    out = layer(x, EDGE_INDEX)
    assert not WITHIN.all()
    assert torch.allclose(layer(x, EDGE_INDEX[:, WITHIN]), out, atol=1e-6)
    more = torch.cat([EDGE_INDEX, torch.tensor([[0], [1]])], dim=1)
    assert torch.allclose(layer(x, more), out, atol=1e-6)
    assert not torch.allclose(layer(x, EDGE_INDEX[:, 1:]), out, atol=1e-3)
    changed = x.clone()
    changed[:, PATCH == 1] += 1
    other = layer(changed, EDGE_INDEX)
    assert torch.equal(other[:, PATCH != 1], out[:, PATCH != 1])


@pytest.mark.parametrize("make", [conv, thread])
def test_segments_are_renumbered_with_the_taxels(make):
    x, order = samples(9, 11, 3), torch.randperm(11, generator=torch.Generator().manual_seed(0))
    out = make(PATCH[order])(x[:, order], order.argsort()[EDGE_INDEX])
    assert torch.allclose(out, make()(x, EDGE_INDEX)[:, order], atol=1e-6)


def test_edges_between_segments_learn_no_weight():
    layer, weight = thread(dtype=torch.double), WEIGHT.double().requires_grad_()
    layer(samples(9, 11, 3, dtype=torch.double), EDGE_INDEX, weight).sum().backward()
    assert (weight.grad[WITHIN] != 0).all()
    assert (weight.grad[~WITHIN] == 0).all()


def test_segmented_gcn_conv_without_bias():
    layer = conv(bias=False)
    assert layer.bias is None
    assert layer(torch.zeros(2, 11, 3), EDGE_INDEX).abs().max() == 0


def test_segmented_single_taxel():
    none = torch.empty(2, 0, dtype=torch.long)
    layer, x = conv([0]), samples(2, 1, 3)
    assert torch.allclose(layer(x, none), x @ layer.weight[0].t() + layer.bias[0], atol=1e-6)
    assert thread([0])(samples(9, 1, 3), none).shape == (9, 1, 2)


@pytest.mark.parametrize(
    ("segment", "match"),
    [
        ([0, 2], r"'segment' must be numbered from 0 without gaps \(got \[0, 2\]\)"),
        ([1, 2], r"'segment' must be numbered from 0 without gaps \(got \[1, 2\]\)"),
        ([], r"'segment' must be a whole number for each taxel"),
        ([[0, 1]], r"'segment' must be a whole number for each taxel \(got shape \(1, 2\)"),
        ([0.0, 1.0], r"'segment' must be a whole number for each taxel .*float32"),
    ],
)
def test_segmented_bad_segment(segment, match):
    for layer in (lambda: SegmentedGCNConv(segment, 3, 4), lambda: SegmentedThread(3, segment)):
        with pytest.raises(ValueError, match=match):
            layer()


@pytest.mark.parametrize("size", [(3,), (12, 3), (2, 22, 3), (2, 10, 3), (1, 2, 11, 3)])
def test_segmented_bad_taxels(size):
    for layer in (conv(), thread()):
        with pytest.raises(ValueError, match=r"'x' must have 11 taxels, like 'segment', and 3 f"):
            layer(torch.zeros(size), EDGE_INDEX)


def test_segmented_gcn_conv_misplaced_arguments():
    match = r"'segment' must be a whole number for each taxel \(got shape \(\)"
    with pytest.raises(ValueError, match=match):
        SegmentedGCNConv(34, 8, torch.tensor([0, 0, 1]))
    with pytest.raises(ValueError, match=r"'out_channels' must be at least 1 \(got \[4\]\)"):
        SegmentedGCNConv([0, 0, 1], 8, [4])
