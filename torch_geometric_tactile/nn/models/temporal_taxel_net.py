r"""The model of windows of frames to begin with."""

from collections.abc import Sequence
from typing import Literal, Optional, Union

import torch
from torch import Tensor
from torch.nn import ModuleList
from torch_geometric.typing import OptTensor

from torch_geometric_tactile._checks import need
from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile.data import split_frames
from torch_geometric_tactile.nn._sizes import check_sizes
from torch_geometric_tactile.nn.models._base_model import BaseModel
from torch_geometric_tactile.nn.models._taxel_levels import (
    CONVS,
    ConvName,
    ReadingNorm,
    TaxelLevel,
    level_widths,
    pooled_layouts,
)
from torch_geometric_tactile.nn.models._taxels import (
    check_taxel_dropout,
    load_layout,
    seen_taxels,
    stacked_readings,
)
from torch_geometric_tactile.nn.models._temporal_blocks import (
    FrameFilters,
    FrameHead,
    TemporalBlock,
    in_frames,
)
from torch_geometric_tactile.sensors import TaxelLayout

# The past frames that each convolution over time has seen.
_TemporalState = tuple[Tensor, ...]
_POOLS = ("last", "mean", "max", "mean_max")
_NEEDS_LAST = "'pool' must be 'last' for '{}', which answers frame by frame"


