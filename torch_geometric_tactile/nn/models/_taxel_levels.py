r"""Parts of :class:`~torch_geometric_tactile.nn.models.TaxelNet`: levels of increasingly coarse
layouts, blocks of convolutions on them, normalisation and dropout."""

from collections.abc import Sequence
from itertools import pairwise
from typing import Any, Literal

import torch
from torch import Tensor
from torch.nn import BatchNorm1d, Dropout, Module
from torch.nn.functional import batch_norm
from torch_geometric.typing import OptTensor

from torch_geometric_tactile.nn._sizes import checked_layer_widths
from torch_geometric_tactile.nn.conv import SectorConv, SelfGCNConv
from torch_geometric_tactile.nn.pool import TaxelPool
from torch_geometric_tactile.sensors import TaxelLayout, layout_sectors

ConvName = Literal["sector", "self", "difference"]
CONVS = ("sector", "self", "difference")


class TaxelNorm(BatchNorm1d):
    r"""Batch normalisation of each channel over all samples and taxels, so that all taxels of a
    channel share one scale. A single row has no variance and is scaled with the running statistics.
    Masked rows are left out of the statistics.

    Shapes:
        - **input:** features :math:`(B, N, F)` or :math:`(B, F)`
        - **output:** features of the same shape
    """

    def forward(self, input: Tensor, mask: OptTensor = None) -> Tensor:
        r"""Returns the normalised features.

        Args:
            input (torch.Tensor): Features.
            mask (torch.Tensor, optional): Whether each row is part of the statistics
                :math:`(B, N, 1)`. By default, all rows are.
        """
        if self.training and mask is not None:
            return self._normalize_masked(input, mask)
        # Some convolutions return features in the memory order (N, B, F). Keeping this order avoids
        # a copy.
        is_taxel_major = input.dim() == 3 and not input.is_contiguous()
        rows = input.transpose(0, 1) if is_taxel_major else input
        flat = rows.reshape(-1, rows.size(-1))
        if self.training and flat.size(0) > 1:
            out = super().forward(flat)
        else:
            out = batch_norm(
                flat, self.running_mean, self.running_var, self.weight, self.bias, eps=self.eps
            )
        out = out.view(rows.shape)
        return out.transpose(0, 1) if is_taxel_major else out

    def _normalize_masked(self, input: Tensor, mask: Tensor) -> Tensor:
        norm: Any = self  # typed as Any, since PyTorch's buffers and momentum may be None
        count, mean, var = _masked_moments(input, mask, norm.running_mean, norm.running_var)
        with torch.no_grad():
            norm.num_batches_tracked += count > 1
            # With fewer than two rows, the running statistics do not change.
            step = (count > 1).to(mean) * norm.momentum
            norm.running_mean.lerp_(mean, step)
            norm.running_var.lerp_(var * (count / (count - 1).clamp(min=1)), step)
        return (input - mean) * ((var + self.eps).rsqrt() * self.weight) + self.bias


