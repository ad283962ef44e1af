r"""What :class:`~torch_geometric_tactile.nn.models.TaxelNet` is made of: levels of a layout, each
coarser than the one before, and the blocks of convolutions on them."""

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
    channel share one scale. The numbers of a single row are scaled as in evaluation, since they
    have no spread. Rows that are not kept do not count.

    Shapes:
        - **input:** features :math:`(B, N, F)` or :math:`(B, F)`
        - **output:** likewise
    """

    def forward(self, input: Tensor, kept: OptTensor = None) -> Tensor:
        r"""Scales features.

        Shapes:
            - **kept:** Which rows count :math:`(B, N, 1)`; all if left out.
        """
        if self.training and kept is not None:
            return self._scaled_by_kept(input, kept)
        # In the order in which the convolutions leave them: nothing is copied.
        swapped = input.dim() == 3 and not input.is_contiguous()
        rows = input.transpose(0, 1) if swapped else input
        flat = rows.reshape(-1, rows.size(-1))
        if self.training and flat.size(0) > 1:
            out = super().forward(flat)
        else:
            out = batch_norm(
                flat, self.running_mean, self.running_var, self.weight, self.bias, eps=self.eps
            )
        out = out.view(rows.shape)
        return out.transpose(0, 1) if swapped else out

    def _scaled_by_kept(self, input: Tensor, kept: Tensor) -> Tensor:
        own: Any = self  # whose buffers and momentum may be None in general
        count, mean, var = _kept_moments(input, kept, own.running_mean, own.running_var)
        with torch.no_grad():
            own.num_batches_tracked += count > 1
            part = (count > 1).to(mean) * own.momentum
            own.running_mean.lerp_(mean, part)
            own.running_var.lerp_(var * (count / (count - 1).clamp(min=1)), part)
        return (input - mean) * ((var + self.eps).rsqrt() * self.weight) + self.bias


class ReadingNorm(Module):
    r"""Scales each channel of readings to mean zero and standard deviation one over all samples and
    taxels: of the batch in training, and of all batches so far in evaluation, each of which counts
    the same. After a single batch, raw counts are scaled as they should be.

    Shapes:
        - **input:** readings :math:`(B, N, F)`
        - **output:** likewise
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
        r"""Forgets what was seen."""
        self.running_mean.zero_()
        self.running_var.fill_(1.0)
        self.num_batches_tracked.zero_()

    def forward(self, x: Tensor, kept: OptTensor = None) -> Tensor:
        r"""Scales readings.

        Shapes:
            - **kept:** Which rows count :math:`(B, N, 1)`; all if left out.
        """
        mean, var = self.running_mean, self.running_var
        if self.training and x.size(0) * x.size(1) > 1:
            many = torch.ones_like(self.num_batches_tracked)
            if kept is None:
                var, mean = torch.var_mean(x, dim=(0, 1), correction=0)
            else:
                count, mean, var = _kept_moments(x, kept, mean, var)
                many = count > 1
            with torch.no_grad():
                self.num_batches_tracked += many
                part = many.to(mean) / self.num_batches_tracked.clamp(min=1)
                self.running_mean.lerp_(mean, part)
                self.running_var.lerp_(var, part)
        return (x - mean) * (var + self.eps).rsqrt()


def _kept_moments(
    rows: Tensor, kept: Tensor, mean: Tensor, var: Tensor
) -> tuple[Tensor, Tensor, Tensor]:
    # How many rows are kept, and their mean and variance; the given ones if there is one at most.
    # Sums, not indices: the shape of the rows kept is not known to a compiler.
    weight = kept.to(mean.dtype)
    count = weight.sum()
    found = (rows * weight).sum(dim=(0, 1)) / count.clamp(min=1)
    spread = ((rows - found).square() * weight).sum(dim=(0, 1)) / count.clamp(min=1)
    return count, torch.where(count > 1, found, mean), torch.where(count > 1, spread, var)


