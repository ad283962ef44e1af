"""PyG's convolutions on a static batch: by 'to_batch' they give what PyG's own loader gives, and
docs/static_data.md says which of them work on (B, N, F) as it is."""

import re
from pathlib import Path

import pytest
import torch
from torch.nn import Linear, ReLU, Sequential
from torch_geometric import nn
from torch_geometric.loader import DataLoader

from torch_geometric_tactile.data import StaticData, StaticDataset
from torch_geometric_tactile.loader import StaticLoader
from torch_geometric_tactile.sensors import grid

PAGE = Path(__file__).parents[2] / "docs" / "static_data.md"
F, D = 4, 3


def mlp(num_in, num_out=F):
    return Sequential(Linear(num_in, 8), ReLU(), Linear(8, num_out))


def plain(layer, data):
    return layer(data.x, data.edge_index)


def weighted(layer, data):
    return layer(data.x, data.edge_index, data.edge_weight)


def attributed(layer, data):
    return layer(data.x, data.edge_index, edge_attr=data.edge_attr)


def placed(layer, data):
    return layer(data.x, data.pos, data.edge_index)


def rooted(layer, data):
    return layer(data.x, data.x, data.edge_index)


def gps(layer, data):
    # Attention within each sample: in a joined batch 'batch' tells them apart.
    batch = data.batch if hasattr(data, "batch") else None
    return layer(data.x, data.edge_index, batch)


def posed(layer, data):
    return layer(data.x, data.pos, data.normal, data.edge_index)


DEGREES = torch.tensor([0, 0, 4, 2])
CONVOLUTIONS = {
    "APPNP": (lambda: nn.APPNP(K=2, alpha=0.1), weighted),
    "ARMAConv": (lambda: nn.ARMAConv(F, F, num_stacks=2), weighted),
    "CGConv": (lambda: nn.CGConv(F, dim=D), attributed),
    "ChebConv": (lambda: nn.ChebConv(F, F, K=3), weighted),
    "ClusterGCNConv": (lambda: nn.ClusterGCNConv(F, F), plain),
    "EdgeConv": (lambda: nn.EdgeConv(mlp(2 * F)), plain),
    "EGConv": (lambda: nn.EGConv(F, F, num_heads=2), plain),
    "FAConv": (lambda: nn.FAConv(F), rooted),
    "FeaStConv": (lambda: nn.FeaStConv(F, F, heads=2), plain),
    "FiLMConv": (lambda: nn.FiLMConv(F, F), plain),
    "GATConv": (lambda: nn.GATConv(F, F, heads=2, edge_dim=D), attributed),
    "GATv2Conv": (lambda: nn.GATv2Conv(F, F, heads=2, edge_dim=D), attributed),
    "GatedGraphConv": (lambda: nn.GatedGraphConv(F, num_layers=2), weighted),
    "GCN2Conv": (lambda: nn.GCN2Conv(F, alpha=0.1), rooted),
    "GCNConv": (lambda: nn.GCNConv(F, F), weighted),
    "GENConv": (lambda: nn.GENConv(F, F, edge_dim=D), attributed),
    "GeneralConv": (lambda: nn.GeneralConv(F, F, in_edge_channels=D), attributed),
    "GINConv": (lambda: nn.GINConv(mlp(F)), plain),
    "GINEConv": (lambda: nn.GINEConv(mlp(F), edge_dim=D), attributed),
    "GMMConv": (lambda: nn.GMMConv(F, F, dim=D, kernel_size=2), attributed),
    "GPSConv": (lambda: nn.GPSConv(F, nn.GINConv(mlp(F)), heads=2, norm="layer_norm"), gps),
    "GraphConv": (lambda: nn.GraphConv(F, F), weighted),
    "LEConv": (lambda: nn.LEConv(F, F), weighted),
    "MFConv": (lambda: nn.MFConv(F, F), plain),
    "MixHopConv": (lambda: nn.MixHopConv(F, F), weighted),
    "NNConv": (lambda: nn.NNConv(F, F, mlp(D, F * F)), attributed),
    "PDNConv": (lambda: nn.PDNConv(F, F, edge_dim=D, hidden_channels=5), attributed),
    "PNAConv": (
        lambda: nn.PNAConv(
            F, F, ["mean", "max", "std"], ["identity", "amplification"], DEGREES, edge_dim=D
        ),
        attributed,
    ),
    "PointNetConv": (lambda: nn.PointNetConv(mlp(F + 3)), placed),
    "PointTransformerConv": (lambda: nn.PointTransformerConv(F, F), placed),
    "PPFConv": (lambda: nn.PPFConv(mlp(F + 4)), posed),
    "ResGatedGraphConv": (lambda: nn.ResGatedGraphConv(F, F, edge_dim=D), attributed),
    "SAGEConv": (lambda: nn.SAGEConv(F, F, aggr="max"), plain),
    "SGConv": (lambda: nn.SGConv(F, F, K=2), weighted),
    "SSGConv": (lambda: nn.SSGConv(F, F, alpha=0.1, K=2), weighted),
    "SuperGATConv": (lambda: nn.SuperGATConv(F, F, heads=2), plain),
    "TAGConv": (lambda: nn.TAGConv(F, F), weighted),
    "TransformerConv": (lambda: nn.TransformerConv(F, F, heads=2, edge_dim=D), attributed),
    "WLConvContinuous": (lambda: nn.WLConvContinuous(), weighted),
}


