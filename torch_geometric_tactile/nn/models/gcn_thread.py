r"""Graph convolutions in a row, with the maximum over channels between them."""

from collections.abc import Sequence

from torch import Tensor
from torch.nn import Module, ModuleList
from torch_geometric.nn.inits import reset
from torch_geometric.typing import OptTensor

from torch_geometric_tactile.nn.conv import StaticGCNConv
from torch_geometric_tactile.nn.conv.static_adjacency import AdjacencyCache
from torch_geometric_tactile.nn.functional import may_merge, may_run_fast, pooled_gcn
from torch_geometric_tactile.nn.pool import ChannelMaxPool

WIDTHS = (14, 28, 56, 112, 112)
POOLS = (1, 1, 2, 4, 16)


class GCNThread(Module):
    r"""A thread of graph convolutions of the "Tactile Object Property Recognition using Geometrical
    Graph Edge Features and Multi-Thread Graph Convolutional Network" paper: each layer is a
    :class:`~torch_geometric_tactile.nn.conv.StaticGCNConv`, a
    :class:`~torch_geometric_tactile.nn.pool.ChannelMaxPool` and ReLU.

    .. math::
        \mathbf{H}^{(l+1)} = \max \left( 0, \mathrm{pool}_{k_l} \left( \hat{\mathbf{A}}
        \mathbf{H}^{(l)} \mathbf{W}^{(l)} + \mathbf{b}^{(l)} \right) \right)

    The defaults are the paper's thread for readings, "14, 28, 56(P)28, 112(P)28, 112(P)7".

    Many samples on one topology are trained on processors by the operations of
    :mod:`torch_geometric_tactile.nn.functional`, with the same result. They have no second
    derivative; :obj:`fast=False` leaves them out.

    Args:
        in_channels (int): Features of each taxel.
        widths (sequence of int): Width of each convolution.
        pools (sequence of int): How many channels share one maximum, behind each convolution.
        fast (bool): Whether to train with the operations made for one topology.

    Shapes:
        - **input:** node features :math:`(N, F)`, :math:`(B, N, F)` or those of a PyG batch
          :math:`(B \cdot N, F)`, edges :math:`(2, |\mathcal{E}|)`
        - **output:** node features of the same leading shape, the last width by the last pool wide

    Raises:
        ValueError: If there is no layer, there are other pools than widths, a pool does not divide
            its width, or :obj:`x` has other channels.

    Examples:
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
        fast: bool = True,
    ) -> None:
        super().__init__()
        self.in_channels = in_channels
        self.widths, self.pool_sizes, sizes = checked_widths(in_channels, widths, pools)
        self.fast = fast
        self.out_channels = sizes[-1]
        self.convs = ModuleList(map(StaticGCNConv, sizes, self.widths))
        self.pools = ModuleList(map(ChannelMaxPool, self.pool_sizes))
        self._kept = AdjacencyCache()

    def reset_parameters(self) -> None:
        r"""Draws all weights anew."""
        reset(self.convs)

    def layers(self) -> list[tuple[StaticGCNConv, ChannelMaxPool]]:
        r"""Returns the convolutions, each with the pooling behind it."""
        return list(zip(self.convs, self.pools, strict=True))  # type: ignore[arg-type]

    def forward(self, x: Tensor, edge_index: Tensor, edge_weight: OptTensor = None) -> Tensor:
        r"""Convolves node features.

        Args:
            x (torch.Tensor): Node features.
            edge_index (torch.Tensor): Edges.
            edge_weight (torch.Tensor, optional): Weights of the edges; one if left out.
        """
        if x.dim() not in (2, 3) or x.size(-1) != self.in_channels:
            raise ValueError(
                f"'x' must have shape (num_nodes, {self.in_channels}) or (batch_size, num_nodes, "
                f"{self.in_channels}) (got {tuple(x.shape)})"
            )
        if self.fast and may_run_fast(x) and may_merge(self.layers()):
            kept = self._kept.get(edge_index, edge_weight, x.size(1), x.dtype)
            if kept is not None:
                h = x.permute(1, 2, 0).contiguous()
                for conv, pool in self.layers():
                    h = pooled_gcn(h, kept, conv.lin.weight, conv.bias, pool.kernel_size)
                return h.permute(2, 0, 1)
        for conv, pool in self.layers():
            x = pool(conv(x, edge_index, edge_weight)).relu()
        return x

    def __repr__(self) -> str:
        return (
            f"{type(self).__name__}({self.in_channels}, widths={self.widths}, "
            f"pools={self.pool_sizes})"
        )


def checked_widths(
    in_channels: int, widths: Sequence[int], pools: Sequence[int]
) -> tuple[tuple[int, ...], tuple[int, ...], tuple[int, ...]]:
    r"""Returns widths and pools of layers, which must fit each other, and the width before each
    layer and behind the last.

    Args:
        in_channels (int): Width of the input.
        widths (sequence of int): Width of each layer.
        pools (sequence of int): How many channels share one maximum, behind each layer.

    Raises:
        ValueError: If they do not.
    """
    widths, pools = tuple(widths), tuple(pools)
    if in_channels < 1:
        raise ValueError(f"'in_channels' must be at least 1 (got {in_channels})")
    if not widths or min(widths) < 1:
        raise ValueError(f"'widths' must be at least one width of at least 1 (got {widths})")
    if len(pools) != len(widths):
        raise ValueError(f"'pools' must have a size for each of {len(widths)} widths (got {pools})")
    for width, pool in zip(widths, pools, strict=True):
        if pool < 1 or width % pool:
            raise ValueError(f"'pools' must divide 'widths' (got {pool} for {width})")
    sizes = (in_channels, *(width // pool for width, pool in zip(widths, pools, strict=True)))
    return widths, pools, sizes
