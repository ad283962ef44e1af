r"""The model of windows of frames to begin with."""

from collections.abc import Sequence
from typing import Optional, Union

import torch
from torch import Tensor
from torch.nn import Linear, Module, ModuleList
from torch_geometric.nn.inits import reset
from torch_geometric.typing import OptTensor

from torch_geometric_tactile.data import split_frames
from torch_geometric_tactile.nn.models.byte_dropout import ByteDropout
from torch_geometric_tactile.nn.models.hub import TactileHubMixin
from torch_geometric_tactile.nn.models.tactile_model import with_joints
from torch_geometric_tactile.nn.models.taxel_levels import (
    CONVS,
    ConvName,
    ReadingNorm,
    TaxelLevel,
    TaxelNorm,
    pooled_layouts,
)
from torch_geometric_tactile.nn.models.taxels import (
    check_taxel_dropout,
    load_layout,
    seen_taxels,
    stacked_readings,
)
from torch_geometric_tactile.nn.models.temporal_blocks import FrameDifference, TemporalBlock
from torch_geometric_tactile.sensors import TaxelLayout
from torch_geometric_tactile.typing import PathLike

# Before the first frame, and after each: the last frames, and what each block saw of them.
TemporalState = tuple[Tensor, ...]

_FLOOR = 0.05