class Patches(StaticDataset):
    layout = grid(2, 3, pitch=0.01)

    def read(self):
        data = samples(7)
        return data, {}


def samples(num_samples):
    """Samples with one set of edge features for all, as GATv2 and others take them."""
    draw = torch.Generator().manual_seed(0)
    layout = Patches.layout
    edge_index = layout.edge_index("original")
    num_edges = edge_index.size(1)
    return StaticData(
        x=torch.randn(num_samples, layout.num_taxels, F, generator=draw),
        edge_index=edge_index,
        edge_attr=torch.rand(num_edges, D, generator=draw),
        edge_weight=torch.rand(num_edges, generator=draw),
        pos=layout.pos,
        normal=torch.nn.functional.normalize(torch.randn(6, 3, generator=draw)),
    )


def layer_of(name):
    build, call = CONVOLUTIONS[name]
    torch.manual_seed(0)
    layer = build().eval()
    return lambda data: call(layer, data)


@pytest.mark.parametrize("name", CONVOLUTIONS)
def test_convolution_of_a_static_batch_is_that_of_pygs_loader(name):
    dataset, layer = Patches(), layer_of(name)
    with torch.no_grad():
        for static, pyg in zip(
            StaticLoader(dataset, batch_size=4), DataLoader(dataset, batch_size=4), strict=True
        ):
            found, expected = layer(static.to_batch()), layer(pyg)
            assert found.size(0) == static.num_samples * 6
            torch.testing.assert_close(found, expected, rtol=0, atol=1e-6)
            assert found.std() > 1e-4  # a layer of zeros would prove nothing


@pytest.mark.parametrize("name", ["GATv2Conv", "GINEConv", "TransformerConv", "PNAConv", "NNConv"])
def test_convolution_with_edge_features_of_each_sample(name):
    data = samples(3)
    data.edge_attr = torch.rand(3, data.num_edges, D)
    layer = layer_of(name)
    with torch.no_grad():
        found = layer(data.to_batch())
        expected = torch.cat([layer(sample) for sample in data.to_data_list()])
    torch.testing.assert_close(found, expected, rtol=0, atol=1e-5)


def verdict(name):
    """What a convolution does with (B, N, F), for fewer, as many and more samples than taxels."""
    layer, found = layer_of(name), set()
    for num_samples in (1, 4, 6, 9, 14):
        data = samples(num_samples)
        with torch.no_grad():
            expected = layer(data.to_batch())
            try:
                out = layer(data)
            except (AssertionError, IndexError, RuntimeError, ValueError):
                found.add("raises")
                continue
        same = out.numel() == expected.numel()
        if same and torch.allclose(out.reshape(expected.shape), expected, atol=1e-5):
            found.add("works")
        else:
            found.add("wrong")
    return next(kind for kind in ("wrong", "raises", "works") if kind in found)


def page_rows():
    text = PAGE.read_text(encoding="utf-8")
    return dict(re.findall(r"^\| `(\w+)` \| (works|raises|wrong) \|$", text, flags=re.MULTILINE))


@pytest.mark.parametrize("name", CONVOLUTIONS)
def test_page_says_what_a_convolution_does_with_stacked_samples(name):
    assert page_rows()[name] == verdict(name)


def test_page_lists_these_convolutions_only():
    assert sorted(page_rows()) == sorted(CONVOLUTIONS)
