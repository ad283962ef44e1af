r"""An encoder of tactile readings for robot policies."""

from collections.abc import Sequence
from typing import Optional, Union

import torch
from torch import Tensor
from torch.nn import Module
from torch_geometric.typing import OptTensor

from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile.nn.models.temporal_taxel_net import TemporalTaxelNet
from torch_geometric_tactile.sensors import TaxelLayout


class TouchEncoder(Module):
    r"""Encodes the last frames of tactile readings as a vector, for example as a token for a robot
    policy. It supports any layout. It is not from a paper.

    It is a :class:`~torch_geometric_tactile.nn.models.TemporalTaxelNet` that returns features
    instead of logits: it applies convolutions over neighbouring taxels in each frame, then causal
    convolutions over time. The input is a plain tensor in which time comes before the taxels, as is
    common in policies. No data set or graph from this package is needed. The output is the features
    of the last frame of a window, which depend on the last :attr:`receptive_field` frames,

    .. math::
        R = F + 2 D (2^L - 1)

    with filters of :math:`F` frames and :math:`L` blocks, the first of which has the dilation
    :math:`D`. Before the first frame, all features are zero. Missing readings (NaN) are replaced by
    zero, which is the reading of a tared sensor at rest.

    :meth:`step` encodes one frame at a time with a state, for use on a running robot. Starting from
    :meth:`initial_state`, it returns the same features as :meth:`forward` on the same frames.

    Args:
        layout (TaxelLayout, str or PathLike): The layout, the name of a stock layout, or the path
            of a layout file.
        out_channels (int): Number of features :math:`D_{out}`.
        in_channels (int): Number of channels per taxel :math:`C`, for example three axes.
        num_joints (int): Number of joint angles, or other measurements from the robot, that are
            appended to the input of the hidden layer, or 0 for none.
        widths (sequence of int, optional): Width of each level, as in
            :class:`~torch_geometric_tactile.nn.models.TemporalTaxelNet`.
        num_filters (int): Number of filters on the readings of each taxel.
        filter_size (int): Length of these filters in frames :math:`F`.
        dilation (int): Distance between the frames of the kernel in the first block :math:`D`.
        num_blocks (int): Number of blocks over time :math:`L`.
        hidden_channels (int): Width of the hidden layer.
        dropout (float): Probability of dropping a feature during training.
        taxel_dropout (float): Probability of dropping a taxel of a window during training, so that
            a policy depends less on single taxels.

    Shapes:
        - **input:** readings :math:`(B, T, N, C)`; joint angles :math:`(B, J)` of the last frame,
          or :math:`(B, T, J)`
        - **output:** features :math:`(B, D_{out})`

    Raises:
        ValueError: If a size is below one, or :obj:`touch` or :obj:`joint` has the wrong shape.

    Examples:
        >>> encoder = TouchEncoder("biotac", 32, in_channels=3)
        >>> encoder
        TouchEncoder(19, 32, in_channels=3, receptive_field=8)
        >>> encoder(torch.zeros(5, 10, 19, 3)).shape
        torch.Size([5, 32])
        >>> state = encoder.eval().initial_state(1)
        >>> features, state = encoder.step(torch.zeros(1, 19, 3), state)
        >>> features.shape
        torch.Size([1, 32])
    """

    def __init__(
        self,
        layout: Union[TaxelLayout, PathLike],
        out_channels: int = 64,
        *,
        in_channels: int = 1,
        num_joints: int = 0,
        widths: Optional[Sequence[int]] = None,
        num_filters: int = 16,
        filter_size: int = 4,
        dilation: int = 2,
        num_blocks: int = 1,
        hidden_channels: int = 64,
        dropout: float = 0.0,
        taxel_dropout: float = 0.1,
    ) -> None:
        super().__init__()
        self.net = TemporalTaxelNet(
            layout,
            out_channels,
            in_channels=in_channels,
            num_joints=num_joints,
            widths=widths,
            num_filters=num_filters,
            filter_size=filter_size,
            dilation=dilation,
            num_blocks=num_blocks,
            hidden_channels=hidden_channels,
            dropout=dropout,
            taxel_dropout=taxel_dropout,
        )
        self.num_taxels = self.net.num_nodes
        self.in_channels = in_channels
        self.out_channels = out_channels
        self.num_joints = num_joints
        self.receptive_field = self.net.receptive_field

    def reset_parameters(self) -> None:
        r"""Resets all learnable parameters and running statistics."""
        self.net.reset_parameters()

    def forward(self, touch: Tensor, joint: OptTensor = None) -> Tensor:
        r"""Returns the features of the last frame :math:`(B, D_{out})`.

        Args:
            touch (torch.Tensor): Readings :math:`(B, T, N, C)`, with the newest frame last.
            joint (torch.Tensor, optional): Joint angles :math:`(B, J)`, or :math:`(B, T, J)`, of
                which only the last frame is used. Required if :obj:`num_joints` is not 0.
        """
        if touch.dim() != 4 or touch.shape[2:] != (self.num_taxels, self.in_channels):
            raise ValueError(
                f"'touch' must have shape (batch_size, num_frames, {self.num_taxels}, "
                f"{self.in_channels}) (got {tuple(touch.shape)})"
            )
        if joint is not None and joint.dim() == 3:
            joint = joint[:, -1]
        windows = _fill_missing(touch).permute(0, 2, 3, 1).flatten(2)
        out: Tensor = self.net(windows, joint=joint)
        return out

    def initial_state(
        self,
        batch_size: int,
        device: torch.device | str | None = None,
        dtype: torch.dtype | None = None,
    ) -> tuple[Tensor, ...]:
        r"""Returns the state before the first frame.

        Args:
            batch_size (int): Number of streams :math:`B`.
            device (torch.device, optional): Device of the state. Defaults to the device of the
                weights.
            dtype (torch.dtype, optional): Data type of the state. Defaults to the data type of the
                weights.
        """
        return self.net.initial_state(batch_size, device, dtype)

    def step(
        self, frame: Tensor, state: tuple[Tensor, ...], joint: OptTensor = None
    ) -> tuple[Tensor, tuple[Tensor, ...]]:
        r"""Returns the features of the next frame :math:`(B, D_{out})`, and the next state.

        Args:
            frame (torch.Tensor): Readings of the frame :math:`(B, N, C)`.
            state (tuple of torch.Tensor): State before the frame.
            joint (torch.Tensor, optional): Joint angles :math:`(B, J)`. Required if
                :obj:`num_joints` is not 0.
        """
        return self.net.step(_fill_missing(frame), None, state, joint)

    def __repr__(self) -> str:
        joints = f", num_joints={self.num_joints}" if self.num_joints else ""
        return (
            f"{type(self).__name__}({self.num_taxels}, {self.out_channels}, "
            f"in_channels={self.in_channels}, receptive_field={self.receptive_field}{joints})"
        )


def _fill_missing(readings: Tensor) -> Tensor:
    # `nan_to_num` would also make infinite readings finite.
    return torch.where(readings.isnan(), torch.zeros_like(readings), readings)
