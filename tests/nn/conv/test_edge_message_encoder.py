import math

import pytest
import torch
from small_models import EDGE_INDEX, NUM_EDGES, PATCH, samples

from torch_geometric_tactile.nn.conv import (
    EdgeAttentionEncoder,
    EdgeMessageEncoder,
    EdgePatchEncoder,
)

ENCODERS = {
    "mean": lambda: EdgeMessageEncoder(4, 2),
    "max": lambda: EdgeMessageEncoder(4, 2, 8, aggr="max"),
    "attention": lambda: EdgeAttentionEncoder(4, 2),
    "patch": lambda: EdgePatchEncoder(PATCH, 4, 2),
}
# Two edges to taxel 2, and one to taxel 0; taxel 1 has none.
EDGES = torch.tensor([[0, 1, 2], [2, 2, 0]])
EDGE_ATTR = torch.tensor([[1.0], [3.0], [5.0]])


@pytest.fixture(params=ENCODERS)
def encoder(request):
    torch.manual_seed(0)
    return ENCODERS[request.param]()


def times(mlp, factor):
    """Makes a network multiply positive numbers."""
    for parameter in mlp.parameters():
        torch.nn.init.zeros_(parameter)
    mlp[0].weight.data[0, 0] = 1.0
    mlp[2].weight.data[0, 0] = factor


@pytest.mark.parametrize(("aggr", "expected"), [("mean", 20.0), ("add", 40.0), ("max", 30.0)])
def test_edge_message_encoder_by_hand(aggr, expected):
    layer = EdgeMessageEncoder(1, 1, aggr=aggr)
    times(layer.mlp, 10.0)
    assert torch.equal(layer(EDGE_ATTR, EDGES).view(-1), torch.tensor([50.0, 0.0, expected]))


def test_edge_attention_encoder_by_hand():
    # Scores 1 and 3 times ln(3) / 2: weights of one and three quarters.
    layer = EdgeAttentionEncoder(1, 1)
    times(layer.mlp, 1.0)
    torch.nn.init.constant_(layer.att, math.log(3) / 2)
    out = layer(EDGE_ATTR, EDGES).view(-1)
    assert torch.allclose(out, torch.tensor([5.0, 0.0, 0.25 * 1.0 + 0.75 * 3.0]))


def test_edge_patch_encoder_by_hand():
    # Taxels 0 and 2 are of one patch: the edges from 0 to 2 and back are within.
    layer = EdgePatchEncoder([4, 7, 4], 1, 1)
    times(layer.mlp, 1.0)
    times(layer.mlp_between, 10.0)
    out = layer(EDGE_ATTR, EDGES).view(-1)
    assert torch.equal(out, torch.tensor([5.0, 0.0, (1.0 + 30.0) / 2]))


def test_edge_encoder_gradients(encoder):
    encoder.double()
    few = samples(3, 4, dtype=torch.double).requires_grad_()
    edges = torch.tensor([[0, 3, 2], [3, 2, 3]])
    assert torch.autograd.gradcheck(lambda e: encoder(e, edges, 11), few)


def test_edge_patches_are_renumbered_with_the_taxels():
    edge_attr = samples(NUM_EDGES, 4)
    order = torch.randperm(11, generator=torch.Generator().manual_seed(1))
    layer, other = EdgePatchEncoder(PATCH), EdgePatchEncoder(PATCH[order])
    other.load_state_dict(layer.state_dict())
    out = other(edge_attr, order.argsort()[EDGE_INDEX])
    assert torch.allclose(out, layer(edge_attr, EDGE_INDEX)[order], atol=1e-6)


def test_edge_encoder_empty_and_single(encoder):
    none = torch.empty(2, 0, dtype=torch.long)
    assert torch.equal(encoder(samples(3, 0, 4), none, 11), torch.zeros(3, 11, 2))
    one = encoder(samples(1, 4), torch.tensor([[0], [0]]), 11)
    assert one[0].abs().max() > 0
    assert one[1:].abs().max() == 0


def test_edge_encoder_number_of_taxels():
    # The last taxels have no edges.
    assert EdgeMessageEncoder(1, 4)(EDGE_ATTR, EDGES).shape == (3, 4)
    assert EdgeMessageEncoder(1, 4)(EDGE_ATTR, EDGES, 5).shape == (5, 4)
    assert EdgePatchEncoder([0] * 6, 1)(EDGE_ATTR, EDGES).shape == (6, 4)


@pytest.mark.parametrize("size", [(NUM_EDGES - 1, 4), (2, NUM_EDGES + 1, 4), (NUM_EDGES,)])
def test_edge_encoder_bad_edges(encoder, size):
    with pytest.raises(ValueError, match=rf"must have {NUM_EDGES} rows, one for each edge .*got"):
        encoder(torch.zeros(size), EDGE_INDEX)


def test_edge_patch_encoder_bad_segment():
    for segment in ([], [[0, 1]]):
        with pytest.raises(ValueError, match=r"'segment' must have a number for each taxel"):
            EdgePatchEncoder(segment)
    with pytest.raises(ValueError, match=r"multiple of the 11 taxels in 'segment' \(got 12\)"):
        EdgePatchEncoder(PATCH)(torch.zeros(NUM_EDGES, 4), EDGE_INDEX, 12)


def test_edge_encoder_explained():
    # Also if its parent class was used first.
    for layer in (EdgeMessageEncoder(), EdgeAttentionEncoder(), EdgePatchEncoder(PATCH)):
        layer.explain = True
        layer._edge_mask, layer._apply_sigmoid = torch.zeros(NUM_EDGES), False
        assert layer(samples(NUM_EDGES, 4), EDGE_INDEX, 11).abs().max() == 0


def test_sparse_matrix_is_no_edges(encoder):
    with pytest.raises(ValueError, match=r"have shape \(2, num_edges\): a sparse matrix .*_coo"):
        encoder(torch.zeros(2, 4), torch.eye(11).to_sparse(), 11)
