r"""Descriptors of the readings of each channel."""

import torch
from torch import Tensor
from torch_geometric.data import Batch, Data
from torch_geometric.data.datapipes import functional_transform

from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile.data import split_frames
from torch_geometric_tactile.sensors import (
    TaxelLayout,
    as_layout,
    descriptor_names,
    taxel_descriptors,
)
from torch_geometric_tactile.transforms._attributes import (
    FRAMES,
    check_num_taxels,
    require_floats,
    require_pos,
)
from torch_geometric_tactile.transforms._segments import repeat_rows
from torch_geometric_tactile.transforms._windows import get_num_frames, refuse_ragged
from torch_geometric_tactile.transforms.tactile_transform import TactileTransform

_WINDOW_PREFIXES = ("last", "change", "time_mean", "time_deviation")


@functional_transform("taxel_descriptors")
class TaxelDescriptors(TactileTransform):
    r"""Computes descriptors of the readings of each channel (functional name:
    :obj:`taxel_descriptors`): statistics, centroid, contact area and oriented slopes. They work for
    any layout and need no training. See
    :func:`~torch_geometric_tactile.sensors.taxel_descriptors`.

    Scale the readings first, with one scale for each channel (see
    :class:`~torch_geometric_tactile.transforms.ZScore`).

    For windows (:class:`~torch_geometric_tactile.data.Windows`), the output contains the
    descriptors of the last frame, the descriptors of the change from the first to the last frame,
    and the mean and standard deviation of the descriptors over all frames.

    Args:
        layout (TaxelLayout or str or PathLike): The taxels: a layout, the name of a layout of this
            package, or a layout file.
        posed (bool): If :obj:`True`, centroid and moments are computed from the positions
            :obj:`pos` of each sample, which :class:`TaxelPose` sets; otherwise, from the positions
            in the layout.

    Shapes:
        - **input:** readings :math:`(N, F)`, :math:`(B, N, F)` or a PyG batch :math:`(B \cdot N,
          F)`; for windows :math:`F = C \cdot T`
        - **output:** :obj:`descriptors` :math:`(1, K)` or :math:`(B, K)`, named by :meth:`names`.
          A missing reading (NaN) is replaced by the mean of its neighbours.

    Raises:
        ValueError: If a sample has the wrong number of taxels, no readings, windows of several
            lengths, or, with :obj:`posed`, no positions.

    Examples:
        >>> transform = TaxelDescriptors("biotac_sp")
        >>> transform(Data(x=torch.rand(24, 1)))
        Data(x=[24, 1], descriptors=[1, 150])
    """

    writes = ("descriptors",)
    per_frame = False

    @property
    def reads(self) -> tuple[str, ...]:
        r"""The readings, and the positions with :obj:`posed`."""
        return ("x", *FRAMES, "pos") if self.posed else ("x", *FRAMES)

    def __init__(self, layout: TaxelLayout | PathLike, posed: bool = False) -> None:
        self.layout = as_layout(layout)
        self.posed = posed

    def names(self, num_channels: int = 1, of_windows: bool = False) -> list[str]:
        r"""Returns the names of the descriptors, in their order.

        Args:
            num_channels (int): Number of channels of a taxel.
            of_windows (bool): Whether the samples are windows of frames.
        """
        names = descriptor_names(self.layout)
        channel_names = [f"{name}_channel_{i}" for i in range(num_channels) for name in names]
        if not of_windows:
            return channel_names
        return [f"{prefix}_{name}" for prefix in _WINDOW_PREFIXES for name in channel_names]

    def forward(self, data: Data) -> Data:
        r"""Sets :obj:`descriptors`."""
        x = require_floats(self, data)
        num_taxels = self.layout.num_taxels
        check_num_taxels(data, num_taxels, f"layout '{self.layout.name}'")
        rows = x.reshape(-1, num_taxels, x.size(-1))
        pos = self._sample_pos(data)
        num_frames = get_num_frames(data)
        if num_frames is None:
            data.descriptors = taxel_descriptors(rows, self.layout, pos)
        else:
            refuse_ragged(self, data)
            data.descriptors = self._window_descriptors(
                split_frames(rows, num_frames).transpose(1, 2), pos
            )
        return data

    def _sample_pos(self, data: Data) -> Tensor | None:
        if not self.posed:
            return None
        pos = require_pos(self, data)
        return pos.view(-1, self.layout.num_taxels, 3) if isinstance(data, Batch) else pos

    def _window_descriptors(self, frames: Tensor, pos: Tensor | None) -> Tensor:
        # The descriptors of windows (B, K) from their frames (B, T, N, C).
        size = frames.shape[:2]
        if pos is not None and pos.dim() == 3:
            pos = repeat_rows(pos, size[1])
        descriptors = taxel_descriptors(frames.flatten(0, 1), self.layout, pos).unflatten(0, size)
        change = frames[:, -1] - frames[:, 0]
        last_pos = None if pos is None else pos if pos.dim() == 2 else pos[size[1] - 1 :: size[1]]
        mean = descriptors.mean(dim=1)
        deviation = (descriptors - mean.unsqueeze(1)).square().mean(dim=1).sqrt()
        change_descriptors = taxel_descriptors(change, self.layout, last_pos)
        return torch.cat([descriptors[:, -1], change_descriptors, mean, deviation], dim=1)