class ReadingNorm(Module):
    r"""Scales each channel of readings to mean zero and standard deviation one over all samples and
    taxels. During training, it uses the statistics of the batch. In evaluation, it uses their
    average over all training batches. Unlike a moving average, this average is correct after a
    single batch, so that raw counts are scaled correctly from the start.

    Args:
        num_features (int): Number of channels :math:`F`.
        eps (float): Constant added to the variance.

    Shapes:
        - **input:** readings :math:`(B, N, F)`
        - **output:** readings of the same shape
    """

    running_mean: Tensor
    running_var: Tensor
    num_batches_tracked: Tensor

    def __init__(self, num_features: int, eps: float = 1e-6) -> None:
        super().__init__()
        self.eps = eps
        self.register_buffer("running_mean", torch.zeros(num_features))
        self.register_buffer("running_var", torch.ones(num_features))
        self.register_buffer("num_batches_tracked", torch.zeros((), dtype=torch.long))

    def reset_parameters(self) -> None:
        r"""Resets the running statistics."""
        self.running_mean.zero_()
        self.running_var.fill_(1.0)
        self.num_batches_tracked.zero_()

    def forward(self, x: Tensor, mask: OptTensor = None) -> Tensor:
        r"""Returns the scaled readings.

        Args:
            x (torch.Tensor): Readings.
            mask (torch.Tensor, optional): Whether each row is part of the statistics
                :math:`(B, N, 1)`. By default, all rows are.
        """
        mean, var = self.running_mean, self.running_var
        if self.training and x.size(0) * x.size(1) > 1:
            is_counted = torch.ones_like(self.num_batches_tracked)
            if mask is None:
                var, mean = torch.var_mean(x, dim=(0, 1), correction=0)
            else:
                count, mean, var = _masked_moments(x, mask, mean, var)
                is_counted = count > 1
            with torch.no_grad():
                self.num_batches_tracked += is_counted
                step = is_counted.to(mean) / self.num_batches_tracked.clamp(min=1)
                self.running_mean.lerp_(mean, step)
                self.running_var.lerp_(var, step)
        return (x - mean) * (var + self.eps).rsqrt()


def _masked_moments(
    rows: Tensor, mask: Tensor, default_mean: Tensor, default_var: Tensor
) -> tuple[Tensor, Tensor, Tensor]:
    # Returns the number of rows in the mask, their mean and their variance. With fewer than two
    # rows, the default mean and variance are returned. Rows are weighted instead of selected, since
    # a compiler cannot know the size of a selection.
    weight = mask.to(default_mean.dtype)
    count = weight.sum()
    mean = (rows * weight).sum(dim=(0, 1)) / count.clamp(min=1)
    var = ((rows - mean).square() * weight).sum(dim=(0, 1)) / count.clamp(min=1)
    return (
        count,
        torch.where(count > 1, mean, default_mean),
        torch.where(count > 1, var, default_var),
    )


class TaxelBlock(Module):
    r"""A convolution, :class:`TaxelNorm`, a residual connection if the widths are equal, and ReLU.

    Args:
        in_channels (int): Size of each input feature.
        out_channels (int): Size of each output feature.
        conv (str): :obj:`"sector"`, :obj:`"self"` or :obj:`"difference"`.
        num_sectors (int): Number of sectors.
        fast (bool): Argument of the convolution.
    """

    def __init__(
        self, in_channels: int, out_channels: int, conv: ConvName, num_sectors: int, fast: bool
    ) -> None:
        super().__init__()
        self.conv: Module
        if conv == "sector":
            self.conv = SectorConv(in_channels, out_channels, num_sectors, bias=False, fast=fast)
        else:
            self.conv = SelfGCNConv(
                in_channels, out_channels, conv == "difference", bias=False, fast=fast
            )
        self.norm = TaxelNorm(out_channels)
        self.is_residual = in_channels == out_channels

    def forward(self, x: Tensor, *edges: Tensor) -> Tensor:
        r"""Returns the output :math:`(B, N, F')` for node features :math:`(B, N, F)`."""
        out = self.norm(self.conv(x, *edges))
        return (x + out).relu() if self.is_residual else out.relu()


