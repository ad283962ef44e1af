r"""What :class:`~torch_geometric_tactile.nn.models.TemporalTaxelNet` is made of: differences of
frames, and blocks of causal convolutions."""

import torch
import torch.nn.functional as F
from torch import Tensor
from torch.nn import Module

from torch_geometric_tactile.nn.conv import CausalTemporalConv
from torch_geometric_tactile.nn.models.byte_dropout import ByteDropout
from torch_geometric_tactile.nn.models.taxel_levels import TaxelNorm


class FrameDifference(Module):
    r"""Puts the difference to an earlier frame behind the readings of each taxel.

    A frame that was not seen, or not read (NaN), has no difference: it is zero.

    Args:
        in_channels (int): Number of channels :math:`C`.
        lag (int): How many frames earlier :math:`L`.

    Shapes:
        - **input:** readings :math:`(B, T, N, C)`; of a step :math:`(B, N, C)` and a state
          :math:`(B, L, N, C)`
        - **output:** :math:`(B, T, N, 2 C)`; of a step :math:`(B, N, 2 C)` and the next state
    """

    def __init__(self, in_channels: int, lag: int) -> None:
        super().__init__()
        self.in_channels = in_channels
        self.lag = lag

    def forward(self, x: Tensor) -> Tensor:
        r"""Returns readings and differences of all frames.

        Args:
            x (torch.Tensor): Readings.
        """
        past = F.pad(x, (0, 0, 0, 0, self.lag, 0), value=torch.nan)[:, : x.size(1)]
        return _with_difference(x, past)

    def step(self, x: Tensor, state: Tensor) -> tuple[Tensor, Tensor]:
        r"""Returns readings and differences of the next frame, and the state after it.

        Args:
            x (torch.Tensor): Readings of one frame.
            state (torch.Tensor): The state before it.
        """
        rows = torch.cat([state, x.unsqueeze(1)], dim=1)
        return _with_difference(x, rows[:, 0]), rows[:, 1:]


def _with_difference(x: Tensor, past: Tensor) -> Tensor:
    return torch.cat([x, torch.where(past.isnan(), 0.0, x - past)], dim=-1)


class TemporalBlock(Module):
    r"""A causal convolution, normalisation, ReLU and dropout, with the input added.

    Args:
        channels (int): Size of each feature, before and after.
        kernel_size (int): As of the convolution.
        dilation (int): As of the convolution.
        dropout (float): Part of the features dropped in training.
    """

    def __init__(self, channels: int, kernel_size: int, dilation: int, dropout: float) -> None:
        super().__init__()
        self.conv = CausalTemporalConv(channels, channels, kernel_size, dilation, bias=False)
        self.norm = TaxelNorm(channels)
        self.dropout = ByteDropout(dropout)

    def reset_parameters(self) -> None:
        r"""Draws all weights anew."""
        self.conv.reset_parameters()
        self.norm.reset_parameters()

    def forward(self, h: Tensor) -> Tensor:
        r"""Convolves features :math:`(B, T, F)`.

        Args:
            h (torch.Tensor): Features.
        """
        return self._join(h, self.conv(h))

    def step(self, h: Tensor, state: Tensor) -> tuple[Tensor, Tensor]:
        r"""Convolves the features :math:`(B, F)` of the next frame.

        Args:
            h (torch.Tensor): Features of one frame.
            state (torch.Tensor): The state of the convolution.
        """
        out, state = self.conv.step(h, state)
        return self._join(h, out), state

    def _join(self, h: Tensor, out: Tensor) -> Tensor:
        return h + self.dropout(self.norm(out).relu())
