"""PyG's star of four nodes, and a layer of PyG and ours with the same weights."""

import torch
from torch_geometric.nn import GCNConv

from torch_geometric_tactile.nn.conv import StaticGCNConv

STAR = torch.tensor([[0, 0, 0, 1, 2, 3], [1, 2, 3, 0, 0, 0]])
VALUE = torch.tensor([0.3, 0.9, 0.1, 0.7, 0.2, 0.6])
LEADS = [(), (3,), (2, 3)]


def pair(*args, **kwargs):
    torch.manual_seed(0)
    theirs = GCNConv(*args, **kwargs)
    ours = StaticGCNConv(*args, **kwargs)
    if theirs.bias is not None:
        torch.nn.init.normal_(theirs.bias)
    ours.load_state_dict(theirs.state_dict())
    return ours, theirs


def close(a, b):
    return torch.allclose(a, b, atol=1e-6)
