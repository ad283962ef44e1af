r"""Windows with another number of frames."""

from collections.abc import Callable, Set
from functools import lru_cache
from math import ceil

import torch
from torch import Tensor
from torch.nn.functional import pad
from torch_geometric.data import Data
from torch_geometric.data.datapipes import functional_transform

from torch_geometric_tactile.data import StaticData
from torch_geometric_tactile.transforms._attributes import FRAMES
from torch_geometric_tactile.transforms._random import check_whole
from torch_geometric_tactile.transforms._windows import (
    joined_signals,
    require_signals,
    valid_frames,
)
from torch_geometric_tactile.transforms.tactile_transform import TactileTransform

_MOST_FRAMES = 100_000
# The filter of `scipy.signal.resample_poly`: a Kaiser window of ten new frames to each side.
_HALF_WIDTH = 10
_BETA = 5.0

_Neighbours = Callable[[Tensor], tuple[Tensor, Tensor]]


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
            out[chosen] = _resampled(rows, self.num).view(-1, *out.shape[1:])
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
        signals = _resampled(signals, num, _neighbours_in_steps)
        data.x = joined_signals(signals, data)
        data.num_frames = num
        return data


def _resampled(signals: Tensor, num: int, neighbours: _Neighbours | None = None) -> Tensor:
    r"""Returns signals with another number of frames.

    Shapes:
        - **signals:** The signals :math:`(\ldots, L)`.
        - **num:** Number of new frames :math:`T`, at least two.
        - **output:** :math:`(\ldots, T)`
    """
    length = signals.size(-1)
    if length == num:
        return signals
    values, missing = signals.double(), signals.isnan()
    has_gaps = neighbours is not None or bool(missing.any())  # of a graph: there may be some
    if has_gaps:
        values = _bridged(values, missing, *(neighbours or _neighbours)(missing))
    level = values[..., :1]  # what is constant stays so to the last bit
    matrix = _resampling_matrix(length, num).to(signals.device)
    out = (level + (values - level) @ matrix.t()).to(signals.dtype)
    out = torch.cat([signals[..., :1], out[..., 1:-1], signals[..., -1:]], dim=-1)
    if has_gaps:
        nearest = (_new_times(length, num) + 0.5).floor().long().to(signals.device)
        out = out.masked_fill(missing[..., nearest], torch.nan)
    return out


def _bridged(values: Tensor, missing: Tensor, left: Tensor, right: Tensor) -> Tensor:
    # Straight lines over the gaps, the nearest reading beyond the ends, zero if there is none.
    length = values.size(-1)
    first, last = left.clamp(min=0), right.clamp(max=length - 1)
    first, last = torch.where(left < 0, last, first), torch.where(right >= length, first, last)
    start, stop = values.gather(-1, first), values.gather(-1, last)
    part = (torch.arange(length, device=values.device) - first) / (last - first).clamp(min=1)
    line = start + part * (stop - start)
    return torch.where(missing, line, values).nan_to_num(nan=0.0)


def _neighbours(missing: Tensor) -> tuple[Tensor, Tensor]:
    # The last frame up to each that is there, and the first from each on; -1 or L if there is none.
    length = missing.size(-1)
    frames = torch.arange(length, device=missing.device).expand_as(missing)
    left = frames.masked_fill(missing, -1).cummax(dim=-1).values
    right = frames.masked_fill(missing, length).flip(-1).cummin(dim=-1).values.flip(-1)
    return left, right


def _neighbours_in_steps(missing: Tensor) -> tuple[Tensor, Tensor]:
    # With running maxima in steps of 1, 2, 4 and so on frames: a graph has none in one operation.
    length = missing.size(-1)
    frames = torch.arange(length)
    left = torch.where(missing, -1, frames)
    right = torch.where(missing, length, frames)
    step = 1
    while step < length:
        left = torch.maximum(left, pad(left[..., :-step], (step, 0), value=-1))
        right = torch.minimum(right, pad(right[..., step:], (0, step), value=length))
        step *= 2
    return left, right


@lru_cache(maxsize=128)
def _resampling_matrix(length: int, num: int) -> Tensor:
    r"""Returns the weights of old frames in each new one.

    Constant signals and ramps stay what they are, and the first and the last frame are kept.

    Shapes:
        - **length:** Number of old frames :math:`L`.
        - **num:** Number of new frames :math:`T`, at least two.
        - **output:** :math:`(T, L)`, double, not to be written to
    """
    if length == num:
        return torch.eye(num, dtype=torch.double)
    times = _new_times(length, num)
    weight = _interpolated(times, length) if length < num else _filtered(times, length)
    ends = torch.zeros(2, length, dtype=torch.double)
    ends[0, 0] = ends[1, -1] = 1.0
    weight[0], weight[-1] = ends
    return weight


def _new_times(length: int, num: int) -> Tensor:
    r"""Returns where new frames are, counted in old ones: evenly from the first to the last.

    Shapes:
        - **length:** Number of old frames :math:`L`.
        - **num:** Number of new frames :math:`T`, at least two.
        - **output:** :math:`(T,)`, double
    """
    return torch.arange(num, dtype=torch.double) * (length - 1) / (num - 1)


def _interpolated(times: Tensor, length: int) -> Tensor:
    frames = torch.arange(length, dtype=torch.double)
    return (1 - (frames - times.unsqueeze(1)).abs()).clamp(min=0)


def _filtered(times: Tensor, length: int) -> Tensor:
    num = len(times)
    step = (length - 1) / (num - 1)
    half = min(_HALF_WIDTH, num - 1)
    reach = min(ceil(half * step), length - 1)
    frames = torch.arange(-reach, length + reach, dtype=torch.double)
    distance = frames - times.unsqueeze(1)
    window = (1 - (distance / (half * step)).square()).clamp(min=0)
    window = torch.special.i0(_BETA * window.sqrt()) * (distance.abs() <= half * step + 1e-9)
    weight = _of_ramps(torch.sinc(distance / step) * window, window, distance)
    return _folded(weight, frames, length)


def _of_ramps(weight: Tensor, window: Tensor, distance: Tensor) -> Tensor:
    # Sampled between frames, the weights sum to one and balance about their middle only nearly.
    weight = weight / weight.sum(dim=1, keepdim=True)
    moments = [(window * distance**power).sum(dim=1) for power in (0, 1, 2)]
    excess = (weight * distance).sum(dim=1)
    scale = moments[0] * moments[2] - moments[1].square()
    level, slope = moments[1] * excess / scale, -moments[0] * excess / scale
    return weight + window * (level.unsqueeze(1) + slope.unsqueeze(1) * distance)


def _folded(weight: Tensor, frames: Tensor, length: int) -> Tensor:
    # Beyond its ends a signal goes on turned about its end point, as ramps do.
    index = frames.long()
    before, after = index < 0, index >= length
    out = weight[:, ~(before | after)].clone()
    out.index_add_(1, -index[before], weight[:, before], alpha=-1)
    out.index_add_(1, 2 * (length - 1) - index[after], weight[:, after], alpha=-1)
    out[:, 0] += 2 * weight[:, before].sum(dim=1)
    out[:, -1] += 2 * weight[:, after].sum(dim=1)
    return out