class TemporalTaxelNet(Module, TactileHubMixin):
    r"""The model to take first for windows of frames of any layout, and frame by frame on a robot:
    graph convolutions over the taxels of every frame, then causal convolutions over time. It is
    ours and no paper's.

    .. math::
        \mathbf{h}_t = f \left( \mathbf{x}_t, \; \mathbf{x}_t - \mathbf{x}_{t-L} \right), \qquad
        \mathbf{z}_t = g \left( \mathbf{h}_{t-R+L+1}, \ldots, \mathbf{h}_t \right)

    Each taxel has its readings and their difference to :obj:`lag` frames before. Levels of
    :class:`~torch_geometric_tactile.nn.conv.SectorConv` with pooling between them, as of
    :class:`~torch_geometric_tactile.nn.models.TaxelNet`, see them frame by frame. All taxels side
    by side, their mean, their maximum and the readings themselves give one vector for each frame.
    Blocks of :class:`~torch_geometric_tactile.nn.conv.CausalTemporalConv` with dilations 1, 2, 4
    and so on follow, and the logits of each frame. The answer of a window is that of its last.

    :obj:`receptive_field` :math:`R` is the number of frames that an answer rests on. Before the
    first frame, features are zero, and so are differences. :meth:`step` takes one frame and a
    state: from :meth:`initial_state` on it gives the numbers of :meth:`forward` on the same frames,
    and after :math:`R` frames those of any window that ends here and has at least :math:`R` frames.

    It finds its neighbours in the layout: :obj:`edge_index` is accepted and not used. Readings are
    scaled by batch normalisation, so that raw counts will do. Missing readings (NaN) must be filled
    before, as for all models.

    Args:
        layout (TaxelLayout, str or PathLike): The layout, the name of a stock layout, or the path
            of a layout file.
        out_channels (int): Number of labels or classes :math:`K`.
        in_channels (int): Channels of each taxel in one frame :math:`C`: axes or fingers.
        widths (sequence of int, optional): Width of each level, the last for all further ones. If
            left out, 32 without pooling, and 8, 16 and 32 with it.
        depth (int): Blocks of each level; the first of several has one.
        conv (str): As of :class:`~torch_geometric_tactile.nn.models.TaxelNet`.
        num_sectors (int): Number of directions.
        lag (int): Distance of the frames whose difference is taken; 0 for no differences.
        hidden_channels (int): Width of the vector of each frame.
        kernel_size (int): Frames that each temporal block sees.
        num_blocks (int): Number of temporal blocks.
        dropout (float): Part of the features dropped in training.
        taxel_dropout (float): Part of the taxels that read nothing in training, drawn anew for each
            window.
        max_taxels (int): Number of taxels above which a level is pooled.
        num_joints (int): Number of joint angles that join before the logits; 0 for none.
        fast (bool): As of :class:`~torch_geometric_tactile.nn.conv.SectorConv`.

    Shapes:
        - **input:** windows :math:`(N, C \cdot T)`, :math:`(B, N, C \cdot T)` or those of a PyG
          batch :math:`(B \cdot N, C \cdot T)`, channel outer and time inner; joint angles in
          radians :math:`(B, J)`, or :math:`(B, T, J)` for all frames
        - **output:** logits :math:`(B, K)`, or :math:`(B, T, K)` of all frames

    Raises:
        ValueError: If :obj:`layout` is a number, :obj:`conv` is unknown, a size is below one, or
            :obj:`x` has other taxels or no whole number of frames.

    Examples:
        >>> model = TemporalTaxelNet("biotac", 2, in_channels=3)
        >>> model(torch.zeros(5, 19, 3 * 60)).shape
        torch.Size([5, 2])
        >>> state = model.eval().initial_state(5)
        >>> logits, state = model.step(torch.zeros(5, 19, 3), None, state)
        >>> logits.shape
        torch.Size([5, 2])
    """

    splits_frames = True  # its channels are those of one frame

    def __init__(
        self,
        layout: Union[TaxelLayout, PathLike] = "biotac",
        out_channels: int = 2,
        *,
        in_channels: int = 1,
        widths: Optional[Sequence[int]] = None,
        depth: int = 2,
        conv: ConvName = "sector",
        num_sectors: int = 8,
        lag: int = 1,
        hidden_channels: int = 64,
        kernel_size: int = 3,
        num_blocks: int = 5,
        dropout: float = 0.3,
        taxel_dropout: float = 0.2,
        max_taxels: int = 64,
        num_joints: int = 0,
        fast: bool = True,
    ) -> None:
        super().__init__()
        layout = load_layout(layout, "the neighbours of its taxels")
        sizes = {
            "out_channels": out_channels,
            "in_channels": in_channels,
            "depth": depth,
            "num_sectors": num_sectors,
            "hidden_channels": hidden_channels,
            "kernel_size": kernel_size,
            "num_blocks": num_blocks,
            "max_taxels": max_taxels,
        }
        for name, size in sizes.items():
            if size < 1:
                raise ValueError(f"'{name}' must be at least 1 (got {size})")
        for name, size in (("lag", lag), ("num_joints", num_joints)):
            if size < 0:
                raise ValueError(f"'{name}' must not be negative (got {size})")
        if conv not in CONVS:
            raise ValueError(f"'conv' must be one of {CONVS} (got {conv!r})")
        self.num_nodes = layout.num_taxels
        self.out_channels = out_channels
        self.in_channels = in_channels
        self.taxel_dropout = check_taxel_dropout(taxel_dropout)
        self.num_joints = num_joints
        self.lag = lag
        dilations = [2**i for i in range(num_blocks)]
        self.receptive_field = 1 + lag + (kernel_size - 1) * sum(dilations)

        pools = pooled_layouts(layout, max_taxels)
        self.widths = _widths(widths, 1 + len(pools))
        self.taxels = (self.num_nodes, *(pool.num_clusters for pool in pools))
        self.difference = FrameDifference(in_channels, lag) if lag else None
        width = in_channels * (2 if lag else 1)
        signals = self.num_nodes * width
        self.norm = ReadingNorm(width)
        self.norm_signals = ReadingNorm(signals, _FLOOR)
        self.levels = ModuleList()
        for i, after in enumerate(self.widths):
            blocks = 1 if i == 0 and pools else depth
            pool = pools[i - 1] if i else None
            level = (width, *[after] * blocks)
            on = layout if pool is None else pool.coarse
            self.levels.append(TaxelLevel(on, pool, level, conv, num_sectors, fast))
            width = after
        size = signals + (self.taxels[-1] + 2) * width
        self.dropout = ByteDropout(dropout)
        self.lin = Linear(size, hidden_channels, bias=False)
        self.norm_hidden = TaxelNorm(hidden_channels)
        self.blocks = ModuleList(
            TemporalBlock(hidden_channels, kernel_size, dilation, dropout) for dilation in dilations
        )
        self.lin_out = Linear(hidden_channels + num_joints, out_channels)

    @property
    def modalities(self) -> tuple[str, ...]:
        r"""The attributes of a batch that :meth:`forward` needs by keyword."""
        return ("joint",) if self.num_joints else ()

    def reset_parameters(self) -> None:
        r"""Draws all weights anew."""
        for child in self.children():
            reset(child)

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
        r"""Returns the logits of the last frame :math:`(B, K)`, or those of all.

        The order is that of :meth:`~torch_geometric_tactile.nn.models.TactileModel.forward`.

        Args:
            x (torch.Tensor): Windows of readings.
            edge_index (torch.Tensor, optional): Not used.
            edge_attr (torch.Tensor, optional): Not used.
            joint (torch.Tensor, optional): Joint angles in radians, if the model has them.
            absolute (torch.Tensor, optional): Not used.
            pos (torch.Tensor, optional): Not used.
            per_frame (bool): Whether to return the logits of all frames :math:`(B, T, K)`, to train
                on each of them.
        """
        x = self._frames(x)
        num_samples, num_frames = x.shape[:2]
        seen = seen_taxels(x[:, 0], self.taxel_dropout if self.training else 0.0)
        if self.difference is not None:
            x = self.difference(x)
        if seen is not None:
            seen = seen.unsqueeze(1).expand(-1, num_frames, -1).flatten(0, 1)
        h = self._vectors(x.flatten(0, 1), seen).view(num_samples, num_frames, -1)
        for block in self.blocks:
            h = block(h)
        if not per_frame:
            return self.lin_out(with_joints(h[:, -1], joint, self.num_joints))
        out = self.lin_out(with_joints(h.flatten(0, 1), joint, self.num_joints))
        return out.view(num_samples, num_frames, -1)

    def initial_state(
        self,
        batch_size: int,
        device: torch.device | str | None = None,
        dtype: torch.dtype | None = None,
    ) -> TemporalState:
        r"""Returns the state before the first frame, tensors whose first size is the number of
        streams.

        Args:
            batch_size (int): Number of streams :math:`B`.
            device (torch.device, optional): That of the weights, if left out.
            dtype (torch.dtype, optional): Likewise.
        """
        size = (batch_size, self.lag, self.num_nodes, self.in_channels)
        unseen = self.lin.weight.new_full(size, torch.nan, device=device, dtype=dtype)
        states = [
            block.conv.initial_state(batch_size, device=device, dtype=dtype)
            for block in self.blocks
        ]
        return (unseen, *states)

    def step(
        self,
        frame: Tensor,
        edge_index: OptTensor,
        state: TemporalState,
        joint: OptTensor = None,
    ) -> tuple[Tensor, TemporalState]:
        r"""Returns the logits :math:`(B, K)` after the next frame, and the state after it.

        Args:
            frame (torch.Tensor): Readings of one frame :math:`(B, N, C)`.
            edge_index (torch.Tensor, optional): Not used.
            state (tuple of torch.Tensor): The state before it.
            joint (torch.Tensor, optional): Joint angles in radians, if the model has them.
        """
        x = stacked_readings(frame, self.num_nodes, self.in_channels, "channels")
        last, *states = state
        if self.difference is not None:
            x, last = self.difference.step(x, last)
        h = self._vectors(x, None)
        after = []
        for block, seen in zip(self.blocks, states, strict=True):
            h, seen = block.step(h, seen)
            after.append(seen)
        return self.lin_out(with_joints(h, joint, self.num_joints)), (last, *after)

    def _frames(self, x: Tensor) -> Tensor:
        # As (B, T, N, C).
        num_frames, rest = divmod(x.size(-1), self.in_channels)
        if rest or num_frames == 0:
            raise ValueError(
                f"'x' must have {self.in_channels} channels of one or more frames, side by side "
                f"(got shape {tuple(x.shape)})"
            )
        x = stacked_readings(x, self.num_nodes, x.size(-1), "features")
        return split_frames(x, num_frames).transpose(1, 2)

    def _vectors(self, x: Tensor, seen: OptTensor) -> Tensor:
        # The vector of each frame, of (M, N, F).
        h = self.norm(x)
        rows = self.norm_signals(x.flatten(1).unsqueeze(1)).view(x.shape)
        if seen is not None:  # behind the scales, which are those of all taxels
            h, rows = h * seen.unsqueeze(-1), rows * seen.unsqueeze(-1)
        for level in self.levels:
            h = level(h)
        parts = [h.flatten(1), h.mean(dim=1), h.amax(dim=1), rows.flatten(1)]
        return self.norm_hidden(self.lin(self.dropout(torch.cat(parts, dim=1)))).relu()

    def __repr__(self) -> str:
        joints = f", num_joints={self.num_joints}" if self.num_joints else ""
        return (
            f"{type(self).__name__}({self.num_nodes}, {self.out_channels}, "
            f"in_channels={self.in_channels}, widths={self.widths}, taxels={self.taxels}, "
            f"receptive_field={self.receptive_field}{joints})"
        )


def _widths(widths: Optional[Sequence[int]], num_levels: int) -> tuple[int, ...]:
    # The width of each level.
    if widths is None:
        widths = (32,) if num_levels == 1 else (8, 16, 32)
    widths = tuple(widths)
    if not widths or min(widths) < 1:
        raise ValueError(f"'widths' must be at least one width of at least 1 (got {widths})")
    return (*widths, *[widths[-1]] * num_levels)[:num_levels]