class TaxelLevel(Module):
    r"""Pooling to a layout, followed by blocks on this layout.

    Args:
        layout (TaxelLayout): The layout.
        pool (TaxelPool, optional): Pooling from the finer layout.
        widths (tuple of int): Widths before the first block and after each block.
        conv (str): :obj:`"sector"`, :obj:`"self"` or :obj:`"difference"`.
        num_sectors (int): Number of sectors.
        fast (bool): Argument of the convolutions.
    """

    def __init__(
        self,
        layout: TaxelLayout,
        pool: TaxelPool | None,
        widths: tuple[int, ...],
        conv: ConvName,
        num_sectors: int,
        fast: bool,
    ) -> None:
        super().__init__()
        with torch.device("cpu"):  # on the meta device, edges would lose their values
            edge_index, sector = layout_sectors(layout, num_sectors)
        # Not saved in the state, since they are computed from the layout.
        self.register_buffer("edge_index", edge_index, persistent=False)
        self.register_buffer("sector", sector, persistent=False)
        self.pool = pool
        self.needs_sector = conv == "sector"
        self.blocks = torch.nn.ModuleList(
            TaxelBlock(in_width, out_width, conv, num_sectors, fast)
            for in_width, out_width in pairwise(widths)
        )

    def forward(self, x: Tensor) -> Tensor:
        r"""Returns the output :math:`(B, M, F')` for node features :math:`(B, N, F)`."""
        if self.pool is not None:
            x = self.pool(x)
        edges: tuple[Any, ...] = (self.edge_index,)
        if self.needs_sector:
            edges = (self.edge_index, self.sector)
        for block in self.blocks:
            x = block(x, *edges)
        return x


def layout_pools(layout: TaxelLayout, max_taxels: int) -> list[TaxelPool]:
    r"""Returns a sequence of poolings over :math:`2 \times 2` neighbours. The last one yields a
    layout with at most :obj:`max_taxels` taxels, or a layout that cannot be pooled further.
    """
    pools: list[TaxelPool] = []
    with torch.device("cpu"):
        while layout.num_taxels > max_taxels:
            x_pitch, y_pitch = pitch(layout)
            pool = TaxelPool(layout, (2 * x_pitch, 2 * y_pitch))
            if pool.num_clusters == layout.num_taxels:  # each patch has only one taxel
                break
            pools.append(pool)
            layout = pool.coarse
    return pools


def level_widths(widths: Sequence[int] | None, num_levels: int) -> tuple[int, ...]:
    r"""Returns the width of each level. The last width is repeated for further levels. If
    :obj:`widths` is :obj:`None`, the defaults are returned.
    """
    if widths is None:
        widths = (32,) if num_levels == 1 else (16, 32, 64)
    widths = checked_layer_widths(widths)
    return (*widths, *[widths[-1]] * num_levels)[:num_levels]


def pitch(layout: TaxelLayout) -> tuple[float, float]:
    r"""Returns the median distances in metres between neighbouring taxels along :math:`x` and
    :math:`y`. If there are neighbours along only one axis, their distance is returned for both
    axes.
    """
    edge_index, sector = layout_sectors(layout, 4)
    length = (layout.pos[edge_index[0]] - layout.pos[edge_index[1]]).norm(dim=1)
    lengths_by_axis = [length[sector % 2 == axis] for axis in range(2)]
    pitches = [float(lengths.median()) for lengths in lengths_by_axis if len(lengths)]
    if not pitches:
        return 1.0, 1.0  # without neighbours, pooling has no effect at any length
    return pitches[0], pitches[-1]


class ByteDropout(Dropout):
    r"""A faster :class:`torch.nn.Dropout`. On a CPU, it takes less than half as long, since one
    random 64-bit number decides on eight features. The probability is rounded to a multiple of
    1/256, and the remaining features are scaled accordingly.

    Shapes:
        - **input:** features of any shape
        - **output:** features of the same shape
    """

    def forward(self, input: Tensor) -> Tensor:
        r"""Returns the features, with dropped features set to zero.

        Args:
            input (torch.Tensor): Features.
        """
        threshold = round(256 * self.p)
        if (
            not self.training
            or input.device.type != "cpu"
            or not 0 < threshold < 256
            or torch.compiler.is_compiling()
        ):
            return super().forward(input)
        words = torch.empty(-(-input.numel() // 8), dtype=torch.long)
        # Uses the full range of integers, so that all bits are random.
        words.random_(torch.iinfo(torch.long).min, None)
        mask = words.view(torch.uint8)[: input.numel()].view(input.shape) >= threshold
        return input * mask.to(input.dtype).mul_(256 / (256 - threshold))
