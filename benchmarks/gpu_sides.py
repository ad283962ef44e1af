r"""The two sides of each comparison on a GPU: layers and models of this package, and the same with
PyG's layers on a `Batch`. Both sides have equal weights, and their data is on the device.
"""

import copy
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import cache
from typing import Any

import torch
from layers import batch_edges
from plain_pyg import PlainGCN, PlainMTGCN, PlainSegmentedBatch
from shared import two_nearest
from torch import Tensor, nn
from torch_geometric.nn import GATConv, GATv2Conv, GCNConv, GraphConv, RGCNConv

from torch_geometric_tactile.nn import (
    SegmentedGCNConv,
    SelfGCNConv,
    StaticGATConv,
    StaticGATv2Conv,
    StaticGCNConv,
)
from torch_geometric_tactile.nn.conv import SectorConv
from torch_geometric_tactile.nn.models import MTGCN, TactileGCN, TaxelNet
from torch_geometric_tactile.sensors import TaxelLayout, allegro_uskin, grid

CLASSES = 8
HAND = 384
MODELS = ("X", "II", "MT-GCN", "TaxelNet")
_PAIRS = {
    "StaticGCNConv": (StaticGCNConv, GCNConv),
    "StaticGATConv": (StaticGATConv, GATConv),
    "StaticGATv2Conv": (StaticGATv2Conv, GATv2Conv),
}
LAYERS = (*_PAIRS, "SelfGCNConv", "SegmentedGCNConv")
_GRIDS = {24: (4, 6), 2048: (32, 64)}


@dataclass(frozen=True)
class Side:
    r"""A module, its inputs, and what is summed up for the backward pass."""

    module: nn.Module
    inputs: tuple[Any, ...]
    loss: Callable[[Tensor], Tensor]
    keywords: dict[str, Any] = field(default_factory=dict)

    def output(self) -> Tensor:
        return self.module(*self.inputs, **self.keywords)

    def leaves(self) -> list[Tensor]:
        inputs = [x for x in self.inputs if isinstance(x, Tensor) and x.requires_grad]
        return [*inputs, *self.module.parameters()]


@cache
def layout_of(num_nodes: int) -> TaxelLayout:
    r"""Returns the hand (384 taxels) or a grid, of which each row is a patch."""
    if num_nodes == HAND:
        return allegro_uskin()
    if num_nodes not in _GRIDS:
        raise ValueError(f"'num_nodes' must be {HAND} or one of {[*_GRIDS]} (got {num_nodes})")
    rows, cols = _GRIDS[num_nodes]
    row = torch.arange(rows).repeat_interleave(cols)
    names = tuple(f"row_{number}" for number in range(rows))
    return replace(grid(rows, cols, 0.003), patch=row, patch_names=names)


@cache
def edges_of(num_nodes: int) -> Tensor:
    layout = layout_of(num_nodes)
    return layout.edge_index("original") if num_nodes == HAND else two_nearest(layout)


def make_sides(name: str, num_nodes: int, num_samples: int, device: str) -> dict[str, Side]:
    r"""Returns the sides `plain` and `ours` of a model, or of a layer such as
    `"StaticGCNConv 3-16"`.
    """
    torch.manual_seed(0)
    edge_index = edges_of(num_nodes)
    joined = batch_edges(edge_index, num_nodes, num_samples).to(device)
    if name not in MODELS:
        return _layer_sides(name, num_nodes, num_samples, joined, device)
    x = torch.randn(num_samples, num_nodes, 3).to(device)
    y = torch.randint(CLASSES, (num_samples,)).to(device)

    def loss(logits: Tensor) -> Tensor:
        return nn.functional.cross_entropy(logits, y)

    plain, ours = (module.to(device) for module in _model_pair(name, num_nodes, edge_index, device))
    edge_index = edge_index.to(device)
    keywords: dict[str, dict[str, Any]] = {"plain": {}, "ours": {}}
    if name == "MT-GCN":
        edge_attr = torch.randn(num_samples, edge_index.size(1), 4).to(device)
        keywords = {
            "plain": {"edge_attr": edge_attr.flatten(0, 1)},
            "ours": {"edge_attr": edge_attr},
        }
    theirs = (x, edge_index) if name == "TaxelNet" else (x.flatten(0, 1), joined)
    return {
        "plain": Side(plain, theirs, loss, keywords["plain"]),
        "ours": Side(ours, (x, edge_index), loss, keywords["ours"]),
    }


def _model_pair(
    name: str, num_nodes: int, edge_index: Tensor, device: str
) -> tuple[nn.Module, nn.Module]:
    layout = layout_of(num_nodes)
    plain: nn.Module
    ours: nn.Module
    if name == "TaxelNet":
        ours = TaxelNet(layout, CLASSES)
        return relational_net(ours), ours
    if name == "II":
        ours = TactileGCN(layout, CLASSES, segments="patch")
        segment = layout.segments("patch").to(device)
        plain = PlainSegmentedBatch(segment, edge_index.to(device), out_channels=CLASSES)
        plain.copy_weights(ours)
        return plain, ours
    if name == "X":
        ours, plain = TactileGCN(layout, CLASSES), PlainGCN(num_nodes, out_channels=CLASSES)
    else:
        num_edges = edge_index.size(1)
        ours = MTGCN(layout, CLASSES, inputs=("tactile", "edge"), num_edges=num_edges)
        plain = PlainMTGCN(num_nodes, num_edges, CLASSES)
    plain.load_state_dict(ours.state_dict())
    return plain, ours


