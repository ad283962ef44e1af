r"""The maximum over neighbouring channels."""

import torch
from torch import Tensor

from torch_geometric_tactile.nn._sizes import check_sizes


class ChannelMaxPool(torch.nn.Module):
    r"""Max pooling over feature channels, from the "Tactile Object Property Recognition using
    Geometrical Graph Edge Features and Multi-Thread Graph Convolutional Network" paper, where it is
    denoted by "(P)". For each taxel, it returns the maximum of every :obj:`kernel_size`
    neighbouring channels.

    .. math::
        x'_c = \max_{0 \le j < k} x_{k c + j}

    Args:
        kernel_size (int): Number of channels in each pool :math:`k`.
        dim (int): Dimension of the channels.

    Shapes:
        - **input:** features :math:`(*, F)`, or with the channels :math:`F` at :obj:`dim`
        - **output:** features :math:`(*, F / k)`, with the channels at :obj:`dim`

    Raises:
        ValueError: If :obj:`kernel_size` is below one or does not divide the number of channels.

    Examples:
        >>> ChannelMaxPool(2)(torch.tensor([[1.0, 4.0, 3.0, 2.0]]))
        tensor([[4., 3.]])
    """

    def __init__(self, kernel_size: int, dim: int = -1) -> None:
        super().__init__()
        check_sizes(kernel_size=kernel_size)
        self.kernel_size = kernel_size
        self.dim = dim

    def forward(self, x: Tensor) -> Tensor:
        r"""Returns the maximum of each group of neighbouring channels.

        Args:
            x (torch.Tensor): Features.
        """
        num_channels = x.size(self.dim)
        if num_channels % self.kernel_size:
            raise ValueError(
                f"'x' must have a multiple of {self.kernel_size} channels (got {num_channels})"
            )
        if self.kernel_size == 1:
            return x
        dim = self.dim % x.dim()
        size = (num_channels // self.kernel_size, self.kernel_size)
        return x.unflatten(dim, size).amax(dim=dim + 1)

    def __repr__(self) -> str:
        dim = "" if self.dim == -1 else f", dim={self.dim}"
        return f"{type(self).__name__}({self.kernel_size}{dim})"
