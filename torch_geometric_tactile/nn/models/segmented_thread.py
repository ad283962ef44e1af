r"""A thread of graph convolutions with separate weights for each segment."""

from collections.abc import Sequence
from typing import Union

import torch
from torch import Tensor
from torch_geometric.typing import OptTensor

from torch_geometric_tactile.nn._pooled_gcn import is_pooled_gcn_faster, may_merge, pooled_thread
from torch_geometric_tactile.nn.conv import SegmentedGCNConv
from torch_geometric_tactile.nn.conv._static_adjacency import (
    AdjacencyCache,
    adjacency_blocks,
    all_finite,
    contained_product,
    dense_norm,
    edge_pattern,
)
from torch_geometric_tactile.nn.models._inputs import required_edges, weight_like
from torch_geometric_tactile.nn.models.thread import Thread


class SegmentedThread(Thread):
    r"""One small graph convolutional network for each segment of a hand, with separate weights for
    each, from the "Multifingered Object Recognition with Tactile Sensors and Graph Convolutional
    Networks using Topological Graph Segmentation" paper. Each layer consists of a
    :class:`~torch_geometric_tactile.nn.conv.SegmentedGCNConv`, a
    :class:`~torch_geometric_tactile.nn.pool.ChannelMaxPool` and ReLU.

    The defaults are the paper's "14, 56(P)7". Segments of equal size (on the Allegro hand, the 18
    planar patches and the four fingertips) are computed in one batched product. The fast
    implementation computes all segments together, as in
    :class:`~torch_geometric_tactile.nn.models.GCNThread`.

    Args:
        in_channels (int): Number of input features per taxel.
        segment (sequence of int or torch.Tensor): Index of each taxel's segment :math:`(N,)`,
            numbered from zero without gaps.
        widths (sequence of int): Width of each convolution.
        pools (sequence of int): Pool size in channels after each convolution.
        fast (bool): Whether to use a faster implementation for batches of at least eight samples on
            a CPU. It returns the same results, but does not support second derivatives.

    Shapes:
        - **input:** node features :math:`(N, F)`, :math:`(B, N, F)` or, for a PyG batch,
          :math:`(B \cdot N, F)`, edges :math:`(2, |\mathcal{E}|)`
        - **output:** node features with the same leading shape, and the last width divided by the
          last pool size

    Raises:
        ValueError: If a pool size does not divide its width, the numbers of widths and pool sizes
            differ, :obj:`segment` has gaps, or :obj:`x` has the wrong number of taxels or channels.

    Examples:
        >>> thread = SegmentedThread(3, [0, 0, 1])
        >>> thread
        SegmentedThread(3, widths=(14, 56), pools=(1, 8), num_segments=2)
        >>> thread(torch.zeros(2, 3, 3), torch.tensor([[0, 1], [1, 0]])).shape
        torch.Size([2, 3, 7])
    """

    place: Tensor

    def __init__(
        self,
        in_channels: int,
        segment: Union[Sequence[int], Tensor],
        widths: Sequence[int] = (14, 56),
        pools: Sequence[int] = (1, 8),
        *,
        fast: bool = True,
    ) -> None:
        def conv(in_channels: int, out_channels: int) -> SegmentedGCNConv:
            return SegmentedGCNConv(segment, in_channels, out_channels)

        super().__init__(in_channels, widths, pools, conv, fast=fast)
        first_conv, _ = self.layers()[0]
        self.num_segments = first_conv.num_segments
        self._edge_cache = AdjacencyCache()
        self._add_groups(first_conv.segment)

    def _add_groups(self, segment: Tensor) -> None:
        # For each segment size, registers the indices (S,) and the taxels (S, n) of its segments.
        counts = segment.bincount()
        order, self.num_groups = [], 0
        for size in counts.unique().tolist():
            members = (counts == size).nonzero().view(-1)
            nodes = torch.stack([(segment == member).nonzero().view(-1) for member in members])
            self.register_buffer(f"members_{self.num_groups}", members, persistent=False)
            self.register_buffer(f"nodes_{self.num_groups}", nodes, persistent=False)
            order.append(nodes.flatten())
            self.num_groups += 1
        self.register_buffer("place", torch.cat(order).argsort(), persistent=False)

    def forward(
        self, x: Tensor, edge_index: OptTensor = None, edge_weight: OptTensor = None
    ) -> Tensor:
        r"""Returns the node features after the convolutions.

        Args:
            x (torch.Tensor): Node features.
            edge_index (torch.Tensor): Edges. Edges between segments are ignored.
            edge_weight (torch.Tensor, optional): Edge weights. Defaults to ones.
        """
        edge_index, edge_weight = required_edges(edge_index), weight_like(edge_weight, x)
        layers = self.layers()
        segment: Tensor = layers[0][0].segment
        if x.dim() != 3 or x.size(1) != len(segment) or not may_merge(layers):
            return self._by_layers(x, edge_index, edge_weight)
        if x.size(-1) != self.in_channels:
            raise ValueError(f"'x' must have {self.in_channels} features (got {x.size(-1)})")
        cached_adjacency = self._edge_cache.get(
            edge_index, edge_weight, len(segment), x.dtype, segment
        )
        if cached_adjacency is not None and self.fast and is_pooled_gcn_faster(x):
            return pooled_thread(x, layers, cached_adjacency, segment)
        is_finite = all_finite(x)
        # Dense products would spread an infinite reading to the whole segment, since zero times
        # infinity is NaN. If it is unknown whether all readings are finite (None), contained
        # products are used.
        if is_finite is False:
            return self._by_layers(x, edge_index, edge_weight)
        if cached_adjacency is None:
            dense = dense_norm(edge_index, edge_weight, len(segment), x.dtype, segment)
        outs = []
        for i in range(self.num_groups):
            members, nodes = getattr(self, f"members_{i}"), getattr(self, f"nodes_{i}")
            adjacency = (
                adjacency_blocks(dense, nodes)
                if cached_adjacency is None
                else cached_adjacency.blocks(i, nodes)
            )
            # Features (B, S, n, F). `index_select` is a single operation in an export.
            h = x.index_select(1, nodes.flatten()).unflatten(1, nodes.shape)
            pattern = None if is_finite else edge_pattern(adjacency)
            for conv, pool in layers:
                h = adjacency @ h if pattern is None else contained_product(adjacency, pattern, h)
                h = h @ conv.weight[members].transpose(1, 2)
                if conv.bias is not None:
                    h = h + conv.bias[members].unsqueeze(1)
                h = pool(h).relu()
            outs.append(h.flatten(1, 2))
        return torch.cat(outs, dim=1).index_select(1, self.place)

    def extra_repr(self) -> str:
        r"""Returns the sizes for :obj:`repr`."""
        return f"{super().extra_repr()}, num_segments={self.num_segments}"
