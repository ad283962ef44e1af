r"""A residual convolutional network over time."""

from collections.abc import Sequence
from itertools import pairwise
from numbers import Integral

import torch
from torch import Tensor
from torch.nn import BatchNorm1d, Conv1d, Dropout, Identity, Linear, Module, ModuleList, Sequential
from torch_geometric.typing import OptTensor

from torch_geometric_tactile._checks import need
from torch_geometric_tactile.data import split_frames
from torch_geometric_tactile.nn._sizes import check_sizes, checked_layer_widths
from torch_geometric_tactile.nn.models._base_model import BaseModel
from torch_geometric_tactile.nn.models._taxels import LayoutLike, count_taxels, stacked_readings


class _ResidualBlock(Module):
    r"""Convolutions over time with batch normalisation and ReLU, and a residual connection before
    the last ReLU. If the widths differ, the connection contains a linear map.

    Args:
        in_channels (int): Size of each input feature.
        out_channels (int): Size of each output feature.
        kernel_sizes (sequence of int): Length of each convolution in frames.
    """

    def __init__(self, in_channels: int, out_channels: int, kernel_sizes: Sequence[int]) -> None:
        super().__init__()
        widths = [in_channels, *[out_channels] * len(kernel_sizes)]
        self.convs = ModuleList(
            Conv1d(in_width, out_width, size, padding=size // 2, bias=False)
            for (in_width, out_width), size in zip(pairwise(widths), kernel_sizes, strict=True)
        )
        self.norms = ModuleList(BatchNorm1d(out_channels) for _ in kernel_sizes)
        self.shortcut: Module = Identity()
        if in_channels != out_channels:
            conv = Conv1d(in_channels, out_channels, 1, bias=False)
            self.shortcut = Sequential(conv, BatchNorm1d(out_channels))

    def forward(self, x: Tensor) -> Tensor:
        r"""Returns the output :math:`(B, F', T)` for signals :math:`(B, F, T)`."""
        h = x
        for i, (conv, norm) in enumerate(zip(self.convs, self.norms, strict=True)):
            h = norm(conv(h))
            if i + 1 < len(self.convs):
                h = h.relu()
        return (h + self.shortcut(x)).relu()


class TemporalCNN(BaseModel):
    r"""The residual network from the `"Time Series Classification from Scratch with Deep Neural
    Networks: A Strong Baseline" <https://arxiv.org/abs/1611.06455>`_ paper (Wang et al., 2017),
    applied to the concatenated readings of all taxels. Use it as a baseline for windows with one
    label.

    It has residual blocks of convolutions over time, each with batch normalisation and ReLU. The
    logits are computed from the mean over the frames, as in the paper, and from the maximum, which
    is not in the paper. No graph is used. Windows may have any number of frames.

    Args:
        layout (TaxelLayout, int, str or PathLike): The layout, the name of a stock layout, the path
            of a layout file, or the number of taxels :math:`N`.
        out_channels (int): Number of labels or classes :math:`O`.
        in_channels (int): Number of channels per taxel in one frame :math:`C`.
        widths (sequence of int): Width of each block (64, 128 and 128 in the paper).
        kernel_sizes (sequence of int): Length of each convolution of a block in frames (8, 5 and 3
            in the paper). Must be odd.
        dropout (float): Probability of dropping a pooled feature during training.

    Shapes:
        - **input:** windows :math:`(N, C \cdot T)`, :math:`(B, N, C \cdot T)` or, for a PyG batch,
          :math:`(B \cdot N, C \cdot T)`, with the frames of each channel side by side
        - **output:** logits :math:`(B, O)`

    Raises:
        ValueError: If a size is below one, a kernel size is even, or :obj:`x` has the wrong number
            of taxels or a number of columns that is not a multiple of :math:`C`.

    Examples:
        >>> model = TemporalCNN("biotac", 2, in_channels=3)
        >>> model
        TemporalCNN(19, 2, in_channels=3, widths=(64, 64, 64), kernel_sizes=(7, 5))
        >>> model(torch.zeros(5, 19, 3 * 60)).shape
        torch.Size([5, 2])
    """

    needs_edges = False
    splits_frames = True  # `in_channels` is the number of channels in one frame

    def __init__(
        self,
        layout: LayoutLike,
        out_channels: int,
        *,
        in_channels: int = 1,
        widths: Sequence[int] = (64, 64, 64),
        kernel_sizes: Sequence[int] = (7, 5),
        dropout: float = 0.0,
    ) -> None:
        super().__init__()
        self.num_nodes = count_taxels(layout)
        check_sizes(out_channels=out_channels, in_channels=in_channels)
        self.out_channels = out_channels
        self.in_channels = in_channels
        self.widths = checked_layer_widths(widths)
        self.kernel_sizes = tuple(kernel_sizes)
        are_odd = all(
            isinstance(size, Integral) and size >= 1 and size % 2 for size in self.kernel_sizes
        )
        need(
            self.kernel_sizes and are_odd,
            "'kernel_sizes' must be odd numbers of frames",
            self.kernel_sizes,
        )
        block_widths = pairwise((self.num_nodes * in_channels, *self.widths))
        self.blocks = ModuleList(
            _ResidualBlock(in_width, out_width, self.kernel_sizes)
            for in_width, out_width in block_widths
        )
        self.dropout = Dropout(dropout)
        self.lin_out = Linear(2 * self.widths[-1], out_channels)

    def _logits(self, x: Tensor, **unused: OptTensor) -> Tensor:
        size = x.size(-1) if x.dim() else 0
        need(
            size > 0 and size % self.in_channels == 0,
            f"'x' must have the same number of frames, at least one, for each of "
            f"{self.in_channels} channels",
            f"shape {tuple(x.shape)}",
        )
        x = stacked_readings(x, self.num_nodes, size, "features")
        frames = split_frames(x, size // self.in_channels)  # (B, N, T, C)
        h = frames.transpose(2, 3).flatten(1, 2)
        for block in self.blocks:
            h = block(h)
        pooled = torch.cat([h.mean(dim=2), h.amax(dim=2)], dim=1)
        return self.lin_out(self.dropout(pooled))

    def extra_repr(self) -> str:
        r"""Returns the sizes for :obj:`repr`."""
        return (
            f"{self.num_nodes}, {self.out_channels}, in_channels={self.in_channels}, "
            f"widths={self.widths}, kernel_sizes={self.kernel_sizes}"
        )
