r"""The default model for windows and streams of frames."""

from collections.abc import Sequence
from typing import Literal, Optional, Union

import torch
from torch import Tensor
from torch.nn import Linear, Module, ModuleList
from torch_geometric.typing import OptTensor

from torch_geometric_tactile._checks import need
from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile.data import split_frames
from torch_geometric_tactile.nn._sizes import check_sizes
from torch_geometric_tactile.nn.conv import CausalTemporalConv
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
from torch_geometric_tactile.sensors import TaxelLayout

# The past input frames of each convolution over time.
_TemporalState = tuple[Tensor, ...]
_POOLS = ("last", "mean", "max", "mean_max")
_POOL_MESSAGE = "'pool' must be 'last' for '{}', which returns logits frame by frame"


class TemporalTaxelNet(BaseModel):
    r"""The recommended first model for windows and streams of frames, for any layout. It has
    convolutions over neighbouring taxels and causal convolutions over time. It is not from a paper.

    The model consists of:

    * filters of :obj:`filter_size` frames on the readings of each taxel, which detect changes
      despite a constant offset;
    * in each frame, levels of :class:`~torch_geometric_tactile.nn.conv.SectorConv` with pooling
      between them, as in :class:`~torch_geometric_tactile.nn.models.TaxelNet`;
    * residual blocks of :class:`~torch_geometric_tactile.nn.conv.CausalTemporalConv` on the
      features of each taxel, with dilations :math:`D, 2 D, 4 D` and so on;
    * a hidden layer, followed by the logits of a frame. Its inputs are the features of all taxels,
      their mean and their maximum.

    The logits of a frame depend on the last :obj:`receptive_field` frames,

    .. math::
        R = F + (K - 1) D (2^L - 1)

    with filters of :math:`F` frames and :math:`L` blocks of kernel size :math:`K`. Before the first
    frame, all features are zero. By default, the model returns the logits of the last frame of a
    window. It computes only the features that these logits depend on: in every :math:`D`-th frame,
    then in every :math:`2 D`-th frame, and so on. With :obj:`per_frame`, the logits of all frames
    are computed.

    For windows or trials **with one label for all frames**, such as slides over a surface, use
    :obj:`pool="mean_max"`. The logits are then computed from the mean and the maximum over every
    :math:`D`-th frame.

    With :obj:`mixed_channels`, a convolution over :math:`K` frames mixes the features of all taxels
    before the blocks. This adds :math:`K - 1` to :math:`R`.

    :meth:`step` processes one frame and a state, which is a tuple of tensors. Starting from
    :meth:`initial_state`, it returns the same logits as :meth:`forward` on the same frames. After
    :math:`R` frames, it returns the same logits as :meth:`forward` on any window of at least
    :math:`R` frames that ends with the same frame.

    Neighbours are computed from the layout, and :obj:`edge_index` is ignored. Batch normalisation
    scales the readings, with one scale for all taxels of a channel, so that raw counts can be used.
    Missing readings (NaN) must be filled first.

    Args:
        layout (TaxelLayout, str or PathLike): The layout, the name of a stock layout, or the path
            of a layout file.
        out_channels (int): Number of labels or classes.
        in_channels (int): Number of channels per taxel in one frame :math:`C`, such as axes or
            fingers.
        num_filters (int, optional): Number of filters on the readings of each taxel. If
            :obj:`None`, the first level takes the unfiltered readings, and :math:`F = 1`.
        filter_size (int): Length of the filters in frames :math:`F`.
        widths (sequence of int, optional): Width of each level. The last width is repeated for
            further levels. Defaults to 32 without pooling, and to 16, 32 and 64 with pooling.
        depth (int): Number of graph convolutions in each level. If there are several levels, the
            first level has one.
        conv (str): Convolution, as in :class:`~torch_geometric_tactile.nn.models.TaxelNet`.
        num_sectors (int): Number of directions.
        kernel_size (int): Number of frames in the kernel of each block :math:`K`.
        dilation (int): Distance between the frames of the kernel in the first block :math:`D`.
        num_blocks (int): Number of blocks :math:`L`.
        pool (str): Features from which the logits of a window are computed: the features of its
            :obj:`"last"` frame, their :obj:`"mean"` or :obj:`"max"` over the frames, or both
            (:obj:`"mean_max"`). Streams require :obj:`"last"`.
        mixed_channels (int): Width of the blocks if they take the mixed features of all taxels. If
            0, the blocks take the features of each taxel separately.
        hidden_channels (int, optional): Width of the hidden layer, or :obj:`None` for none.
        dropout (float): Probability of dropping a feature before each layer of the head during
            training. In the blocks, the probability is half as large.
        taxel_dropout (float): Probability of dropping a taxel of a window during training.
        max_taxels (int): Maximum number of taxels in the last level. Larger layouts are pooled.
        num_joints (int): Number of joint angles that are appended to the input of the hidden layer,
            or 0 for none.
        fast (bool): Passed to :class:`~torch_geometric_tactile.nn.conv.SectorConv`.

    Shapes:
        - **input:** windows :math:`(N, C \cdot T)`, :math:`(B, N, C \cdot T)` or, for a PyG batch,
          :math:`(B \cdot N, C \cdot T)`, with the frames of each channel side by side; joint angles
          in radians :math:`(B, J)`, or :math:`(B, T, J)` for all frames
        - **output:** logits :math:`(B, O)`, or :math:`(B, T, O)` for all frames

    Raises:
        ValueError: If :obj:`layout` is a number, :obj:`conv` is unknown, a size is below one, or
            :obj:`x` has the wrong number of taxels or a number of columns that is not a multiple of
            :math:`C`.

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

    splits_frames = True  # `in_channels` is the number of channels in one frame

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
        pools = layout_pools(layout, max_taxels)
        self.widths = level_widths(widths, 1 + len(pools))
        self.taxels = (self.num_nodes, *(pool.num_clusters for pool in pools))
        self.norm = ReadingNorm(in_channels)
        self.filters: Optional[_FrameFilters] = None
        if num_filters is not None:
            self.filters = _FrameFilters(in_channels, num_filters, filter_size)
            self.receptive_field += filter_size - 1
        layouts = [layout, *(pool.coarse for pool in pools)]
        input_widths = [num_filters or in_channels, *self.widths]
        self.levels = ModuleList()
        for i, width in enumerate(self.widths):
            block_widths = (input_widths[i], *[width] * (1 if i == 0 and pools else depth))
            level_pool = pools[i - 1] if i else None
            self.levels.append(
                TaxelLevel(layouts[i], level_pool, block_widths, conv, num_sectors, fast)
            )
        width, num_nodes = self.widths[-1], self.taxels[-1]
        self.mixer: Optional[_FrameFilters] = None
        if mixed_channels:
            self.mixer = _FrameFilters(num_nodes * width, mixed_channels, kernel_size)
            self.receptive_field += kernel_size - 1
            width, num_nodes = mixed_channels, 1
        self.blocks = ModuleList(
            _TemporalBlock(width, kernel_size, dilation * 2**i, dropout / 2)
            for i in range(num_blocks)
        )
        width *= 2 if pool == "mean_max" else 1
        self.head = _FrameHead(
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
        r"""Returns the logits of each window :math:`(B, O)`, or of all its frames
        :math:`(B, T, O)`.

        The arguments have the same order as in
        :meth:`~torch_geometric_tactile.nn.models.TactileModel.forward`.

        Args:
            x (torch.Tensor): Windows of readings.
            edge_index, edge_attr, absolute, pos (torch.Tensor, optional): Not used.
            joint (torch.Tensor, optional): Joint angles in radians of the last frame or, with
                :obj:`per_frame`, of all frames. Required if :obj:`num_joints` is not 0.
            per_frame (bool): Whether to return the logits of each frame, for example to train on
                all frames. Requires :obj:`pool="last"`.
        """
        need(not per_frame or self.pool == "last", _POOL_MESSAGE.format("per_frame"), self.pool)
        x = _split_channels(x, self.num_nodes, self.in_channels)
        mask = taxel_mask(x[:, :, 0], self.taxel_dropout if self.training else 0.0)
        x = self.norm(x.flatten(1, 2)).view_as(x)
        if mask is not None:  # after scaling, so that dropped taxels do not change the scale
            x = x * mask[:, :, None, None]
        # After the filters and the mixer, the logits of a window depend only on every `dilation`-th
        # frame.
        stride = 1 if per_frame else self.dilation
        first_stride = stride if self.mixer is None else 1
        if self.filters is None:
            h = x[:, :, (x.size(2) - 1) % first_stride :: first_stride]
        else:
            h = self.filters(x, first_stride)
        for level in self.levels:
            h = _apply_to_frames(level, h)
        if self.mixer is not None:
            h = self.mixer(h.transpose(1, 2).flatten(2).unsqueeze(1), stride)
        for block in _temporal_blocks(self.blocks):
            if per_frame:
                h = block(h)
            elif self.pool == "last":
                h = block(h, block.conv.dilation, 2)
            else:
                h = block(h, self.dilation)
        return self.head(h if per_frame else self._pool_frames(h), joint)

    def _pool_frames(self, h: Tensor) -> Tensor:
        # Pools the features of frames (B, M, T, F), and returns the features of windows (B, M, F').
        if self.pool == "last":
            return h[:, :, -1]
        pooled = {"mean": h.mean(dim=2), "max": h.amax(dim=2)}
        return torch.cat([pooled[name] for name in self.pool.split("_")], dim=-1)

    @property
    def can_step(self) -> bool:
        r"""Whether the model supports :meth:`step`, which returns logits frame by frame."""
        return self.pool == "last"

    def initial_state(
        self,
        batch_size: int,
        device: torch.device | str | None = None,
        dtype: torch.dtype | None = None,
    ) -> _TemporalState:
        r"""Returns the state before the first frame. The first dimension of its tensors is the
        stream, so that states can be concatenated, sliced and exported.

        Args:
            batch_size (int): Number of streams :math:`B`.
            device (torch.device, optional): Device of the state. Defaults to the device of the
                weights.
            dtype (torch.dtype, optional): Data type of the state. Defaults to the data type of the
                weights.
        """
        need(self.can_step, _POOL_MESSAGE.format("initial_state"), self.pool)
        num_nodes = self.taxels[-1] if self.mixer is None else 1
        convs = [block.conv for block in _temporal_blocks(self.blocks)]
        convs = convs if self.mixer is None else [self.mixer.conv, *convs]
        num_taxels = [num_nodes] * len(convs)
        if self.filters is not None:
            convs, num_taxels = [self.filters.conv, *convs], [self.num_nodes, *num_taxels]
        return tuple(
            conv.initial_state(batch_size, size, device=device, dtype=dtype)
            for conv, size in zip(convs, num_taxels, strict=True)
        )

    def step(
        self,
        frame: Tensor,
        edge_index: OptTensor,
        state: _TemporalState,
        joint: OptTensor = None,
    ) -> tuple[Tensor, _TemporalState]:
        r"""Returns the logits of the next frame, and the next state.

        Args:
            frame (torch.Tensor): Readings of the frame :math:`(B, N, C)`.
            edge_index (torch.Tensor, optional): Not used.
            state (tuple of torch.Tensor): State before the frame.
            joint (torch.Tensor, optional): Joint angles in radians :math:`(B, J)`. Required if
                :obj:`num_joints` is not 0.
        """
        x = stacked_readings(frame, self.num_nodes, self.in_channels, "channels")
        need(self.can_step, _POOL_MESSAGE.format("step"), self.pool)
        layers = [layer for layer in (self.filters, self.mixer) if layer is not None]
        _check_state(state, len(layers) + len(self.blocks))
        old_state, new_state = list(state), []
        h = self.norm(x)
        if self.filters is not None:
            h, layer_state = self.filters.step(h, old_state.pop(0))
            new_state.append(layer_state)
        for level in self.levels:
            h = level(h)
        if self.mixer is not None:
            h, layer_state = self.mixer.step(h.flatten(1).unsqueeze(1), old_state.pop(0))
            new_state.append(layer_state)
        for block, layer_state in zip(_temporal_blocks(self.blocks), old_state, strict=True):
            h, layer_state = block.step(h, layer_state)
            new_state.append(layer_state)
        return self.head(h, joint), tuple(new_state)

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


class _FrameFilters(Module):
    r"""Causal filters on the readings of each taxel, followed by normalisation and ReLU. All taxels
    share the filters.

    Args:
        in_channels (int): Number of channels :math:`C`.
        out_channels (int): Number of filters.
        kernel_size (int): Length of the filters in frames.
    """

    def __init__(self, in_channels: int, out_channels: int, kernel_size: int) -> None:
        super().__init__()
        self.conv = CausalTemporalConv(in_channels, out_channels, kernel_size, bias=False)
        self.norm = TaxelNorm(out_channels)

    def forward(self, x: Tensor, stride: int = 1) -> Tensor:
        r"""Returns the filtered readings.

        Args:
            x (torch.Tensor): Readings :math:`(B, N, T, C)`.
            stride (int): Distance between the output frames.
        """
        return self._normalize(self.conv(x, stride=stride))

    def step(self, x: Tensor, state: Tensor) -> tuple[Tensor, Tensor]:
        r"""Returns the filtered readings of the next frame, and the next state.

        Args:
            x (torch.Tensor): Readings of the frame :math:`(B, N, C)`.
            state (torch.Tensor): State before the frame.
        """
        out, state = self.conv.step(x, state)
        return self._normalize(out), state

    def _normalize(self, h: Tensor) -> Tensor:
        return self.norm(h.flatten(0, -2)).relu().view(h.shape)


class _TemporalBlock(Module):
    r"""A causal convolution on the features of each taxel, followed by normalisation, ReLU, dropout
    and a residual connection.

    Args:
        channels (int): Size of each input and output feature.
        kernel_size (int): Number of frames in the kernel.
        dilation (int): Distance between the kernel's frames.
        dropout (float): Probability of dropping a feature during training.
    """

    def __init__(self, channels: int, kernel_size: int, dilation: int, dropout: float) -> None:
        super().__init__()
        self.conv = CausalTemporalConv(channels, channels, kernel_size, dilation, bias=False)
        self.norm = TaxelNorm(channels)
        self.dropout = ByteDropout(dropout)

    def forward(self, h: Tensor, spacing: int = 1, stride: int = 1) -> Tensor:
        r"""Returns the output for features :math:`(B, M, T, F)`. The arguments are the same as for
        :meth:`CausalTemporalConv.forward`.
        """
        out = self.conv(h, spacing=spacing, stride=stride)
        h = h[:, :, (h.size(2) - 1) % stride :: stride]
        return self._add_residual(h, out)

    def step(self, h: Tensor, state: Tensor) -> tuple[Tensor, Tensor]:
        r"""Returns the output for the features of the next frame, and the next state.

        Args:
            h (torch.Tensor): Features of the frame :math:`(B, M, F)`.
            state (torch.Tensor): State before the frame.
        """
        out, state = self.conv.step(h, state)
        return self._add_residual(h, out), state

    def _add_residual(self, h: Tensor, out: Tensor) -> Tensor:
        return h + self.dropout(self.norm(out.flatten(0, -2)).relu()).view(out.shape)


class _FrameHead(Module):
    r"""Computes the logits of a frame from the features of all taxels, their mean and their
    maximum, with an optional hidden layer. For mixed features, the mean and maximum are left out.

    Args:
        num_nodes (int): Number of taxels :math:`M`.
        width (int): Number of features per taxel :math:`F`.
        out_channels (int): Number of labels or classes :math:`O`.
        hidden_channels (int, optional): Width of the hidden layer, or :obj:`None` for none.
        dropout (float): Probability of dropping a feature during training.
        num_joints (int): Number of joint angles.
        are_mixed (bool): Whether the features of all taxels are mixed into one row.
    """

    def __init__(
        self,
        num_nodes: int,
        width: int,
        out_channels: int,
        hidden_channels: int | None,
        dropout: float,
        num_joints: int,
        are_mixed: bool = False,
    ) -> None:
        super().__init__()
        self.num_joints = num_joints
        self.are_mixed = are_mixed
        in_channels = width if are_mixed else (num_nodes + 2) * width
        self.dropout = ByteDropout(dropout)
        width = in_channels + num_joints
        self.lin: Linear | None = None
        if hidden_channels is not None:
            self.lin = Linear(width, hidden_channels, bias=False)
            self.norm = TaxelNorm(hidden_channels)
            width = hidden_channels
        self.lin_out = Linear(width, out_channels)

    def forward(self, h: Tensor, joint: OptTensor) -> Tensor:
        r"""Returns the logits of one frame :math:`(B, O)`, or of all frames :math:`(B, T, O)`.

        Args:
            h (torch.Tensor): Features of one frame :math:`(B, M, F)`, or of all frames
                :math:`(B, M, T, F)`.
            joint (torch.Tensor, optional): Joint angles in radians :math:`(B, J)`, or
                :math:`(B, T, J)` for all frames.
        """
        rows = h if h.dim() == 3 else h.transpose(1, 2).flatten(0, 1)
        features = rows.flatten(1)
        if not self.are_mixed:
            features = torch.cat([features, rows.mean(dim=1), rows.amax(dim=1)], dim=1)
        features = with_joints(self.dropout(features), joint, self.num_joints)
        if self.lin is not None:
            features = self.dropout(self.norm(self.lin(features)).relu())
        out: Tensor = self.lin_out(features)
        return out if h.dim() == 3 else out.unflatten(0, (h.size(0), h.size(2)))


def _apply_to_frames(layer: Module, h: Tensor) -> Tensor:
    r"""Returns the output of a layer for each frame :math:`(B, M, T, O)`.

    Args:
        layer (torch.nn.Module): A layer from :math:`(S, N, F)` to :math:`(S, M, O)`.
        h (torch.Tensor): Features :math:`(B, N, T, F)`.
    """
    out: Tensor = layer(h.transpose(1, 2).flatten(0, 1))
    return out.unflatten(0, (h.size(0), h.size(2))).transpose(1, 2)


def _temporal_blocks(blocks: ModuleList) -> list[_TemporalBlock]:
    # Type checkers see plain modules when iterating over a ModuleList.
    return [block for block in blocks if isinstance(block, _TemporalBlock)]


def _check_state(state: _TemporalState, num_tensors: int) -> None:
    if len(state) != num_tensors:
        raise ValueError(
            f"'state' must be the {num_tensors} tensors returned by 'initial_state' or by the "
            f"previous 'step' (got {len(state)})"
        )


def _split_channels(x: Tensor, num_nodes: int, in_channels: int) -> Tensor:
    # Returns windows as (B, N, T, C).
    num_frames, remainder = divmod(x.size(-1), in_channels) if x.dim() else (0, 0)
    if remainder or num_frames == 0:
        raise ValueError(
            f"'x' must have the same number of frames, at least one, for each of {in_channels} "
            f"channels (got shape {tuple(x.shape)})"
        )
    x = stacked_readings(x, num_nodes, x.size(-1), "features")
    return split_frames(x, num_frames)