class TemporalTaxelNet(BaseModel):
    r"""The first model to try for windows of frames of any layout, and frame by frame on a robot:
    convolutions over neighbouring taxels and causal convolutions over time. It is ours, not from
    a paper.

    Filters of :obj:`filter_size` frames see the readings of each taxel, so that an offset of a
    taxel need not hide what changes. Levels of :class:`~torch_geometric_tactile.nn.conv.SectorConv`
    with pooling between them follow in each frame, as of
    :class:`~torch_geometric_tactile.nn.models.TaxelNet`. Then come blocks of
    :class:`~torch_geometric_tactile.nn.conv.CausalTemporalConv` over the features of each taxel,
    with dilations :math:`D, 2 D, 4 D` and so on and residuals. All taxels side by side, their mean
    and their maximum go through a hidden layer to the logits of a frame.

    An answer rests on :obj:`receptive_field` frames,

    .. math::
        R = F + (K - 1) D (2^L - 1)

    with filters of :math:`F` frames and :math:`L` blocks of kernel size :math:`K`; before the first
    frame, all features are zero. By default, the answer of a window is that of its last frame, for
    which only the features that it rests on are computed: every :math:`D`-th frame, then every
    :math:`2 D`-th, and so on. With :obj:`per_frame`, all are.

    A window or trial that is **judged as a whole**, such as a slide over a surface, needs other
    settings: :obj:`pool="mean_max"` answers from the mean and the maximum of the features over the
    frames, of which every :math:`D`-th is computed. With :obj:`mixed_channels`, the blocks do not
    look at each taxel by itself: a convolution over :math:`K` frames, which adds :math:`K - 1` to
    :math:`R`, joins the features of all taxels first.

    :meth:`step` takes one frame and a state, a tuple of tensors. From :meth:`initial_state` on it
    gives the numbers of :meth:`forward` on the same frames, and after :math:`R` frames those of any
    window that ends here and has at least :math:`R`.

    It finds its neighbours in the layout: :obj:`edge_index` is accepted and not used. Readings are
    scaled by batch normalisation with one scale for all taxels of a channel, so that raw counts
    will do. Missing readings (NaN) have to be filled before.

    Args:
        layout (TaxelLayout, str or PathLike): The layout, the name of a stock layout, or the path
            of a layout file.
        out_channels (int): Number of labels or classes.
        in_channels (int): Channels of each taxel in one frame :math:`C`: axes or fingers.
        num_filters (int, optional): Number of filters of the readings. If :obj:`None`, the readings
            themselves go into the first level, and :math:`F = 1`.
        filter_size (int): Length of the filters in frames :math:`F`.
        widths (sequence of int, optional): Width of each level, the last for all further ones. If
            left out, 32 without pooling, and 16, 32 and 64 with it.
        depth (int): Graph convolutions of each level; the first of several has one.
        conv (str): As of :class:`~torch_geometric_tactile.nn.models.TaxelNet`.
        num_sectors (int): Number of directions.
        kernel_size (int): Frames that the convolution of a block sees :math:`K`.
        dilation (int): Distance of these frames in the first block :math:`D`.
        num_blocks (int): Number of blocks :math:`L`.
        pool (str): What the answer of a window rests on: the features of its :obj:`"last"` frame,
            or their :obj:`"mean"` or :obj:`"max"` over the frames, or both (:obj:`"mean_max"`).
            Streams need :obj:`"last"`.
        mixed_channels (int): Width of the blocks on the joined features of all taxels; 0 for blocks
            on the features of each taxel.
        hidden_channels (int, optional): Width of the hidden layer; if :obj:`None`, the logits
            follow from the features without one.
        dropout (float): Part of the features dropped in training before each layer of the head, and
            half of it in the blocks.
        taxel_dropout (float): Part of the taxels that read nothing in training, drawn anew for each
            window.
        max_taxels (int): Number of taxels above which a level is pooled.
        num_joints (int): Number of joint angles that join before the hidden layer; 0 for none.
        fast (bool): As of :class:`~torch_geometric_tactile.nn.conv.SectorConv`.

    Shapes:
        - **input:** windows :math:`(N, C \cdot T)`, :math:`(B, N, C \cdot T)` or those of a PyG
          batch :math:`(B \cdot N, C \cdot T)`, channel outer and time inner; joint angles in
          radians :math:`(B, J)`, or :math:`(B, T, J)` for all frames
        - **output:** logits :math:`(B, O)`, or :math:`(B, T, O)` of all frames

    Raises:
        ValueError: If :obj:`layout` is a number, :obj:`conv` is unknown, a size is below one, or
            :obj:`x` has other taxels or no whole number of frames.

    Examples:
        >>> model = TemporalTaxelNet("biotac", 2, in_channels=3)
        >>> model
        TemporalTaxelNet(19, 2, in_channels=3, widths=(32,), taxels=(19,), receptive_field=64)
        >>> model(torch.zeros(5, 19, 3 * 60)).shape
        torch.Size([5, 2])
        >>> state = model.eval().initial_state(5)
        >>> logits, state = model.step(torch.zeros(5, 19, 3), None, state)
        >>> logits.shape
        torch.Size([5, 2])
    """

    splits_frames = True  # `in_channels` is that of one frame, whatever their number

    def __init__(
        self,
        layout: Union[TaxelLayout, PathLike],
        out_channels: int,
        *,
        in_channels: int = 1,
        num_filters: Optional[int] = 16,
        filter_size: int = 16,
        widths: Optional[Sequence[int]] = None,
        depth: int = 1,
        conv: ConvName = "sector",
        num_sectors: int = 8,
        kernel_size: int = 3,
        dilation: int = 8,
        num_blocks: int = 2,
        pool: Literal["last", "mean", "max", "mean_max"] = "last",
        mixed_channels: int = 0,
        hidden_channels: Optional[int] = 64,
        dropout: float = 0.5,
        taxel_dropout: float = 0.2,
        max_taxels: int = 64,
        num_joints: int = 0,
        fast: bool = True,
    ) -> None:
        super().__init__()
        layout = load_layout(layout, "the neighbours of its taxels")
        check_sizes(
            out_channels=out_channels,
            in_channels=in_channels,
            num_filters=1 if num_filters is None else num_filters,
            filter_size=filter_size,
            depth=depth,
            num_sectors=num_sectors,
            kernel_size=kernel_size,
            dilation=dilation,
            num_blocks=num_blocks,
            hidden_channels=1 if hidden_channels is None else hidden_channels,
            max_taxels=max_taxels,
        )
        for name, size in (("num_joints", num_joints), ("mixed_channels", mixed_channels)):
            need(size >= 0, f"'{name}' must not be negative", size)
        need(conv in CONVS, f"'conv' must be one of {CONVS}", repr(conv))
        need(pool in _POOLS, f"'pool' must be one of {_POOLS}", repr(pool))
        self.num_nodes = layout.num_taxels
        self.out_channels = out_channels
        self.in_channels = in_channels
        self.dilation = dilation
        self.pool = pool
        self.taxel_dropout = check_taxel_dropout(taxel_dropout)
        self.num_joints = num_joints
        self.receptive_field = 1 + (kernel_size - 1) * dilation * (2**num_blocks - 1)
        pools = pooled_layouts(layout, max_taxels)
        self.widths = level_widths(widths, 1 + len(pools))
        self.taxels = (self.num_nodes, *(pool.num_clusters for pool in pools))
        self.norm = ReadingNorm(in_channels)
        self.filters: Optional[FrameFilters] = None
        if num_filters is not None:
            self.filters = FrameFilters(in_channels, num_filters, filter_size)
            self.receptive_field += filter_size - 1
        ons = [layout, *(pool.coarse for pool in pools)]
        before = [num_filters or in_channels, *self.widths]
        self.levels = ModuleList()
        for i, width in enumerate(self.widths):
            level = (before[i], *[width] * (1 if i == 0 and pools else depth))
            before_level = pools[i - 1] if i else None
            self.levels.append(TaxelLevel(ons[i], before_level, level, conv, num_sectors, fast))
        width, num_nodes = self.widths[-1], self.taxels[-1]
        self.mixer: Optional[FrameFilters] = None
        if mixed_channels:
            self.mixer = FrameFilters(num_nodes * width, mixed_channels, kernel_size)
            self.receptive_field += kernel_size - 1
            width, num_nodes = mixed_channels, 1
        self.blocks = ModuleList(
            TemporalBlock(width, kernel_size, dilation * 2**i, dropout / 2)
            for i in range(num_blocks)
        )
        width *= 2 if pool == "mean_max" else 1
        self.head = FrameHead(
            *(num_nodes, width, out_channels, hidden_channels, dropout, num_joints),
            are_mixed=bool(mixed_channels),
        )

    def forward(
        self,
        x: Tensor,
        edge_index: OptTensor = None,
        edge_attr: OptTensor = None,
        joint: OptTensor = None,
        absolute: OptTensor = None,
        pos: OptTensor = None,
        *,
        per_frame: bool = False,
    ) -> Tensor:
        r"""Returns the logits of the window, or those of all frames.

        The order is that of :meth:`~torch_geometric_tactile.nn.models.TactileModel.forward`.

        Args:
            x (torch.Tensor): Windows of readings.
            edge_index, edge_attr, absolute, pos (torch.Tensor, optional): Not used.
            joint (torch.Tensor, optional): Joint angles in radians, if the model has them: those of
                the last frame, or with :obj:`per_frame` of all.
            per_frame (bool): Whether to return the logits of each frame, as to train on all; needs
                :obj:`pool="last"`.
        """
        need(not per_frame or self.pool == "last", _NEEDS_LAST.format("per_frame"), self.pool)
        x = _frames(x, self.num_nodes, self.in_channels)
        seen = seen_taxels(x[:, :, 0], self.taxel_dropout if self.training else 0.0)
        x = self.norm(x.flatten(1, 2)).view_as(x)
        if seen is not None:  # behind the scale, which is that of all taxels
            x = x * seen[:, :, None, None]
        # Of every frame, or of those that the answer rests on.
        stride = 1 if per_frame else self.dilation
        first_stride = stride if self.mixer is None else 1
        if self.filters is None:
            h = x[:, :, (x.size(2) - 1) % first_stride :: first_stride]
        else:
            h = self.filters(x, first_stride)
        for level in self.levels:
            h = in_frames(level, h)
        if self.mixer is not None:
            h = self.mixer(h.transpose(1, 2).flatten(2).unsqueeze(1), stride)
        for block in _temporal(self.blocks):
            if per_frame:
                h = block(h)
            elif self.pool == "last":
                h = block(h, block.conv.dilation, 2)
            else:
                h = block(h, self.dilation)
        return self.head(h if per_frame else self._pooled(h), joint)

    def _pooled(self, h: Tensor) -> Tensor:
        # Features (B, M, T, F) of frames as those of the window.
        if self.pool == "last":
            return h[:, :, -1]
        parts = {"mean": h.mean(dim=2), "max": h.amax(dim=2)}
        return torch.cat([parts[name] for name in self.pool.split("_")], dim=-1)

    @property
    def can_step(self) -> bool:
        r"""Whether the model answers frame by frame, with :meth:`step`."""
        return self.pool == "last"

    def initial_state(
        self,
        batch_size: int,
        device: torch.device | str | None = None,
        dtype: torch.dtype | None = None,
    ) -> _TemporalState:
        r"""Returns the state before the first frame: tensors whose first size is the number of
        streams, so that states can be joined, cut and exported.

        Args:
            batch_size (int): Number of streams :math:`B`.
            device (torch.device, optional): That of the weights, if left out.
            dtype (torch.dtype, optional): Likewise.
        """
        need(self.can_step, _NEEDS_LAST.format("initial_state"), self.pool)
        num_nodes = self.taxels[-1] if self.mixer is None else 1
        convs = [block.conv for block in _temporal(self.blocks)]
        convs = convs if self.mixer is None else [self.mixer.conv, *convs]
        taxels = [num_nodes] * len(convs)
        if self.filters is not None:
            convs, taxels = [self.filters.conv, *convs], [self.num_nodes, *taxels]
        return tuple(
            conv.initial_state(batch_size, count, device=device, dtype=dtype)
            for conv, count in zip(convs, taxels, strict=True)
        )

    def step(
        self,
        frame: Tensor,
        edge_index: OptTensor,
        state: _TemporalState,
        joint: OptTensor = None,
    ) -> tuple[Tensor, _TemporalState]:
        r"""Returns the logits after the next frame, and the state after it.

        Args:
            frame (torch.Tensor): Readings of one frame :math:`(B, N, C)`.
            edge_index (torch.Tensor, optional): Not used.
            state (tuple of torch.Tensor): The state before it.
            joint (torch.Tensor, optional): Joint angles in radians :math:`(B, J)`, if the model has
                them.
        """
        x = stacked_readings(frame, self.num_nodes, self.in_channels, "channels")
        need(self.can_step, _NEEDS_LAST.format("step"), self.pool)
        layers = [layer for layer in (self.filters, self.mixer) if layer is not None]
        _check_state(state, len(layers) + len(self.blocks))
        before, after = list(state), []
        h = self.norm(x)
        if self.filters is not None:
            h, layer_state = self.filters.step(h, before.pop(0))
            after.append(layer_state)
        for level in self.levels:
            h = level(h)
        if self.mixer is not None:
            h, layer_state = self.mixer.step(h.flatten(1).unsqueeze(1), before.pop(0))
            after.append(layer_state)
        for block, layer_state in zip(_temporal(self.blocks), before, strict=True):
            h, layer_state = block.step(h, layer_state)
            after.append(layer_state)
        return self.head(h, joint), tuple(after)

    def extra_repr(self) -> str:
        r"""Returns the sizes for :obj:`repr`."""
        joints = f", num_joints={self.num_joints}" if self.num_joints else ""
        pool = "" if self.pool == "last" else f", pool={self.pool!r}"
        mixed = "" if self.mixer is None else f", mixed_channels={self.mixer.conv.out_channels}"
        return (
            f"{self.num_nodes}, {self.out_channels}, in_channels={self.in_channels}, "
            f"widths={self.widths}, taxels={self.taxels}, "
            f"receptive_field={self.receptive_field}{pool}{mixed}{joints}"
        )


def _temporal(blocks: ModuleList) -> list[TemporalBlock]:
    return [block for block in blocks if isinstance(block, TemporalBlock)]


def _check_state(state: _TemporalState, count: int) -> None:
    if len(state) != count:
        raise ValueError(
            f"'state' must be the {count} tensors of 'initial_state' or of the step before (got "
            f"{len(state)})"
        )


def _frames(x: Tensor, num_nodes: int, in_channels: int) -> Tensor:
    # As (B, N, T, C).
    num_frames, rest = divmod(x.size(-1), in_channels) if x.dim() else (0, 0)
    if rest or num_frames == 0:
        raise ValueError(
            f"'x' must have the frames of {in_channels} channels side by side, at least one of "
            f"each (got shape {tuple(x.shape)})"
        )
    x = stacked_readings(x, num_nodes, x.size(-1), "features")
    return split_frames(x, num_frames)
