r"""Windows with another number of frames."""

from collections.abc import Callable, Set

import torch
from torch import Tensor
from torch.nn.functional import pad
from torch_geometric.data import Data
from torch_geometric.data.datapipes import functional_transform

from torch_geometric_tactile.data import StaticData
from torch_geometric_tactile.transforms._attributes import FRAMES
from torch_geometric_tactile.transforms._random import check_whole
from torch_geometric_tactile.transforms._resampling import new_times, resampled, resampling_matrix
from torch_geometric_tactile.transforms._windows import (
    joined_signals,
    require_signals,
    valid_frames,
)
from torch_geometric_tactile.transforms.tactile_transform import TactileTransform

_MOST_FRAMES = 100_000


@functional_transform("resample")
class Resample(TactileTransform):
    r"""Resamples the frames of each window to :obj:`num` frames (functional name: :obj:`resample`),
    60 in the "Tactile Grasp Stability Classification Based on Graph Convolutional Networks" paper.
    Windows of different lengths have the same length afterwards.

    New frames are spaced evenly from the first to the last of a window, which both are kept as they
    are. What is constant stays so, and a ramp stays a ramp.

    * **To fewer frames** the signals are filtered first, so that what is faster than half the new
      rate does not come back as something slow: with a sinc and a Kaiser window
      (:math:`\beta = 5`) of ten new frames to each side, as in
      :func:`scipy.signal.resample_poly`, for any ratio. Beyond their ends signals go on turned
      about the end point, as with :obj:`padtype="odd"` in :func:`scipy.signal.filtfilt`. A step
      rings by a few percent.
    * **To more frames** they are joined by straight lines: nothing goes beyond what was measured.

    Missing readings (NaN) do not spread: the signal of a taxel is bridged by straight lines, and a
    new frame is missing where the old one nearest to it is. A taxel that is missing throughout
    stays so.

    It needs the whole window: live, frames are collected until it is complete
    (:obj:`causal = False`). Other time series of a sample are left alone.

    Args:
        num (int): Number of frames of each window after it, at least two.

    Shapes:
        - **input:** windows :math:`(N, C \cdot T)`, :math:`(B, N, C \cdot T)` or a PyG batch
          :math:`(B \cdot N, C \cdot T)`, with :obj:`num_frames` :math:`T`; of padded ones
          :obj:`valid_frames` :math:`(B,)`
        - **output:** the same leading shape, with :math:`C \cdot` :obj:`num` features and
          :obj:`num_frames` :obj:`num`, without :obj:`valid_frames`

    Raises:
        ValueError: If :obj:`num` is not 2 to 100,000, there are no readings or no
            :obj:`num_frames`, or :obj:`valid_frames` are not 1 to :math:`T`.

    Examples:
        >>> window = Data(x=torch.tensor([[0.0, 2.0, 4.0, 6.0, 8.0]]), num_frames=5)
        >>> Resample(3)(window).x
        tensor([[0., 4., 8.]])
        >>> Resample(9)(window).x
        tensor([[0., 1., 2., 3., 4., 5., 6., 7., 8.]])
    """

    reads = writes = ("x", *FRAMES)
    per_frame = False
    causal = False

    def __init__(self, num: int = 60) -> None:
        self.num = check_whole("num", num, 2, _MOST_FRAMES)

    def forward(self, data: Data) -> Data:
        r"""Sets :obj:`x` and :obj:`num_frames`."""
        signals = require_signals(self, data)
        valid = valid_frames(data, len(signals), signals.size(-1), signals.device)
        out = signals.new_empty((*signals.shape[:-1], self.num))
        for length in valid.unique().tolist():  # windows of one length at once
            chosen = (valid == length).nonzero().view(-1)
            rows: Tensor = signals if len(chosen) == len(signals) else signals[chosen]
            rows = rows[..., :length].flatten(0, -2)
            out[chosen] = resampled(rows, self.num).view(-1, *out.shape[1:])
        data.x = joined_signals(out, data)
        old = data.num_frames
        data.num_frames = torch.full_like(old, self.num) if isinstance(old, Tensor) else self.num
        if "valid_frames" in data:
            del data.valid_frames
        return data

    def graph_step(
        self, known: StaticData, changing: Set[str]
    ) -> Callable[[StaticData], StaticData]:
        r"""Returns a product with a matrix, for windows of one length."""
        return _Resampled(self)

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.num})"


class _Resampled:
    r"""Windows of one length with another number of frames."""

    def __init__(self, part: Resample) -> None:
        self.part = part

    def __call__(self, data: StaticData) -> StaticData:
        if getattr(data, "valid_frames", None) is not None:
            raise NotImplementedError(f"{self.part!r} cannot be exported for padded windows")
        signals, num = require_signals(self.part, data), self.part.num
        length = signals.size(-1)
        if length != num:
            matrix = resampling_matrix(length, num).t()
            nearest = (new_times(length, num) + 0.5).floor().long()
            missing = signals.isnan()
            bridged = _bridged(signals.double(), missing)
            level = bridged[..., :1]
            out = (level + (bridged - level) @ matrix).to(signals.dtype)
            out = torch.cat([signals[..., :1], out[..., 1:-1], signals[..., -1:]], dim=-1)
            signals = out.masked_fill(missing[..., nearest], torch.nan)
        data.x = joined_signals(signals, data)
        data.num_frames = num
        return data


def _bridged(values: Tensor, missing: Tensor) -> Tensor:
    # As of `_resampling`, with running maxima in steps of 1, 2, 4 and so on frames, since a graph
    # has none in one operation.
    length = values.size(-1)
    frames = torch.arange(length)
    left = torch.where(missing, -1, frames)
    right = torch.where(missing, length, frames)
    step = 1
    while step < length:
        left = torch.maximum(left, pad(left[..., :-step], (step, 0), value=-1))
        right = torch.minimum(right, pad(right[..., step:], (0, step), value=length))
        step *= 2
    first, last = left.clamp(min=0), right.clamp(max=length - 1)
    first, last = torch.where(left < 0, last, first), torch.where(right >= length, first, last)
    start, stop = values.gather(-1, first), values.gather(-1, last)
    part = (frames - first) / (last - first).clamp(min=1)
    line = start + part * (stop - start)
    return torch.where(missing, line, values).nan_to_num(nan=0.0)
