import pytest
import torch
from small_models import NUM_EDGES, samples

from torch_geometric_tactile.nn.conv import EdgeFeatureEncoder
from torch_geometric_tactile.sensors import allegro_uskin


def encoder():
    torch.manual_seed(0)
    return EdgeFeatureEncoder(11, NUM_EDGES, edge_dim=4, out_channels=2)


def test_edge_feature_encoder_by_hand():
    # Rows of the weight: features of the taxels, one after the other; columns: of the edges.
    layer = EdgeFeatureEncoder(2, 3, edge_dim=2, out_channels=1)
    with torch.no_grad():
        layer.lin.weight.copy_(torch.tensor([[1.0, 0, 0, 10.0, 0, 0], [0, 0, 0, 0, 100.0, 1.0]]))
        layer.lin.bias.copy_(torch.tensor([0.5, -0.5]))
    edge_attr = torch.tensor([[1.0, 2.0], [3.0, 4.0], [5.0, 6.0]])
    expected = torch.tensor([[1.0 + 40.0 + 0.5], [500.0 + 6.0 - 0.5]])
    assert torch.equal(layer(edge_attr), expected)
    assert torch.equal(layer(torch.stack([edge_attr, 0 * edge_attr]))[0], expected)
    assert torch.equal(layer(edge_attr.repeat(2, 1)), expected.repeat(2, 1))


@pytest.mark.parametrize("name", ["sparse", "slanted", "original", "dense"])
def test_edge_feature_encoder_size(name):
    num_edges = allegro_uskin().edge_index(name).size(1)
    assert num_edges == {"sparse": 1000, "slanted": 1184, "original": 1401, "dense": 2488}[name]
    with torch.device("meta"):
        layer = EdgeFeatureEncoder(384, num_edges)
    assert layer.lin.weight.shape == (1536, 4 * num_edges)
    total = sum(parameter.numel() for parameter in layer.parameters())
    assert total == 1536 * 4 * num_edges + 1536
    if name == "original":
        assert total == 8_609_280


def test_edge_feature_encoder_sees_every_edge():
    edge_attr = samples(NUM_EDGES, 4).requires_grad_()
    encoder()(edge_attr).square().sum().backward()
    assert (edge_attr.grad != 0).all()


def test_edge_feature_encoder_empty_and_single():
    assert encoder()(samples(0, 4)).shape == (0, 2)
    assert EdgeFeatureEncoder(1, 1, 1, 1)(samples(3, 1, 1)).shape == (3, 1, 1)


@pytest.mark.parametrize("size", [(25, 4), (2, 25, 4), (2, 2 * NUM_EDGES, 4), (NUM_EDGES,)])
def test_edge_feature_encoder_bad_edges(size):
    with pytest.raises(ValueError, match=rf"'edge_attr' must have {NUM_EDGES} rows, .*got shape"):
        encoder()(torch.zeros(size))


@pytest.mark.parametrize("size", [(NUM_EDGES, 3), (2, NUM_EDGES, 5)])
def test_edge_feature_encoder_bad_features(size):
    with pytest.raises(ValueError, match=rf"must have 4 features \(got {size[-1]}\)"):
        encoder()(torch.zeros(size))
