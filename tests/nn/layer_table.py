"""All layers with their arguments, and the inputs of each kind of layer."""

from collections.abc import Callable
from typing import NamedTuple

import torch
from small_models import EDGE_INDEX, LAYOUT, NUM_EDGES, PATCH, samples
from torch import Tensor, nn

from torch_geometric_tactile.nn import (
    BilinearFeature,
    CausalTemporalConv,
    ChannelMaxPool,
    CNNThread,
    EdgeAttentionEncoder,
    EdgeFeatureEncoder,
    EdgeMessageEncoder,
    EdgePatchEncoder,
    GCNThread,
    PooledMLP,
    SectorConv,
    SegmentedGCNConv,
    SegmentedThread,
    SelfGCNConv,
    StaticGATConv,
    StaticGATv2Conv,
    StaticGCNConv,
    TaxelPool,
)

NUM_TAXELS = 11
NO_EDGES = EDGE_INDEX[:, :0]
# The third input of convolutions, by its name.
EDGE_INPUTS = {
    "edge_weight": samples(NUM_EDGES, seed=3).exp(),
    "edge_sector": torch.arange(NUM_EDGES) % 8,
    "edge_attr": samples(NUM_EDGES, 2, seed=4),
}
WIDTHS = {"widths": (4, 8), "pools": (1, 4)}


class Layer(NamedTuple):
    """A layer with an input size, its text and its number of parameters for three channels.

    ``inputs`` are those behind the features: ``()`` for a layer that has no edges, ``("edges",)``
    with or without the name of an edge input for a convolution, and ``("edges", "num_nodes")`` for
    an encoder, whose features are those of the edges.
    """

    make: Callable[..., nn.Module]
    text: str
    num_parameters: int
    inputs: tuple[str, ...] = ()
    size: tuple[int, ...] = (NUM_TAXELS, 3)


CONV, WEIGHTED = ("edges",), ("edges", "edge_weight")
FEATURED, ENCODER = ("edges", "edge_attr"), ("edges", "num_nodes")
EDGES = (NUM_EDGES, 3)
MLP = 3 * 16 + 16 + 16 * 2 + 2

