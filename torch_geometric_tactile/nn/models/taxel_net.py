r"""The default model for single frames of readings."""

from collections.abc import Sequence
from typing import Literal, Optional, Union

import torch
from torch import Tensor
from torch.nn import Linear, Module, ModuleList
from torch_geometric.typing import OptTensor

from torch_geometric_tactile._checks import need
from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile.nn._sizes import check_sizes
from torch_geometric_tactile.nn.models._base_model import BaseModel
from torch_geometric_tactile.nn.models._inputs import with_joints
from torch_geometric_tactile.nn.models._taxel_levels import (
    CONVS,
    ByteDropout,
    ConvName,
    ReadingNorm,
    TaxelLevel,
    TaxelNorm,
    layout_pools,
    level_widths,
)
from torch_geometric_tactile.nn.models._taxels import (
    check_taxel_dropout,
    load_layout,
    stacked_readings,
    taxel_mask,
)
from torch_geometric_tactile.nn.pool import TaxelPool
from torch_geometric_tactile.sensors import TaxelLayout
from torch_geometric_tactile.sensors._descriptor_tables import (
    DescriptorTables,
    compute_descriptors,
    descriptor_tables,
)

_DIRECT_CHANNELS = 128
# Added to the variance of each taxel, so that the noise of rarely pressed taxels is not amplified.
# The variance of a channel is one.
_VARIANCE_FLOOR = 0.05
# Input features of each head.
_HEADS = {"flat": ("flat",), "mean": ("mean",), "max": ("max",), "all": ("flat", "mean", "max")}


class _DescriptorPath(Module):
    r"""A fully connected layer on the descriptors of readings. Dropped taxels are treated as
    missing.

    Args:
        layout (TaxelLayout): The layout.
        in_channels (int): Number of channels :math:`F`.
        out_channels (int): Width of the layer :math:`H`.

    Shapes:
        - **input:** readings :math:`(B, N, F)`, mask of the taxels :math:`(B, N)`
        - **output:** features :math:`(B, H)`
    """

    def __init__(self, layout: TaxelLayout, in_channels: int, out_channels: int) -> None:
        super().__init__()
        *tables, self.bounds = descriptor_tables(layout)
        for name, table in zip(DescriptorTables._fields, tables, strict=False):
            self.register_buffer(name, table, persistent=False)
        zeros = torch.zeros(1, layout.num_taxels, in_channels)
        size = compute_descriptors(zeros, self._tables()).size(1)
        self.norm = ReadingNorm(size, _VARIANCE_FLOOR)
        self.lin = Linear(size, out_channels, bias=False)
        self.norm_out = TaxelNorm(out_channels)

    def _tables(self) -> DescriptorTables:
        tables = {name: self.get_buffer(name) for name in DescriptorTables._fields[:-1]}
        return DescriptorTables(**tables, bounds=self.bounds)

    def forward(self, x: Tensor, mask: OptTensor = None) -> Tensor:
        r"""Returns the features of the descriptors.

        Args:
            x (torch.Tensor): Readings.
            mask (torch.Tensor, optional): Mask that is true for taxels that are not dropped.
        """
        if mask is not None:
            x = x.masked_fill(~mask.unsqueeze(-1), torch.nan)
        rows = self.norm(compute_descriptors(x.detach(), self._tables()).unsqueeze(1)).squeeze(1)
        return self.norm_out(self.lin(rows)).relu()


