"""Models of a user, which a comparison finds by their import paths."""

import torch
from sklearn.neighbors import KNeighborsClassifier
from torch_geometric.nn import GATv2Conv, GraphConv, global_mean_pool

from torch_geometric_tactile.sensors import as_layout


class OneLayer(torch.nn.Module):
    """A network."""

    def __init__(self, out_channels, num_taxels, in_channels=1):
        super().__init__()
        self.lin = torch.nn.Linear(num_taxels * in_channels, out_channels)

    def forward(self, x, edge_index):
        return self.lin(x.flatten(-2))


class OfEdges(OneLayer):
    """A network that reads edges."""

    needs_edges = True


def neighbours():
    """An estimator."""
    return KNeighborsClassifier(3)


class Ring(torch.nn.Module):
    """A network of one layout with a layer of PyG, which says nothing of edges."""

    def __init__(self, layout, out_channels, in_channels=1):
        super().__init__()
        self.num_taxels = as_layout(layout).num_taxels
        self.conv = GraphConv(in_channels, 4)
        self.lin = torch.nn.Linear(4 * self.num_taxels, out_channels)

    def forward(self, x, edge_index):
        h = self.conv(x, edge_index).relu()
        return self.lin(h.reshape(-1, 4 * self.num_taxels))


class Deep(Ring):
    """One with an argument that nobody knows."""

    def __init__(self, layout, out_channels, depth):
        super().__init__(layout, out_channels)


class Attention(torch.nn.Module):
    """A network as in PyG's tutorials."""

    def __init__(self, in_channels, out_channels):
        super().__init__()
        self.conv1 = GATv2Conv(in_channels, 8, heads=2)
        self.conv2 = GATv2Conv(16, 8, heads=2)
        self.lin = torch.nn.Linear(16, out_channels)

    def forward(self, x, edge_index, batch):
        x = self.conv1(x, edge_index).relu()
        x = self.conv2(x, edge_index).relu()
        return self.lin(global_mean_pool(x, batch))
