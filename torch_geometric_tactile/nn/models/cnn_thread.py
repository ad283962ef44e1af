r"""A thread of convolutions on the image map of a hand."""

from collections.abc import Sequence

from torch import Tensor
from torch.nn import Conv2d
from torch_geometric.typing import OptTensor

from torch_geometric_tactile.nn.models._thread_widths import POOLS, WIDTHS
from torch_geometric_tactile.nn.models.thread import Thread


class CNNThread(Thread):
    r"""A thread of convolutions on the image map of a hand, with the same default widths and pool
    sizes as :class:`~torch_geometric_tactile.nn.models.GCNThread`. Each convolution has 3 x 3
    filters and zero padding, and is followed by a
    :class:`~torch_geometric_tactile.nn.pool.ChannelMaxPool` and ReLU. Cells without a taxel are
    zero in the input and are not part of the output.

    Args:
        in_channels (int): Number of input features per taxel.
        image_map (torch.Tensor): Row and column of each taxel :math:`(N, 2)`.
        widths (sequence of int): Width of each convolution.
        pools (sequence of int): Pool size in channels after each convolution.

    Shapes:
        - **input:** features :math:`(B, N, F)`
        - **output:** features :math:`(B, N, F')`

    Raises:
        ValueError: If a pool size does not divide its width, the numbers of widths and pool sizes
            differ, or :obj:`x` has the wrong number of taxels or channels.

    Examples:
        >>> import torch
        >>> image_map = torch.tensor([[0, 0], [0, 1], [1, 0], [1, 1]])
        >>> thread = CNNThread(3, image_map, widths=(4, 8), pools=(1, 2))
        >>> thread(torch.randn(5, 4, 3)).shape
        torch.Size([5, 4, 4])
    """

    cell: Tensor

    def __init__(
        self,
        in_channels: int,
        image_map: Tensor,
        widths: Sequence[int] = WIDTHS,
        pools: Sequence[int] = POOLS,
    ) -> None:
        super().__init__(in_channels, widths, pools, _padded_conv, pool_dim=1)
        self.size = tuple((image_map.amax(dim=0) + 1).tolist())
        cell = image_map[:, 0] * self.size[1] + image_map[:, 1]
        self.register_buffer("cell", cell, persistent=False)

    def forward(
        self, x: Tensor, edge_index: OptTensor = None, edge_weight: OptTensor = None
    ) -> Tensor:
        r"""Returns the features of the taxels after the convolutions.

        Args:
            x (torch.Tensor): Features.
            edge_index (torch.Tensor, optional): Not used, since the image map defines the
                neighbours.
            edge_weight (torch.Tensor, optional): Not used.
        """
        if x.dim() != 3 or x.size(1) != len(self.cell) or x.size(2) != self.in_channels:
            raise ValueError(
                f"'x' must have shape (batch_size, {len(self.cell)}, {self.in_channels}) "
                f"(got {tuple(x.shape)})"
            )
        rows, columns = self.size
        image = x.new_zeros(x.size(0), x.size(2), rows * columns)
        image = image.index_copy(2, self.cell, x.transpose(1, 2)).unflatten(2, (rows, columns))
        for conv, pool in self.layers():
            image = pool(conv(image)).relu()
        return image.flatten(2)[:, :, self.cell].transpose(1, 2)

    def extra_repr(self) -> str:
        r"""Returns the sizes for :obj:`repr`."""
        return f"{super().extra_repr()}, size={self.size}"


def _padded_conv(in_channels: int, out_channels: int) -> Conv2d:
    return Conv2d(in_channels, out_channels, 3, padding="same")
