r"""The base class of threads, which are sequences of convolutions with pooling over channels."""

from collections.abc import Callable, Sequence
from typing import Any

from torch import Tensor
from torch.nn import Module, ModuleList
from torch_geometric.nn import MessagePassing
from torch_geometric.nn.inits import reset
from torch_geometric.typing import OptTensor

from torch_geometric_tactile.nn.models._thread_widths import checked_widths
from torch_geometric_tactile.nn.pool import ChannelMaxPool


class Thread(Module):
    r"""The base class of threads. Each layer consists of a convolution, a
    :class:`~torch_geometric_tactile.nn.pool.ChannelMaxPool` and ReLU.

    A subclass passes a constructor for convolutions and defines :meth:`forward`.

    Args:
        in_channels (int): Number of input features per taxel.
        widths (sequence of int): Width of each convolution.
        pools (sequence of int): Pool size in channels after each convolution.
        conv (callable): Function that returns a convolution for an input width and an output width.
        pool_dim (int): Dimension of the channels in the output of a convolution.
        fast (bool): Whether to use a faster implementation for many samples on one topology on a
            CPU. It returns the same results, but does not support second derivatives.

    Raises:
        ValueError: If there is no layer, the numbers of widths and pool sizes differ, a pool size
            does not divide its width, or a size is below one.

    Examples:
        >>> import torch
        >>> class LinearThread(Thread):
        ...     def forward(self, x):
        ...         for linear, pool in self.layers():
        ...             x = pool(linear(x)).relu()
        ...         return x
        >>> thread = LinearThread(3, widths=(8, 16), pools=(1, 2), conv=torch.nn.Linear)
        >>> thread(torch.zeros(4, 3)).shape
        torch.Size([4, 8])
    """

    def __init__(
        self,
        in_channels: int,
        widths: Sequence[int],
        pools: Sequence[int],
        conv: Callable[[int, int], Module],
        *,
        pool_dim: int = -1,
        fast: bool = True,
    ) -> None:
        super().__init__()
        self.in_channels = in_channels
        self.widths, self.pool_sizes, sizes = checked_widths(in_channels, widths, pools)
        self.out_channels = sizes[-1]
        self.fast = fast
        self.convs = ModuleList(map(conv, sizes, self.widths))
        self.pools = ModuleList(ChannelMaxPool(pool, pool_dim) for pool in self.pool_sizes)

    def reset_parameters(self) -> None:
        r"""Resets all learnable parameters."""
        reset(self.convs)

    def layers(self) -> list[tuple[Any, ChannelMaxPool]]:
        r"""Returns each convolution with the pooling that follows it."""
        return list(zip(self.convs, self.pools, strict=True))  # type: ignore[arg-type]

    @property
    def explained(self) -> bool:
        r"""Whether an explainer is attached. Explainers need the messages of all edges."""
        return any(isinstance(conv, MessagePassing) and conv.explain for conv in self.convs)

    def forward(
        self, x: Tensor, edge_index: OptTensor = None, edge_weight: OptTensor = None
    ) -> Tensor:
        r"""Returns the features of the taxels after the convolutions.

        Args:
            x (torch.Tensor): Features.
            edge_index (torch.Tensor, optional): Edges, for graph convolutions.
            edge_weight (torch.Tensor, optional): Edge weights. Defaults to ones.
        """
        raise NotImplementedError

    def _by_layers(self, x: Tensor, *edges: OptTensor) -> Tensor:
        for conv, pool in self.layers():
            x = pool(conv(x, *edges)).relu()
        return x

    def extra_repr(self) -> str:
        r"""Returns the sizes for :obj:`repr`."""
        return f"{self.in_channels}, widths={self.widths}, pools={self.pool_sizes}"

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.extra_repr()})"
