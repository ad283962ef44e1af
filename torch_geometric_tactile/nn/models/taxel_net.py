r"""The model of tactile readings to begin with."""

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
    level_widths,
    pooled_layouts,
)
from torch_geometric_tactile.nn.models._taxels import (
    check_taxel_dropout,
    load_layout,
    seen_taxels,
    stacked_readings,
)
from torch_geometric_tactile.nn.pool import TaxelPool
from torch_geometric_tactile.sensors import TaxelLayout
from torch_geometric_tactile.sensors._descriptor_tables import (
    DescriptorTables,
    compute_descriptors,
    descriptor_tables,
)

_DIRECT = 128
# Added to the variance of each taxel, where that of a channel is one: the noise of a taxel that is
# hardly ever pressed is not blown up.
_FLOOR = 0.05
_HEADS = {"flat": ("flat",), "mean": ("mean",), "max": ("max",), "all": ("flat", "mean", "max")}


class _DescriptorPath(Module):
    r"""A layer on the descriptors of readings, in which dropped taxels count as missing.

    Shapes:
        - **input:** readings :math:`(B, N, F)`, and which taxels are seen :math:`(B, N)`
        - **output:** :math:`(B, H)`
    """

    def __init__(self, layout: TaxelLayout, in_channels: int, out_channels: int) -> None:
        super().__init__()
        *tables, self.bounds = descriptor_tables(layout)
        for name, table in zip(DescriptorTables._fields, tables, strict=False):
            self.register_buffer(name, table, persistent=False)
        blank = torch.zeros(1, layout.num_taxels, in_channels)
        size = compute_descriptors(blank, self._tables()).size(1)
        self.norm = ReadingNorm(size, _FLOOR)
        self.lin = Linear(size, out_channels, bias=False)
        self.norm_out = TaxelNorm(out_channels)

    def _tables(self) -> DescriptorTables:
        tables = {name: self.get_buffer(name) for name in DescriptorTables._fields[:-1]}
        return DescriptorTables(**tables, bounds=self.bounds)

    def forward(self, x: Tensor, seen: OptTensor = None) -> Tensor:
        r"""Describes readings."""
        if seen is not None:
            x = x.masked_fill(~seen.unsqueeze(-1), torch.nan)
        rows = self.norm(compute_descriptors(x.detach(), self._tables()).unsqueeze(1)).squeeze(1)
        return self.norm_out(self.lin(rows)).relu()


