r"""Fully connected layers with pooling over channels."""

from collections.abc import Sequence

from torch import Tensor
from torch.nn import Linear, Module, ModuleList
from torch_geometric.nn.inits import reset

from torch_geometric_tactile.nn._sizes import check_sizes
from torch_geometric_tactile.nn.models._thread_widths import checked_widths
from torch_geometric_tactile.nn.pool import ChannelMaxPool


class PooledMLP(Module):
    r"""The fully connected layers from the "Tactile Object Property Recognition using Geometrical
    Graph Edge Features and Multi-Thread Graph Convolutional Network" paper. Each layer consists of
    a linear map, a :class:`~torch_geometric_tactile.nn.pool.ChannelMaxPool` and ReLU. A linear map
    to the logits follows. The defaults are the paper's "1536(P)768, 384(P)192, 96(P)48".

    Args:
        in_channels (int): Width of the input.
        out_channels (int): Number of logits.
        widths (sequence of int): Width of each layer.
        pools (sequence of int): Pool size in channels after each layer.

    Shapes:
        - **input:** features :math:`(B, F)`
        - **output:** logits :math:`(B, C)`

    Raises:
        ValueError: If a pool size does not divide its width, the numbers of widths and pool sizes
            differ, or a size is below one.

    Examples:
        >>> PooledMLP(2688, 6)
        PooledMLP(2688, 6, widths=(1536, 384, 96), pools=(2, 2, 2))
    """

    def __init__(
        self,
        in_channels: int,
        out_channels: int,
        widths: Sequence[int] = (1536, 384, 96),
        pools: Sequence[int] = (2, 2, 2),
    ) -> None:
        super().__init__()
        check_sizes(out_channels=out_channels)
        self.in_channels = in_channels
        self.out_channels = out_channels
        self.widths, self.pool_sizes, sizes = checked_widths(in_channels, widths, pools)
        self.lins = ModuleList(map(Linear, sizes, self.widths))
        self.pools = ModuleList(map(ChannelMaxPool, self.pool_sizes))
        self.lin_out = Linear(sizes[-1], out_channels)

    def reset_parameters(self) -> None:
        r"""Resets all learnable parameters."""
        reset(self.lins)
        self.lin_out.reset_parameters()

    def forward(self, x: Tensor) -> Tensor:
        r"""Returns the logits :math:`(B, C)`.

        Args:
            x (torch.Tensor): Features.
        """
        for lin, pool in zip(self.lins, self.pools, strict=True):
            x = pool(lin(x)).relu()
        return self.lin_out(x)

    def __repr__(self) -> str:
        return (
            f"{type(self).__name__}({self.in_channels}, {self.out_channels}, "
            f"widths={self.widths}, pools={self.pool_sizes})"
        )
