r"""A thread of graph convolutions with pooling over channels."""

from collections.abc import Sequence

from torch import Tensor
from torch_geometric.typing import OptTensor

from torch_geometric_tactile.nn._pooled_gcn import is_pooled_gcn_faster, may_merge, pooled_thread
from torch_geometric_tactile.nn.conv import StaticGCNConv
from torch_geometric_tactile.nn.conv._static_adjacency import AdjacencyCache
from torch_geometric_tactile.nn.models._inputs import required_edges, weight_like
from torch_geometric_tactile.nn.models._thread_widths import POOLS, WIDTHS
from torch_geometric_tactile.nn.models.thread import Thread


class GCNThread(Thread):
    r"""A thread of graph convolutions from the "Tactile Object Property Recognition using
    Geometrical Graph Edge Features and Multi-Thread Graph Convolutional Network" paper. Each layer
    consists of a :class:`~torch_geometric_tactile.nn.conv.StaticGCNConv`, a
    :class:`~torch_geometric_tactile.nn.pool.ChannelMaxPool` and ReLU.

    .. math::
        \mathbf{H}^{(l+1)} = \max \left( 0, \mathrm{pool}_{k_l} \left( \hat{\mathbf{A}}
        \mathbf{H}^{(l)} \mathbf{W}^{(l)} + \mathbf{b}^{(l)} \right) \right)

    The defaults correspond to the paper's thread for readings: "14, 28, 56(P)28, 112(P)28,
    112(P)7".

    Args:
        in_channels (int): Number of input features per taxel.
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
        ValueError: If there is no layer, the numbers of widths and pool sizes differ, a pool size
            does not divide its width, or :obj:`x` has the wrong number of channels.

    Examples:
        >>> import torch
        >>> thread = GCNThread(3)
        >>> thread
        GCNThread(3, widths=(14, 28, 56, 112, 112), pools=(1, 1, 2, 4, 16))
        >>> thread(torch.zeros(2, 4, 3), torch.tensor([[0, 1], [1, 0]])).shape
        torch.Size([2, 4, 7])
    """

    def __init__(
        self,
        in_channels: int,
        widths: Sequence[int] = WIDTHS,
        pools: Sequence[int] = POOLS,
        *,
        fast: bool = True,
    ) -> None:
        super().__init__(in_channels, widths, pools, StaticGCNConv, fast=fast)
        self._edge_cache = AdjacencyCache()

    def forward(
        self, x: Tensor, edge_index: OptTensor = None, edge_weight: OptTensor = None
    ) -> Tensor:
        r"""Returns the node features after the convolutions.

        Args:
            x (torch.Tensor): Node features.
            edge_index (torch.Tensor): Edges.
            edge_weight (torch.Tensor, optional): Edge weights. Defaults to ones.
        """
        if x.dim() not in (2, 3) or x.size(-1) != self.in_channels:
            raise ValueError(
                f"'x' must have shape (num_nodes, {self.in_channels}) or (batch_size, num_nodes, "
                f"{self.in_channels}) (got {tuple(x.shape)})"
            )
        edge_index, edge_weight = required_edges(edge_index), weight_like(edge_weight, x)
        if self.fast and is_pooled_gcn_faster(x) and may_merge(self.layers()):
            adjacency = self._edge_cache.get(edge_index, edge_weight, x.size(1), x.dtype)
            if adjacency is not None:
                return pooled_thread(x, self.layers(), adjacency)
        return self._by_layers(x, edge_index, edge_weight)
