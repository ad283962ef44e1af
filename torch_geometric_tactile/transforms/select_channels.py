r"""Selection of channels."""

from collections.abc import Sequence

import torch
from torch import Tensor
from torch_geometric.data import Data
from torch_geometric.data.datapipes import functional_transform

from torch_geometric_tactile.data import join_frames, split_frames
from torch_geometric_tactile.transforms._attributes import FRAMES, require_x
from torch_geometric_tactile.transforms._windows import get_num_frames
from torch_geometric_tactile.transforms.tactile_transform import TactileTransform


@functional_transform("select_channels")
class SelectChannels(TactileTransform):
    r"""Selects channels of the readings (functional name: :obj:`select_channels`).

    Use it, for example, to select fingers of
    :class:`~torch_geometric_tactile.datasets.BioTacSP`, whose channels are the fingers, or the
    pressure of a skin that also measures shear.

    In windows, which have :obj:`num_frames`, all frames of a channel are selected. In other
    samples, each feature of a taxel is a channel.

    Args:
        channels (sequence of int): Numbers of the channels, counted from 0, in the order of the
            output.

    Shapes:
        - **input:** readings :math:`(N, F)`, :math:`(B, N, F)` or a PyG batch :math:`(B \cdot N,
          F)`; for windows :math:`F = C \cdot T`
        - **output:** the same leading shape, with the selected channels

    Raises:
        ValueError: If no channel is selected, a number is repeated or below 0, or the readings lack
            a channel.

    Examples:
        >>> data = Data(x=torch.tensor([[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]))
        >>> SelectChannels([2, 0])(data).x
        tensor([[3., 1.],
                [6., 4.]])
    """

    reads, writes = ("x", *FRAMES), ("x",)
    per_frame = True

    def __init__(self, channels: Sequence[int] | Tensor) -> None:
        index = torch.as_tensor(channels).cpu()
        is_integer = index.dtype in (torch.int64, torch.int32, torch.int16, torch.uint8, torch.int8)
        if index.dim() != 1 or len(index) == 0 or not is_integer:
            raise ValueError(f"'channels' must be a list of numbers of channels (got {channels})")
        self.channels: list[int] = index.tolist()
        if min(self.channels) < 0 or len(set(self.channels)) < len(self.channels):
            raise ValueError(
                f"'channels' must be numbered from 0, each named once (got {self.channels})"
            )

    def forward(self, data: Data) -> Data:
        r"""Sets :obj:`x`."""
        x = require_x(self, data)
        num_frames = get_num_frames(data)
        channels = x if num_frames is None else split_frames(x, num_frames)
        if max(self.channels) >= channels.size(-1):
            raise ValueError(
                f"'x' must have channel {max(self.channels)} (got {channels.size(-1)} channels, "
                "numbered from 0)"
            )
        selection = channels[..., self.channels]
        data.x = selection if num_frames is None else join_frames(selection)
        return data

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.channels})"
