r"""What :class:`~torch_geometric_tactile.nn.models.TemporalTaxelNet` is made of besides the levels
of :class:`~torch_geometric_tactile.nn.models.TaxelNet`."""

import torch
from torch import Tensor
from torch.nn import Linear, Module
from torch_geometric.typing import OptTensor

from torch_geometric_tactile.nn.conv import CausalTemporalConv
from torch_geometric_tactile.nn.models._inputs import with_joints
from torch_geometric_tactile.nn.models._taxel_levels import ByteDropout, TaxelNorm


class FrameFilters(Module):
    r"""Causal filters of the readings of each taxel, the same for all taxels, with normalisation
    and ReLU.
    """

    def __init__(self, in_channels: int, out_channels: int, kernel_size: int) -> None:
        super().__init__()
        self.conv = CausalTemporalConv(in_channels, out_channels, kernel_size, bias=False)
        self.norm = TaxelNorm(out_channels)

    def forward(self, x: Tensor, stride: int = 1) -> Tensor:
        r"""Filters readings :math:`(B, N, T, C)`."""
        return self._scaled(self.conv(x, stride=stride))

    def step(self, x: Tensor, state: Tensor) -> tuple[Tensor, Tensor]:
        r"""Filters the readings :math:`(B, N, C)` of the next frame."""
        out, state = self.conv.step(x, state)
        return self._scaled(out), state

    def _scaled(self, h: Tensor) -> Tensor:
        return self.norm(h.flatten(0, -2)).relu().view(h.shape)


class TemporalBlock(Module):
    r"""A causal convolution over the features of each taxel, normalisation, ReLU and dropout, with
    the input added.
    """

    def __init__(self, channels: int, kernel_size: int, dilation: int, dropout: float) -> None:
        super().__init__()
        self.conv = CausalTemporalConv(channels, channels, kernel_size, dilation, bias=False)
        self.norm = TaxelNorm(channels)
        self.dropout = ByteDropout(dropout)

    def forward(self, h: Tensor, spacing: int = 1, stride: int = 1) -> Tensor:
        r"""Convolves features :math:`(B, M, T, F)`."""
        out = self.conv(h, spacing=spacing, stride=stride)
        h = h[:, :, (h.size(2) - 1) % stride :: stride]
        return self._join(h, out)

    def step(self, h: Tensor, state: Tensor) -> tuple[Tensor, Tensor]:
        r"""Convolves the features :math:`(B, M, F)` of the next frame."""
        out, state = self.conv.step(h, state)
        return self._join(h, out), state

    def _join(self, h: Tensor, out: Tensor) -> Tensor:
        return h + self.dropout(self.norm(out.flatten(0, -2)).relu()).view(out.shape)


class FrameHead(Module):
    r"""From the features of all taxels to the logits of a frame: all side by side, their mean and
    their maximum, a hidden layer if it has a width, and the logits. Features that are mixed already
    are taken as they are.
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
        r"""Returns the logits of one frame :math:`(B, O)`, or of all :math:`(B, T, O)`.

        Shapes:
            - **h:** Features of one frame :math:`(B, M, F)`, or of all
              :math:`(B, M, T, F)`.
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


def in_frames(layer: Module, h: Tensor) -> Tensor:
    r"""Applies a layer of taxels to each frame.

    Shapes:
        - **layer:** The layer, from :math:`(S, N, F)` to :math:`(S, M, O)`.
        - **h:** Features :math:`(B, N, T, F)`.
        - **output:** :math:`(B, M, T, O)`
    """
    out: Tensor = layer(h.transpose(1, 2).flatten(0, 1))
    return out.unflatten(0, (h.size(0), h.size(2))).transpose(1, 2)