class TaxelNet(BaseModel):
    r"""The recommended first model for single frames of readings, for any layout. It has
    convolutions with a separate weight for each direction, and pools neighbouring taxels if the
    layout is large. Its head takes the features of all taxels, their mean and their maximum. It is
    not from a paper.

    The model consists of levels, and each level consists of blocks. A block has a
    :class:`~torch_geometric_tactile.nn.conv.SectorConv`, batch normalisation, a residual connection
    if the widths are equal, and ReLU. Between levels, a
    :class:`~torch_geometric_tactile.nn.pool.TaxelPool` takes the maximum over about
    :math:`2 \times 2` neighbouring taxels of a patch, until at most :obj:`max_taxels` taxels
    remain. For example, 24 electrodes are not pooled, and :math:`28 \times 50` taxels are pooled
    three times. A hidden layer and the logits follow.

    Neighbours are computed from the layout. The argument :obj:`edge_index` is ignored, and the data
    need no edges. Batch normalisation scales the readings, with one scale for all taxels of a
    channel, so that raw counts can be used. If needed, add a transform that tares the readings or
    subtracts the common mode.

    Args:
        layout (TaxelLayout, str or PathLike): The layout, the name of a stock layout, or the path
            of a layout file.
        out_channels (int): Number of labels or classes :math:`C`.
        in_channels (int): Number of features per taxel :math:`F`. These are its channels or, for
            windows, the frames of all channels.
        widths (sequence of int, optional): Width of each level. The last width is repeated for
            further levels. Defaults to 32 without pooling, and to 16, 32 and 64 with pooling.
        depth (int): Number of blocks in each level. If there are several levels, the first level
            has one block.
        conv (str): :obj:`"sector"`, or :obj:`"self"` or :obj:`"difference"` for a
            :class:`~torch_geometric_tactile.nn.conv.SelfGCNConv`, which ignores directions.
        num_sectors (int): Number of directions.
        head (str): Features of the last level that the head uses: :obj:`"flat"` (the features of
            all taxels), their :obj:`"mean"`, their :obj:`"max"`, or :obj:`"all"` three.
        hidden_channels (int): Width of the hidden layer.
        direct_channels (int, optional): Width of an additional fully connected layer on all
            readings, or 0 for none. Its output is appended to the input of the hidden layer.
            Defaults to 128 without pooling, since single taxels are informative on small sensors,
            and to 0 with pooling.
        descriptor_channels (int): Width of an additional layer on the descriptors of the readings
            (:func:`~torch_geometric_tactile.sensors.taxel_descriptors`), or 0 for none. Its output
            is appended to the input of the hidden layer. Useful with few labels. Requires readings
            that are zero at rest; scale them with
            :obj:`ZScore(scale_per="channel", with_mean=False)`.
        dropout (float): Probability of dropping a feature before each layer of the head during
            training.
        taxel_dropout (float): Probability of dropping a taxel of a sample during training, so that
            predictions do not depend on only a few taxels.
        max_taxels (int): Maximum number of taxels in the last level. Larger layouts are pooled.
        head_taxels (int, optional): Maximum number of taxels in the features for the head. If there
            are more, the features are pooled further, without convolutions. By default, they are
            not pooled further.
        num_joints (int): Number of joint angles that are appended to the input of the hidden layer,
            or 0 for none.
        fast (bool): Passed to :class:`~torch_geometric_tactile.nn.conv.SectorConv`. Must be
            :obj:`False` to compute second derivatives.

    Shapes:
        - **input:** readings :math:`(N, F)`, :math:`(B, N, F)` or, for a PyG batch,
          :math:`(B \cdot N, F)`; joint angles in radians :math:`(B, J)`
        - **output:** logits :math:`(B, C)`

    Raises:
        ValueError: If :obj:`layout` is a number, :obj:`conv` or :obj:`head` is unknown, a size is
            below one, or :obj:`x` has the wrong number of taxels or features.

    Examples:
        >>> model = TaxelNet("biotac_sp", 2)
        >>> model
        TaxelNet(24, 2, in_channels=3, widths=(32,), taxels=(24,), head='all')
        >>> model(torch.zeros(5, 24, 3)).shape
        torch.Size([5, 2])
    """

    def __init__(
        self,
        layout: Union[TaxelLayout, PathLike],
        out_channels: int,
        *,
        in_channels: int = 3,
        widths: Optional[Sequence[int]] = None,
        depth: int = 2,
        conv: ConvName = "sector",
        num_sectors: int = 8,
        head: Literal["flat", "mean", "max", "all"] = "all",
        hidden_channels: int = 64,
        direct_channels: Optional[int] = None,
        descriptor_channels: int = 0,
        dropout: float = 0.5,
        taxel_dropout: float = 0.2,
        max_taxels: int = 64,
        head_taxels: Optional[int] = None,
        num_joints: int = 0,
        fast: bool = True,
    ) -> None:
        super().__init__()
        layout = load_layout(layout, "the neighbours of its taxels")
        check_sizes(
            out_channels=out_channels,
            in_channels=in_channels,
            depth=depth,
            num_sectors=num_sectors,
            hidden_channels=hidden_channels,
            max_taxels=max_taxels,
            head_taxels=1 if head_taxels is None else head_taxels,
        )
        for name, size in (
            ("direct_channels", direct_channels or 0),
            ("descriptor_channels", descriptor_channels),
            ("num_joints", num_joints),
        ):
            need(size >= 0, f"'{name}' must not be negative", size)
        need(conv in CONVS, f"'conv' must be one of {CONVS}", repr(conv))
        need(head in _HEADS, f"'head' must be one of {tuple(_HEADS)}", repr(head))
        self.num_nodes = layout.num_taxels
        self.out_channels = out_channels
        self.in_channels = in_channels
        self.head = head
        self.taxel_dropout = check_taxel_dropout(taxel_dropout)
        self.num_joints = num_joints
        pools = layout_pools(layout, max_taxels)
        self.widths = level_widths(widths, 1 + len(pools))
        self.norm = ReadingNorm(in_channels)
        self.levels = ModuleList()
        width = in_channels
        for i, level_width in enumerate(self.widths):
            num_blocks = 1 if i == 0 and pools else depth
            pool = pools[i - 1] if i else None
            block_widths = (width, *[level_width] * num_blocks)
            level_layout = layout if pool is None else pool.coarse
            self.levels.append(
                TaxelLevel(level_layout, pool, block_widths, conv, num_sectors, fast)
            )
            width = level_width
        last_layout = pools[-1].coarse if pools else layout
        self.head_pools = ModuleList(
            [] if head_taxels is None else layout_pools(last_layout, head_taxels)
        )
        pools += [pool for pool in self.head_pools if isinstance(pool, TaxelPool)]
        self.taxels = (self.num_nodes, *(pool.num_clusters for pool in pools))
        if direct_channels is None:
            direct_channels = 0 if pools else _DIRECT_CHANNELS
        feature_sizes = {"flat": self.taxels[-1] * width, "mean": width, "max": width}
        size = sum(feature_sizes[name] for name in _HEADS[head])
        size += direct_channels + descriptor_channels + num_joints
        self.direct: Optional[Linear] = None
        if direct_channels:
            direct_size = self.num_nodes * in_channels
            self.norm_readings = ReadingNorm(direct_size, _VARIANCE_FLOOR)
            self.direct = Linear(direct_size, direct_channels, bias=False)
            self.norm_direct = TaxelNorm(direct_channels)
        self.described: Optional[_DescriptorPath] = None
        if descriptor_channels:
            self.described = _DescriptorPath(layout, in_channels, descriptor_channels)
        self.dropout = ByteDropout(dropout)
        self.lin = Linear(size, hidden_channels, bias=False)
        self.norm_hidden = TaxelNorm(hidden_channels)
        self.lin_out = Linear(hidden_channels, out_channels)

    def _logits(self, x: Tensor, joint: OptTensor = None, **unused: OptTensor) -> Tensor:
        readings = stacked_readings(x, self.num_nodes, self.in_channels, "features")
        x = self.norm(readings)
        mask = taxel_mask(x, self.taxel_dropout if self.training else 0.0)
        h = x if mask is None else x * mask.unsqueeze(-1)
        for level in self.levels:
            h = level(h)
        for pool in self.head_pools:
            h = pool(h)
        pooled = {"flat": h.flatten(1), "mean": h.mean(dim=1), "max": h.amax(dim=1)}
        features = [pooled[name] for name in _HEADS[self.head]]
        if self.direct is not None:
            rows = self.norm_readings(x.flatten(1).unsqueeze(1)).squeeze(1)
            if mask is not None:  # after scaling, so that dropped taxels do not change the scale
                rows = (rows.view(x.shape) * mask.unsqueeze(-1)).flatten(1)
            features.append(self.norm_direct(self.direct(rows)).relu())
        if self.described is not None:
            features.append(self.described(readings, mask))
        rows = with_joints(self.dropout(torch.cat(features, dim=1)), joint, self.num_joints)
        return self.lin_out(self.dropout(self.norm_hidden(self.lin(rows)).relu()))

    def extra_repr(self) -> str:
        r"""Returns the sizes for :obj:`repr`."""
        joints = f", num_joints={self.num_joints}" if self.num_joints else ""
        return (
            f"{self.num_nodes}, {self.out_channels}, in_channels={self.in_channels}, "
            f"widths={self.widths}, taxels={self.taxels}, head={self.head!r}{joints}"
        )