LAYERS = {
    "gcn": Layer(
        lambda size=3, **more: StaticGCNConv(size, 5, **more), "StaticGCNConv(3, 5)", 20, WEIGHTED
    ),
    "gcn_narrow": Layer(
        lambda size=3, **more: StaticGCNConv(size, 2, **more), "StaticGCNConv(3, 2)", 8, CONV
    ),
    "self": Layer(
        lambda size=3, **more: SelfGCNConv(size, 5, **more), "SelfGCNConv(3, 5)", 35, WEIGHTED
    ),
    "difference": Layer(
        lambda size=3, **more: SelfGCNConv(size, 5, difference=True, **more),
        "SelfGCNConv(3, 5, difference=True)",
        35,
        WEIGHTED,
    ),
    "segmented": Layer(
        lambda size=3, **more: SegmentedGCNConv(PATCH, size, 4, **more),
        "SegmentedGCNConv(3, 4, num_segments=3)",
        3 * 16,
        WEIGHTED,
    ),
    "sector": Layer(
        lambda size=3, **more: SectorConv(size, 5, **more),
        "SectorConv(3, 5, num_sectors=8)",
        9 * 15 + 5,
        ("edges", "edge_sector"),
    ),
    "gat": Layer(
        lambda size=3, **more: StaticGATConv(size, 4, heads=2, **more),
        "StaticGATConv(3, 4, heads=2)",
        24 + 2 * 8 + 8,
        CONV,
    ),
    "gat_edges": Layer(
        lambda size=3, **more: StaticGATConv(size, 4, heads=2, edge_dim=2, **more),
        "StaticGATConv(3, 4, heads=2)",
        48 + 16 + 8,
        FEATURED,
    ),
    "gatv2": Layer(
        lambda size=3, **more: StaticGATv2Conv(size, 4, heads=2, **more),
        "StaticGATv2Conv(3, 4, heads=2)",
        2 * 32 + 8 + 8,
        CONV,
    ),
    "gatv2_edges": Layer(
        lambda size=3, **more: StaticGATv2Conv(size, 4, heads=2, edge_dim=2, **more),
        "StaticGATv2Conv(3, 4, heads=2)",
        80 + 16,
        FEATURED,
    ),
    "gcn_thread": Layer(
        lambda **more: GCNThread(3, **WIDTHS, **more),
        "GCNThread(3, widths=(4, 8), pools=(1, 4))",
        16 + 40,
        WEIGHTED,
    ),
    "segmented_thread": Layer(
        lambda **more: SegmentedThread(3, PATCH, **WIDTHS, **more),
        "SegmentedThread(3, widths=(4, 8), pools=(1, 4), num_segments=3)",
        3 * 56,
        WEIGHTED,
    ),
    "message": Layer(
        lambda size=3: EdgeMessageEncoder(size, 2),
        "EdgeMessageEncoder(3, 2, hidden_channels=16)",
        MLP,
        ENCODER,
        EDGES,
    ),
    "message_max": Layer(
        lambda size=3: EdgeMessageEncoder(size, 2, 8, aggr="max"),
        "EdgeMessageEncoder(3, 2, hidden_channels=8)",
        3 * 8 + 8 + 8 * 2 + 2,
        ENCODER,
        EDGES,
    ),
    "edge_attention": Layer(
        lambda size=3: EdgeAttentionEncoder(size, 2),
        "EdgeAttentionEncoder(3, 2, hidden_channels=16)",
        MLP + 2,
        ENCODER,
        EDGES,
    ),
    "edge_patch": Layer(
        lambda size=3: EdgePatchEncoder(PATCH, size, 2),
        "EdgePatchEncoder(3, 2, hidden_channels=16)",
        2 * MLP,
        ENCODER,
        EDGES,
    ),
    "edge_dense": Layer(
        lambda size=3: EdgeFeatureEncoder(NUM_TAXELS, NUM_EDGES, size, 2),
        f"EdgeFeatureEncoder(11, {NUM_EDGES}, edge_dim=3, out_channels=2)",
        22 * (3 * NUM_EDGES + 1),
        ENCODER,
        EDGES,
    ),
    "temporal": Layer(
        lambda: CausalTemporalConv(3, 5, 3, 2),
        "CausalTemporalConv(3, 5, kernel_size=3, dilation=2)",
        3 * 15 + 5,
        size=(NUM_TAXELS, 9, 3),
    ),
    "cnn_thread": Layer(
        lambda: CNNThread(3, LAYOUT.image_map, **WIDTHS),
        "CNNThread(3, widths=(4, 8), pools=(1, 4), size=(3, 5))",
        9 * (12 + 32) + 12,
    ),
    "mlp": Layer(
        lambda: PooledMLP(3, 2, (4,), (2,)), "PooledMLP(3, 2, widths=(4,), pools=(2,))", 22
    ),
    "bilinear": Layer(BilinearFeature, "BilinearFeature(eps=1e-05)", 0, size=(NUM_TAXELS, 5, 4)),
    "channel_max": Layer(lambda: ChannelMaxPool(3), "ChannelMaxPool(3)", 0),
    "taxel_max": Layer(
        lambda: TaxelPool(LAYOUT, "patch"), "TaxelPool(11, 3, by='patch', aggr='max')", 0
    ),
    "taxel_mean": Layer(
        lambda: TaxelPool(LAYOUT, "patch", "mean"), "TaxelPool(11, 3, by='patch', aggr='mean')", 0
    ),
}
GRAPH_LAYERS = [name for name, layer in LAYERS.items() if layer.inputs]
CONVS = [name for name in GRAPH_LAYERS if LAYERS[name].inputs != ENCODER]
ENCODERS = [name for name in GRAPH_LAYERS if LAYERS[name].inputs == ENCODER]
MATRIX_LAYERS = [name for name in CONVS if LAYERS[name].inputs in (CONV, WEIGHTED)]
WEIGHTED_LAYERS = [name for name in CONVS if LAYERS[name].inputs == WEIGHTED]
# PyG's attention layers have other rules for a size of -1.
LAZY_LAYERS = [name for name in GRAPH_LAYERS if not name.endswith("thread") and "gat" not in name]


def make_layer(name: str, dtype: torch.dtype = torch.float, seed: int = 0, **more):
    """A layer whose biases are not zero."""
    torch.manual_seed(seed)
    layer = LAYERS[name].make(**more)
    for key, value in layer.named_parameters():
        if key.endswith("bias") and value.numel():
            nn.init.normal_(value)
    return layer.to(dtype)


def layer_inputs(
    name: str,
    batch_size: int | None,
    dtype: torch.dtype = torch.float,
    edge_index: Tensor = EDGE_INDEX,
) -> list[Tensor | int]:
    """The inputs of a layer in the order of its arguments: of samples, or of one with ``None``."""
    size, inputs = LAYERS[name].size, LAYERS[name].inputs
    if inputs == ENCODER:
        size = (edge_index.size(1), *size[1:])
    arguments: list[Tensor | int] = [
        samples(*(() if batch_size is None else (batch_size,)), *size).to(dtype)
    ]
    for key in inputs:
        if key == "edges":
            arguments.append(edge_index)
        elif key == "num_nodes":
            arguments.append(NUM_TAXELS)
        else:
            value = EDGE_INPUTS[key][: edge_index.size(1)]
            arguments.append(value.to(dtype) if value.is_floating_point() else value)
    return arguments


def sample_inputs(name: str, arguments: list[Tensor | int]) -> list[list[Tensor | int]]:
    """The inputs of each sample."""
    x, *others = arguments
    return [[row, *others] for row in x]


def batch_inputs(name: str, arguments: list[Tensor | int]) -> list[Tensor | int]:
    """The inputs as of PyG's batch."""
    x, *others = arguments
    batch = [x.flatten(0, 1)]
    for key, value in zip(LAYERS[name].inputs, others, strict=True):
        if key == "edges":
            shift = NUM_TAXELS * torch.arange(len(x)).view(-1, 1, 1)
            batch.append((value + shift).transpose(0, 1).flatten(1))
        elif key == "num_nodes":
            batch.append(value * len(x))
        else:
            batch.append(value.repeat(len(x), *[1] * (value.dim() - 1)))
    return batch
