r"""A ring buffer of the last frames of a live sensor."""

from typing import Any

import torch
from torch import Tensor

from torch_geometric_tactile.data._ring import Ring
from torch_geometric_tactile.data.frames import join_frames


class FrameRing:
    r"""A ring buffer of the last :obj:`length` frames of a live sensor.

    Once the buffer is full, :meth:`window` returns bit for bit the window that
    :class:`~torch_geometric_tactile.data.Windows` cuts from a recording of these frames.

    Args:
        length (int): Number of frames in a window :math:`T`.
        num_taxels (int): Number of taxels :math:`N`.
        num_channels (int): Number of channels of each taxel :math:`C`, such as axes or fingers.
        dtype (torch.dtype): Type of the readings.

    Raises:
        ValueError: If a size is below one.

    Examples:
        >>> ring = FrameRing(length=2, num_taxels=1, num_channels=2)
        >>> for frame in ([[1.0, 10.0]], [[2.0, 20.0]], [[3.0, 30.0]]):
        ...     ring.push(frame)
        >>> ring.is_full, ring.window()
        (True, tensor([[ 2.,  3., 20., 30.]]))
    """

    def __init__(
        self,
        length: int,
        num_taxels: int,
        num_channels: int,
        dtype: torch.dtype = torch.float,
    ) -> None:
        sizes = {"length": length, "num_taxels": num_taxels, "num_channels": num_channels}
        for name, size in sizes.items():
            if size < 1:
                raise ValueError(f"'{name}' must be at least 1 (got {size})")
        self.length = length
        self.num_taxels = num_taxels
        self.num_channels = num_channels
        self._ring = Ring(torch.zeros(2 * length, num_taxels, num_channels, dtype=dtype))

    def __len__(self) -> int:
        return min(self._ring.count, self.length)

    @property
    def is_full(self) -> bool:
        r"""Whether there are enough frames for a window."""
        return self._ring.count >= self.length

    def push(self, frame: Any) -> None:
        r"""Adds a frame, and removes the oldest frame if the buffer is full.

        Args:
            frame (array-like): Readings :math:`(N, C)`. Missing readings are NaN.

        Raises:
            ValueError: If the frame has the wrong shape.
        """
        frame = torch.as_tensor(frame)
        shape = (self.num_taxels, self.num_channels)
        if tuple(frame.shape) != shape:
            raise ValueError(
                f"'frame' must have shape {shape}, (num_taxels, num_channels) (got "
                f"{tuple(frame.shape)})"
            )
        self._ring.push(frame)

    def window(self) -> Tensor:
        r"""Returns a copy of the last frames as a window :math:`(N, C \cdot T)`.

        Raises:
            RuntimeError: If there are not enough frames yet.
        """
        if not self.is_full:
            raise RuntimeError(
                f"the ring must hold {self.length} frames for a window (got {len(self)}): push "
                "more frames, and check 'is_full' first"
            )
        return join_frames(self._ring.last().transpose(0, 1)).clone()

    def clear(self) -> None:
        r"""Removes all frames, for example when a new trial starts."""
        self._ring.count = 0

    def __repr__(self) -> str:
        sizes = f"{self.length}, num_taxels={self.num_taxels}, num_channels={self.num_channels}"
        return f"{type(self).__name__}({sizes})"
