r"""What random transforms share that draw a number for each segment and channel of a sample."""

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor
from torch_geometric.data import Data

from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile.sensors import TaxelLayout
from torch_geometric_tactile.transforms._attributes import FRAMES, require_x
from torch_geometric_tactile.transforms._random import check_deviation, normal
from torch_geometric_tactile.transforms._segments import Segments
from torch_geometric_tactile.transforms._windows import num_channels_and_frames, repeated
from torch_geometric_tactile.transforms.tactile_transform import TactileTransform


class SegmentDraws(TactileTransform):
    r"""Changes the readings by normal numbers, one for each segment and channel of each sample,
    the same for all frames of a window. A subclass defines :meth:`changed`.

    Args:
        std (float): Their standard deviation.
        segments (str or sequence of int, optional): What has one in common.
        layout (TaxelLayout or str or PathLike, optional): The taxels, where segments need them.
        generator (torch.Generator, optional): The source of random numbers; PyTorch's own if left
            out.

    Raises:
        ValueError: If :obj:`std` is negative or not finite, or :obj:`segments` is wrong.
    """

    reads, writes = ("x", *FRAMES), ("x",)
    per_frame = False  # one number for all frames
    is_random = True

    def __init__(
        self,
        std: float = 0.1,
        segments: str | Sequence[int] | Tensor | None = None,
        layout: TaxelLayout | PathLike | None = None,
        generator: torch.Generator | None = None,
    ) -> None:
        self.std = check_deviation(std)
        self.generator = generator
        self._segments = Segments(segments, layout)

    def arguments(self) -> dict[str, Any]:
        r"""Returns the arguments of the constructor; segments that were given are numbered anew."""
        rest = self._segments.arguments()
        return {"std": self.std, **rest, "generator": self.generator}

    def changed(self, x: Tensor, segment: Tensor, drawn: Tensor) -> Tensor:
        r"""Returns other readings.

        Args:
            x (torch.Tensor): The readings, in floating point.
            segment (torch.Tensor): The segment of each of their rows.
            drawn (torch.Tensor): The numbers of each segment and channel.
        """
        raise NotImplementedError

    def forward(self, data: Data) -> Data:
        r"""Changes the readings."""
        x = require_x(self, data)
        x = x if x.is_floating_point() else x.float()  # counts may be integers
        segment, count = self._segments.of_rows(data, x)
        num_channels, num_frames = num_channels_and_frames(data, x)
        drawn = normal(count * num_channels, x, self.generator).view(count, num_channels)
        drawn = repeated(drawn, num_frames)
        data.x = self.changed(x, segment, self.std * drawn)
        return data

    def __repr__(self) -> str:
        segments = f", {self._segments!r}" if self._segments.segment is not None else ""
        return f"{type(self).__name__}(std={self.std}{segments})"