class TaxelBlock(Module):
    r"""A convolution, :class:`TaxelNorm`, the input added where the widths are equal, and ReLU."""

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
        r"""Convolves node features :math:`(B, N, F)`."""
        out = self.norm(self.conv(x, *edges))
        return (x + out).relu() if self.is_residual else out.relu()


class TaxelLevel(Module):
    r"""Blocks on one layout, after the pooling that leads to it."""

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
        with torch.device("cpu"):  # on the meta device, edges would lose their numbers
            edge_index, sector = layout_sectors(layout, num_sectors)
        # Not in the state: they follow from the layout.
        self.register_buffer("edge_index", edge_index, persistent=False)
        self.register_buffer("sector", sector, persistent=False)
        self.pool = pool
        self.needs_sector = conv == "sector"
        self.blocks = torch.nn.ModuleList(
            TaxelBlock(before, after, conv, num_sectors, fast) for before, after in pairwise(widths)
        )

    def forward(self, x: Tensor) -> Tensor:
        r"""Pools and convolves node features :math:`(B, N, F)`."""
        if self.pool is not None:
            x = self.pool(x)
        edges: tuple[Any, ...] = (self.edge_index,)
        if self.needs_sector:
            edges = (self.edge_index, self.sector)
        for block in self.blocks:
            x = block(x, *edges)
        return x


def pooled_layouts(layout: TaxelLayout, max_taxels: int) -> list[TaxelPool]:
    r"""Returns the poolings over :math:`2 \times 2` neighbours that lead to a layout with at most
    so many taxels, or to one that cannot be pooled further.
    """
    pools: list[TaxelPool] = []
    with torch.device("cpu"):
        while layout.num_taxels > max_taxels:
            along, across = pitch(layout)
            pool = TaxelPool(layout, (2 * along, 2 * across))
            if pool.num_clusters == layout.num_taxels:  # patches of a single taxel
                break
            pools.append(pool)
            layout = pool.coarse
    return pools


def level_widths(widths: Sequence[int] | None, num_levels: int) -> tuple[int, ...]:
    r"""Returns the width of each level."""
    if widths is None:
        widths = (32,) if num_levels == 1 else (16, 32, 64)
    widths = checked_layer_widths(widths)
    return (*widths, *[widths[-1]] * num_levels)[:num_levels]


def pitch(layout: TaxelLayout) -> tuple[float, float]:
    r"""Returns the distances between neighbouring taxels along :math:`x` and :math:`y` in metres:
    the medians over the neighbours in these directions.
    """
    edge_index, sector = layout_sectors(layout, 4)
    length = (layout.pos[edge_index[0]] - layout.pos[edge_index[1]]).norm(dim=1)
    parts = [length[sector % 2 == axis] for axis in range(2)]
    found = [float(part.median()) for part in parts if len(part)]
    if not found:
        return 1.0, 1.0  # no taxel has a neighbour: any length will do
    return found[0], found[-1]


class ByteDropout(Dropout):
    r"""Drops features in training as :class:`torch.nn.Dropout` does, in less than half the time on
    a processor, where eight draws are made of one random number. Probabilities are rounded to a
    256th, and what is kept is scaled by the probability that was drawn by.

    Shapes:
        - **input:** any shape
        - **output:** likewise
    """

    def forward(self, input: Tensor) -> Tensor:
        r"""Drops features."""
        threshold = round(256 * self.p)
        if (
            not self.training
            or input.device.type != "cpu"
            or not 0 < threshold < 256
            or torch.compiler.is_compiling()
        ):
            return super().forward(input)
        words = torch.empty(-(-input.numel() // 8), dtype=torch.long)
        # From the least to the greatest number there is, so that all bits are drawn.
        words.random_(torch.iinfo(torch.long).min, None)
        kept = words.view(torch.uint8)[: input.numel()].view(input.shape) >= threshold
        return input * kept.to(input.dtype).mul_(256 / (256 - threshold))
