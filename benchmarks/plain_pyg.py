r"""The models of the hand written the ordinary PyG way, which benchmarks compare with: `GCNConv` on
block-diagonal batches, the maximum over channels by `max`, a loop over the segments.
"""

import torch
from torch import Tensor, nn
from torch_geometric.nn import MLP, GCNConv, MessagePassing
from torch_geometric.utils import subgraph

WIDTHS, POOLS = (14, 28, 56, 112, 112), (1, 1, 2, 4, 16)


def channel_max(x: Tensor, kernel_size: int) -> Tensor:
    if kernel_size == 1:
        return x
    return x.view(x.size(0), -1, kernel_size).max(dim=-1).values


class Thread(nn.Module):
    def __init__(self, in_channels: int, widths: tuple[int, ...], pools: tuple[int, ...]) -> None:
        super().__init__()
        sizes = [in_channels, *(w // k for w, k in zip(widths, pools, strict=True))]
        self.convs = nn.ModuleList(map(GCNConv, sizes, widths))
        self.pools = pools
        self.out_channels = sizes[-1]

    def forward(self, x: Tensor, edge_index: Tensor) -> Tensor:
        for conv, pool in zip(self.convs, self.pools, strict=True):
            x = channel_max(conv(x, edge_index), pool).relu()
        return x


class Head(nn.Module):
    def __init__(self, in_channels: int, out_channels: int) -> None:
        super().__init__()
        self.lins = nn.ModuleList(
            [nn.Linear(in_channels, 1536), nn.Linear(768, 384), nn.Linear(192, 96)]
        )
        self.lin_out = nn.Linear(48, out_channels)

    def forward(self, x: Tensor) -> Tensor:
        for lin in self.lins:
            x = channel_max(lin(x), 2).relu()
        return self.lin_out(x)


class PlainGCN(nn.Module):
    r"""The GCN (X) of the papers on a PyG batch."""

    def __init__(self, num_nodes: int = 384, in_channels: int = 3, out_channels: int = 8) -> None:
        super().__init__()
        self.num_nodes = num_nodes
        self.thread = Thread(in_channels, WIDTHS, POOLS)
        self.head = Head(num_nodes * self.thread.out_channels, out_channels)

    def forward(self, x: Tensor, edge_index: Tensor) -> Tensor:
        return self.head(self.thread(x, edge_index).view(x.size(0) // self.num_nodes, -1))


class PlainMTGCN(nn.Module):
    r"""The MT-GCN of the papers with readings and edge features on a PyG batch, with the names of
    the weights of ours.
    """

    def __init__(self, num_nodes: int, num_edges: int, out_channels: int = 8) -> None:
        super().__init__()
        self.num_nodes, self.num_edges = num_nodes, num_edges
        self.encoder = nn.ModuleDict({"lin": nn.Linear(4 * num_edges, 4 * num_nodes)})
        self.threads = nn.ModuleDict(
            {
                "tactile": Thread(3, WIDTHS, POOLS),
                "edge": Thread(4, (7, 14, 28, 28, 56), (1, 1, 2, 2, 8)),
            }
        )
        self.head = Head(14 * num_nodes, out_channels)

    def forward(self, x: Tensor, edge_index: Tensor, edge_attr: Tensor) -> Tensor:
        encoded = self.encoder["lin"](edge_attr.view(-1, 4 * self.num_edges)).view(-1, 4)
        readings = self.threads["tactile"](x, edge_index)
        edges = self.threads["edge"](encoded, edge_index)
        rows = torch.cat([readings, edges], dim=-1)
        return self.head(rows.view(x.size(0) // self.num_nodes, -1))


class EdgeMLP(MessagePassing):
    r"""One small network on the features of each edge, averaged at the target."""

    def __init__(self) -> None:
        super().__init__(aggr="mean")
        self.mlp = MLP([4, 16, 4], norm=None)

    def forward(self, edge_attr: Tensor, edge_index: Tensor, num_nodes: int) -> Tensor:
        hidden = self.mlp(edge_attr)
        return self.propagate(edge_index, hidden=hidden, size=(num_nodes, num_nodes))

    def message(self, hidden: Tensor) -> Tensor:
        return hidden


class PlainSegmented(nn.Module):
    r"""Segmentation II of one frame: a GCN of its own for each patch, one after the other."""

    def __init__(
        self,
        segment: Tensor,
        edge_index: Tensor,
        with_edges: bool,
        num_joints: int = 16,
        out_channels: int = 8,
    ) -> None:
        super().__init__()
        self.encoder = EdgeMLP() if with_edges else None
        self.nodes, self.edges, threads = [], [], []
        for number in segment.unique():
            nodes = (segment == number).nonzero().view(-1)
            edges, _ = subgraph(nodes, edge_index, relabel_nodes=True, num_nodes=len(segment))
            self.nodes.append(nodes)
            self.edges.append(edges)
            threads.append(Thread(7 if with_edges else 3, (14, 56), (1, 8)))
        self.threads = nn.ModuleList(threads)
        self.head = Head(len(segment) * 7 + num_joints, out_channels)

    def forward(
        self, x: Tensor, edge_index: Tensor, edge_attr: Tensor | None, joint: Tensor
    ) -> Tensor:
        if self.encoder is not None:
            x = torch.cat([x, self.encoder(edge_attr, edge_index, x.size(0))], dim=-1)
        parts = [
            thread(x[nodes], edges).flatten()
            for thread, nodes, edges in zip(self.threads, self.nodes, self.edges, strict=True)
        ]
        return self.head(torch.cat([*parts, joint.view(-1)]).unsqueeze(0))


class PlainSegmentedBatch(PlainSegmented):
    r"""Segmentation II of readings on a PyG batch: a GCN of its own for each patch, one after the
    other. Taxels and edges of the patches are joined once for each number of frames.
    """

    def __init__(self, segment: Tensor, edge_index: Tensor, out_channels: int = 8) -> None:
        super().__init__(segment, edge_index, False, num_joints=0, out_channels=out_channels)
        self.num_nodes = len(segment)
        self.joined: dict[int, list[Tensor]] = {}

    def copy_weights(self, model: nn.Module) -> None:
        r"""Takes the weights of a `TactileGCN` with `segments="patch"`."""
        with torch.no_grad():
            for number, thread in enumerate(self.threads):
                for target, source in zip(thread.convs, model.thread.convs, strict=True):
                    target.lin.weight.copy_(source.weight[number])
                    target.bias.copy_(source.bias[number])
        self.head.load_state_dict(model.head.state_dict())

    def forward(self, x: Tensor, edge_index: Tensor) -> Tensor:
        num_frames = x.size(0) // self.num_nodes
        frames = x.view(num_frames, self.num_nodes, -1)
        parts = [
            thread(frames[:, nodes].flatten(0, 1), edges).view(num_frames, -1)
            for thread, nodes, edges in zip(
                self.threads, self.nodes, self._joined_edges(num_frames), strict=True
            )
        ]
        return self.head(torch.cat(parts, dim=-1))

    def _joined_edges(self, num_frames: int) -> list[Tensor]:
        if num_frames not in self.joined:
            self.joined[num_frames] = [
                (
                    edges.unsqueeze(1)
                    + len(nodes) * torch.arange(num_frames).to(edges).view(1, -1, 1)
                ).flatten(1)
                for nodes, edges in zip(self.nodes, self.edges, strict=True)
            ]
        return self.joined[num_frames]
