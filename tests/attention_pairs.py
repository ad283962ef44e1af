"""PyG's attention layers and ours with the same weights."""

import torch
from small_models import samples
from torch_geometric.data import Batch, Data
from torch_geometric.nn import GATConv, GATv2Conv

from torch_geometric_tactile.nn.conv import StaticGATConv, StaticGATv2Conv

LAYERS = {"gat": (StaticGATConv, GATConv), "gatv2": (StaticGATv2Conv, GATv2Conv)}
# Self-loops, edges that are there twice, a node without an edge, and nodes with many neighbours.
EDGES = {
    "both_ways": torch.tensor([[0, 1, 1, 2, 2, 3, 3, 4], [1, 0, 2, 1, 3, 2, 4, 3]]),
    "one_way": torch.tensor([[0, 1, 3, 4], [1, 2, 2, 2]]),
    "self_loops": torch.tensor([[0, 1, 2, 2, 4], [0, 2, 2, 3, 4]]),
    "twice": torch.tensor([[0, 0, 1, 1], [1, 1, 0, 1]]),
    "star": torch.tensor([[0, 1, 2, 3, 4, 4], [4, 4, 4, 4, 0, 3]]),
    "none": torch.empty(2, 0, dtype=torch.long),
}


def pair(kind, *args, dtype=torch.double, **kwargs):
    """Our layer and PyG's, in double precision."""
    torch.manual_seed(0)
    ours, theirs = (layer(*args, **kwargs).to(dtype) for layer in LAYERS[kind])
    for name, value in theirs.named_parameters():
        if "bias" in name:
            torch.nn.init.normal_(value)
    ours.load_state_dict(theirs.state_dict())
    return ours, theirs


def on_batch(layer, x, edge_index, edge_attr=None):
    """The output of a layer on PyG's batch of the samples, with their shape."""
    parts = [Data(x=row, edge_index=edge_index, edge_attr=edge_attr) for row in x]
    batch = Batch.from_data_list(parts)
    out = layer(batch.x, batch.edge_index, batch.edge_attr)
    return out.view(*x.shape[:-1], -1)


def gradients(layer, x, compute):
    """The gradients of the input and of all weights."""
    x = x.clone().requires_grad_()
    out = compute(layer, x)
    scale = samples(*out.shape, dtype=out.dtype, seed=9)
    inputs = [x, *layer.parameters()]
    return torch.autograd.grad((out * scale).sum(), inputs, allow_unused=True)


def assert_same(found, expected, atol=1e-10):
    assert found.shape == expected.shape
    assert found.isnan().equal(expected.isnan())
    assert torch.allclose(found, expected, rtol=1e-8, atol=atol, equal_nan=True)