class BatchedRGCN(nn.Module):
    r"""The sectors of a :class:`SectorConv` as the relations of PyG's layer, on joined edges."""

    def __init__(self, conv: SectorConv) -> None:
        super().__init__()
        sizes = conv.in_channels, conv.out_channels, conv.num_sectors
        self.conv = RGCNConv(*sizes, aggr="sum", bias=False)
        with torch.no_grad():
            self.conv.root.copy_(conv.weight[0])
            self.conv.weight.copy_(conv.weight[1:])
        self.joined: dict[int, tuple[Tensor, Tensor]] = {}

    def forward(self, x: Tensor, edge_index: Tensor, sector: Tensor) -> Tensor:
        num_samples, num_nodes, _ = x.shape
        if num_samples not in self.joined:  # a loader's `Batch` brings them along
            edges = batch_edges(edge_index.cpu(), num_nodes, num_samples).to(x.device)
            # In the order of `batch_edges`: edge by edge in each sample.
            self.joined[num_samples] = edges, sector.repeat(num_samples)
        return self.conv(x.flatten(0, 1), *self.joined[num_samples]).view(
            num_samples, num_nodes, -1
        )


def relational_net(net: nn.Module) -> nn.Module:
    r"""Returns a :class:`TaxelNet` with PyG's `RGCNConv` in place of each :class:`SectorConv`."""
    plain = copy.deepcopy(net)
    for level in plain.levels:
        for block in level.blocks:
            block.conv = BatchedRGCN(block.conv)
    return plain


class SegmentLoop(nn.Module):
    r"""A `GCNConv` for each segment of a `Batch`, one after the other."""

    def __init__(self, conv: SegmentedGCNConv, joined: Tensor, num_samples: int) -> None:
        super().__init__()
        segment = conv.segment.cpu().repeat(num_samples)
        source, target = segment[joined.cpu()]
        self.parts: list[tuple[Tensor, Tensor]] = []
        self.convs = nn.ModuleList()
        for number in conv.segment.unique().tolist():
            nodes = (segment == number).nonzero().view(-1)
            place = torch.empty_like(segment).scatter_(0, nodes, torch.arange(len(nodes)))
            edges = place[joined.cpu()[:, (source == number) & (target == number)]]
            self.parts.append((nodes.to(joined.device), edges.to(joined.device)))
            layer = GCNConv(conv.in_channels, conv.out_channels)
            with torch.no_grad():
                layer.lin.weight.copy_(conv.weight[number])
                layer.bias.copy_(conv.bias[number])
            self.convs.append(layer)

    def forward(self, x: Tensor, edge_index: Tensor) -> Tensor:
        outs = [
            conv(x[nodes], edges)
            for conv, (nodes, edges) in zip(self.convs, self.parts, strict=True)
        ]
        out = outs[0].new_empty(len(x), outs[0].size(-1))
        return out.index_copy(0, torch.cat([nodes for nodes, _ in self.parts]), torch.cat(outs))


def _layer_sides(
    text: str, num_nodes: int, num_samples: int, joined: Tensor, device: str
) -> dict[str, Side]:
    name, _, sizes = text.partition(" ")
    widths = [int(size) for size in sizes.split("-")]
    edge_index = edges_of(num_nodes)
    plain: nn.Module
    ours: nn.Module
    if name == "SegmentedGCNConv":
        ours = SegmentedGCNConv(layout_of(num_nodes).segments("patch"), *widths)
        plain = SegmentLoop(ours, joined, num_samples)
    elif name == "SelfGCNConv":
        ours, plain = SelfGCNConv(*widths, normalize=False), GraphConv(*widths)
        plain.load_state_dict(ours.state_dict())
    else:
        ours, plain = (layer(*widths) for layer in _PAIRS[name])
        plain.load_state_dict(ours.state_dict())
    x = torch.randn(num_samples, num_nodes, widths[0]).to(device)
    grad = torch.randn(num_samples, num_nodes, widths[1]).to(device)
    flat = x.flatten(0, 1).clone().requires_grad_()

    def loss(out: Tensor) -> Tensor:
        return (out * grad.view_as(out)).sum()

    return {
        "plain": Side(plain.to(device), (flat, joined), loss),
        "ours": Side(ours.to(device), (x.requires_grad_(), edge_index.to(device)), loss),
    }


@contextmanager
def edges_kept(module: nn.Module) -> Iterator[None]:
    r"""Sets `cached` on PyG's `GCNConv`, which otherwise normalises the edges at each call, waits
    for the GPU and cannot be captured in a graph.
    """
    layers = [layer for layer in module.modules() if type(layer) is GCNConv]
    try:
        for layer in layers:
            layer.cached = True
        yield
    finally:
        for layer in layers:
            layer.cached, layer._cached_edge_index = False, None
