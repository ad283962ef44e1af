r"""Parts of :class:`~torch_geometric_tactile.nn.models.TemporalTaxelNet`: filters and convolutions
over time, and the head."""

import torch
from torch import Tensor
from torch.nn import Linear, Module
from torch_geometric.typing import OptTensor

from torch_geometric_tactile.nn.conv import CausalTemporalConv
from torch_geometric_tactile.nn.models._inputs import with_joints
from torch_geometric_tactile.nn.models._taxel_levels import ByteDropout, TaxelNorm


class FrameFilters(Module):
    r"""Causal filters of the readings of each taxel, followed by normalisation and ReLU. All taxels
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


class TemporalBlock(Module):
    r"""A causal convolution over the features of each taxel, normalisation, ReLU and dropout, with
    a residual connection.

    Args:
        channels (int): Size of each input and output feature.
        kernel_size (int): Number of frames in the kernel.
        dilation (int): Distance between the kernel's frames.
        dropout (float): Probability of dropping a feature in training.
    """

    def __init__(self, channels: int, kernel_size: int, dilation: int, dropout: float) -> None:
        super().__init__()
        self.conv = CausalTemporalConv(channels, channels, kernel_size, dilation, bias=False)
        self.norm = TaxelNorm(channels)
        self.dropout = ByteDropout(dropout)

    def forward(self, h: Tensor, spacing: int = 1, stride: int = 1) -> Tensor:
        r"""Returns the output for features :math:`(B, M, T, F)`. The arguments are those of
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


class FrameHead(Module):
    r"""Computes the logits of a frame from the features of all taxels, their mean and their
    maximum, with an optional hidden layer. Mixed features are used without mean and maximum.

    Args:
        num_nodes (int): Number of taxels :math:`M`.
        width (int): Size of each taxel's features :math:`F`.
        out_channels (int): Number of labels or classes :math:`O`.
        hidden_channels (int, optional): Width of the hidden layer, or :obj:`None` for none.
        dropout (float): Probability of dropping a feature in training.
        num_joints (int): Number of joint angles.
        are_mixed (bool): Whether the features are those of all taxels together.
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


def apply_to_frames(layer: Module, h: Tensor) -> Tensor:
    r"""Returns the output of a layer for each frame :math:`(B, M, T, O)`.

    Args:
        layer (torch.nn.Module): A layer from :math:`(S, N, F)` to :math:`(S, M, O)`.
        h (torch.Tensor): Features :math:`(B, N, T, F)`.
    """
    out: Tensor = layer(h.transpose(1, 2).flatten(0, 1))
    return out.unflatten(0, (h.size(0), h.size(2))).transpose(1, 2)
