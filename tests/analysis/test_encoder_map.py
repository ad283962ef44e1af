import math

import pytest
import torch
from torch.nn import Linear, Module

from torch_geometric_tactile.analysis import (
    edge_separation,
    encoder_map,
    untrained_separation,
)
from torch_geometric_tactile.analysis.encoder_map import encoder_blocks

# 0 - 1 within a patch, 1 - 2 between patches.
EDGES = torch.tensor([[0, 1, 1], [1, 0, 2]])
SEGMENT = torch.tensor([0, 0, 1])


class Encoder(Module):
    def __init__(self, num_nodes=3, num_edges=3):
        super().__init__()
        self.lin = Linear(num_edges * 4, num_nodes * 4)

    def reset_parameters(self):
        self.lin.reset_parameters()


def weight_of_blocks(blocks):
    """A weight with these mean absolute values (E, N), and signs that must not matter."""
    block = torch.ones(4, 4)
    block[::2] = -1
    return torch.kron(blocks.t().contiguous(), block)


def test_blocks_are_means_of_absolute_values():
    weight = torch.zeros(8, 12)  # two nodes, three edges
    weight[4:, 8:] = torch.arange(-8.0, 8.0).view(4, 4)  # mean absolute value 64 / 16
    expected = torch.zeros(3, 2).double()
    expected[2, 1] = 4
    assert encoder_blocks(weight, 2, 3).equal(expected)


def test_map_by_hand():
    # Mean over edges (1, 2): the centred rows (-1, -2), (0, 0) and (1, 2) lie on one line, on which
    # they are -sqrt(5), 0 and sqrt(5).
    blocks = torch.tensor([[0.0, 0.0], [1.0, 2.0], [2.0, 4.0]])
    found = encoder_map(weight_of_blocks(blocks), num_nodes=2, num_edges=3)
    assert found.tolist() == pytest.approx([-math.sqrt(5), 0, math.sqrt(5)], abs=1e-6)


def test_larger_means_larger_weights():
    blocks = torch.tensor([[5.0, 1.0], [0.0, 1.5], [1.0, 1.4], [4.0, 1.1]])
    found = encoder_map(weight_of_blocks(blocks), 2, 4)
    assert found.argsort().tolist() == [1, 2, 3, 0]


def test_larger_means_larger_weights_even_where_one_node_says_otherwise():
    # Most variance is in node 0, but the mean over the nodes rises.
    step = torch.arange(4.0).view(-1, 1)
    found = encoder_map(weight_of_blocks(torch.cat([9 - 3 * step, step.expand(4, 4)], dim=1)), 5, 4)
    assert found.argsort().tolist() == [0, 1, 2, 3]


def test_map_of_an_encoder_is_that_of_its_weight():
    encoder = Encoder()
    assert encoder_map(encoder).equal(encoder_map(encoder.lin.weight, 3, 3))


def test_map_of_equal_blocks_is_zero():
    assert encoder_map(torch.ones(4, 12)).equal(torch.zeros(3))


def test_map_rejects_bad_weights():
    with pytest.raises(ValueError, match=r"must have shape \(8, 12\) \(got \(8, 16\)\)"):
        encoder_map(torch.zeros(8, 16), 2, 3)
    with pytest.raises(ValueError, match=r"must have shape \(num_nodes \* 4, num_edges \* 4\)"):
        encoder_map(torch.zeros(8, 10))
    with pytest.raises(ValueError, match=r"at least two edges \(got 1\)"):
        encoder_map(torch.zeros(8, 4))
    with pytest.raises(ValueError, match="finite numbers only"):
        encoder_map(torch.full((4, 8), float("nan")))
    with pytest.raises(ValueError, match=r"'lin.weight' \(got ReLU\)"):
        encoder_map(torch.nn.ReLU())
    with pytest.raises(ValueError, match=r"'edge_dim' must be at least 1 \(got 0\)"):
        encoder_map(torch.zeros(8, 4), edge_dim=0)


@pytest.mark.parametrize(("last", "auc"), [(0.9, 1.0), (0.15, 0.5), (0.2, 0.75), (0.0, 0.0)])
def test_separation_by_hand(last, auc):
    found = edge_separation(torch.tensor([0.1, 0.2, last]), EDGES, SEGMENT)
    assert found.auc == pytest.approx(auc)
    assert (found.num_between, found.num_within) == (1, 2)
    assert found.between_mean == pytest.approx(last)
    assert found.within_mean == pytest.approx(0.15)


def test_separation_rejects_bad_input():
    value = torch.zeros(3)
    with pytest.raises(ValueError, match=r"'value' must have shape \(3,\).*got \(2,\)"):
        edge_separation(value[:2], EDGES, SEGMENT)
    with pytest.raises(ValueError, match=r"'edge_index' must have shape \(2, num_edges\)"):
        edge_separation(value, EDGES.t(), SEGMENT)
    with pytest.raises(ValueError, match=r"one for each node of 'edge_index' \(got \(2,\)\)"):
        edge_separation(value, EDGES, SEGMENT[:2])
    with pytest.raises(
        ValueError, match=r"within segments and edges between segments \(got 0 of 3 between\)"
    ):
        edge_separation(value, EDGES, torch.zeros(3))
    with pytest.raises(ValueError, match="finite numbers only"):
        edge_separation(value / 0, EDGES, SEGMENT)


def test_untrained_separation_is_reproducible_and_leaves_all_as_it_was():
    encoder = Encoder()
    before, state = encoder.lin.weight.clone(), torch.random.get_rng_state()
    first = untrained_separation(encoder, EDGES, SEGMENT, num_seeds=8)
    assert first.equal(untrained_separation(encoder, EDGES, SEGMENT, num_seeds=8))
    assert len(first.unique()) > 1
    assert encoder.lin.weight.equal(before)
    assert torch.random.get_rng_state().equal(state)
    with pytest.raises(ValueError, match=r"'num_seeds' must be at least 1 \(got 0\)"):
        untrained_separation(encoder, EDGES, SEGMENT, num_seeds=0)


def test_untrained_encoder_separates_nothing_on_average():
    source = torch.arange(39)
    chain = torch.stack([source, source + 1])
    segment = torch.arange(40) // 4
    aucs = untrained_separation(Encoder(40, 39), chain, segment, num_seeds=20)
    assert float(aucs.mean()) == pytest.approx(0.5, abs=0.08)