class TaxelNet(BaseModel):
    r"""The first model to try for the readings of any layout: convolutions that use directions,
    with residuals and batch normalisation, pooling over neighbours if the layout is large, and a
    head that uses the features of the single taxels, their mean and their maximum. It is ours, not
    from a paper.

    Levels of blocks, each a :class:`~torch_geometric_tactile.nn.conv.SectorConv`, batch
    normalisation, a residual where widths are equal, and ReLU. Between levels, a
    :class:`~torch_geometric_tactile.nn.pool.TaxelPool` keeps the maximum over about :math:`2
    \times 2` neighbours of a patch, until at most :obj:`max_taxels` are left: never on 24
    electrodes, three times on :math:`28 \times 50` taxels. A hidden layer and the logits follow.

    It finds its neighbours in the layout: :obj:`edge_index` is accepted and not used, and the data
    need not have any. Readings are scaled by batch normalisation with one scale for all taxels of a
    channel, so that raw counts will do; a tare or a common mode before it is the user's choice.

    Args:
        layout (TaxelLayout, str or PathLike): The layout, the name of a stock layout, or the path
            of a layout file.
        out_channels (int): Number of labels or classes :math:`C`.
        in_channels (int): Features of each taxel :math:`F`: its channels, or the frames of each.
        widths (sequence of int, optional): Width of each level, the last for all further ones. If
            left out, 32 without pooling, and 16, 32 and 64 with it.
        depth (int): Blocks of each level; the first of several has one.
        conv (str): :obj:`"sector"`, or :obj:`"self"` and :obj:`"difference"` for the forms of
            :class:`~torch_geometric_tactile.nn.conv.SelfGCNConv`, which know no directions.
        num_sectors (int): Number of directions.
        head (str): What the last level gives: :obj:`"flat"` (all taxels side by side),
            :obj:`"mean"`, :obj:`"max"` or :obj:`"all"` three.
        hidden_channels (int): Width of the hidden layer.
        direct_channels (int, optional): Width of a layer on all readings side by side that joins
            before the hidden layer, as of a fully connected network; 0 for none. If left out, 128
            where nothing is pooled, since small sensors are known by their single taxels, and none
            otherwise.
        descriptor_channels (int): Width of a layer on the descriptors of the readings
            (:func:`~torch_geometric_tactile.sensors.taxel_descriptors`) that joins before the
            hidden layer; 0 for none. It pays with few labels. Zero must then be rest, and the
            readings scaled: :obj:`ZScore(scale_per="channel", with_mean=False)`.
        dropout (float): Part of the features dropped in training before each layer of the head.
        taxel_dropout (float): Part of the taxels that read nothing in training, drawn anew for each
            sample: no answer rests on a few of them.
        max_taxels (int): Number of taxels above which a level is pooled.
        head_taxels (int, optional): Number of taxels above which the last level is pooled once
            more, without convolutions, before the head, as in a convolutional network; if left out,
            it is not.
        num_joints (int): Number of joint angles that join before the hidden layer; 0 for none.
        fast (bool): As of :class:`~torch_geometric_tactile.nn.conv.SectorConv`; without it, there
            are second derivatives.

    Shapes:
        - **input:** readings :math:`(N, F)`, :math:`(B, N, F)` or those of a PyG batch
          :math:`(B \cdot N, F)`; joint angles in radians :math:`(B, J)`
        - **output:** logits :math:`(B, C)`

    Raises:
        ValueError: If :obj:`layout` is a number, :obj:`conv` or :obj:`head` is unknown, a size is
            below one, or :obj:`x` has other taxels or features.

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
        pools = pooled_layouts(layout, max_taxels)
        self.widths = level_widths(widths, 1 + len(pools))
        self.norm = ReadingNorm(in_channels)
        self.levels = ModuleList()
        width = in_channels
        for i, after in enumerate(self.widths):
            blocks = 1 if i == 0 and pools else depth
            pool = pools[i - 1] if i else None
            level = (width, *[after] * blocks)
            on = layout if pool is None else pool.coarse
            self.levels.append(TaxelLevel(on, pool, level, conv, num_sectors, fast))
            width = after
        last_layout = pools[-1].coarse if pools else layout
        self.head_pools = ModuleList(
            [] if head_taxels is None else pooled_layouts(last_layout, head_taxels)
        )
        pools += [pool for pool in self.head_pools if isinstance(pool, TaxelPool)]
        self.taxels = (self.num_nodes, *(pool.num_clusters for pool in pools))
        if direct_channels is None:
            direct_channels = 0 if pools else _DIRECT
        parts = {"flat": self.taxels[-1] * width, "mean": width, "max": width}
        size = sum(parts[part] for part in _HEADS[head])
        size += direct_channels + descriptor_channels + num_joints
        self.direct: Optional[Linear] = None
        if direct_channels:
            direct_size = self.num_nodes * in_channels
            self.norm_readings = ReadingNorm(direct_size, _FLOOR)
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
        given = stacked_readings(x, self.num_nodes, self.in_channels, "features")
        x = self.norm(given)
        seen = seen_taxels(x, self.taxel_dropout if self.training else 0.0)
        h = x if seen is None else x * seen.unsqueeze(-1)
        for level in self.levels:
            h = level(h)
        for pool in self.head_pools:
            h = pool(h)
        parts = {"flat": h.flatten(1), "mean": h.mean(dim=1), "max": h.amax(dim=1)}
        found = [parts[part] for part in _HEADS[self.head]]
        if self.direct is not None:
            rows = self.norm_readings(x.flatten(1).unsqueeze(1)).squeeze(1)
            if seen is not None:  # behind the scale, which is that of all taxels
                rows = (rows.view(x.shape) * seen.unsqueeze(-1)).flatten(1)
            found.append(self.norm_direct(self.direct(rows)).relu())
        if self.described is not None:
            found.append(self.described(given, seen))
        rows = with_joints(self.dropout(torch.cat(found, dim=1)), joint, self.num_joints)
        return self.lin_out(self.dropout(self.norm_hidden(self.lin(rows)).relu()))

    def extra_repr(self) -> str:
        r"""Returns the sizes for :obj:`repr`."""
        joints = f", num_joints={self.num_joints}" if self.num_joints else ""
        return (
            f"{self.num_nodes}, {self.out_channels}, in_channels={self.in_channels}, "
            f"widths={self.widths}, taxels={self.taxels}, head={self.head!r}{joints}"
        )
