r"""Resampling of windows to a given number of frames."""

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
from torch_geometric_tactile.transforms._random import check_integer
from torch_geometric_tactile.transforms._windows import (
    require_signals,
    signals_to_windows,
    valid_frames,
)
from torch_geometric_tactile.transforms.tactile_transform import TactileTransform

_MAX_FRAMES = 100_000
# The filter of `scipy.signal.resample_poly`: a Kaiser window of ten new frames on each side.
_HALF_WIDTH = 10
_BETA = 5.0

_Neighbours = Callable[[Tensor], tuple[Tensor, Tensor]]


@functional_transform("resample")
class Resample(TactileTransform):
    r"""Resamples each window to :obj:`num` frames (functional name: :obj:`resample`), so that
    windows of different lengths get the same length. The "Tactile Grasp Stability Classification
    Based on Graph Convolutional Networks" paper uses 60 frames.

    New frames are spaced evenly from the first to the last frame of a window, which do not change.
    Constant signals and ramps are preserved.

    * **With fewer frames**, the signals are low-pass filtered to avoid aliasing. The filter is a
      sinc with a Kaiser window (:math:`\beta = 5`) of ten new frames on each side, as in
      :func:`scipy.signal.resample_poly`, for any ratio. Signals are extended by odd reflection at
      their ends, as with :obj:`padtype="odd"` in :func:`scipy.signal.filtfilt`. A step overshoots
      by a few percent.
    * **With more frames**, the signals are interpolated linearly, so that they stay within the
      measured range.

    Missing readings (NaN) do not spread: they are interpolated linearly before resampling, and a
    new frame is missing if the nearest old frame is missing. A taxel without any reading stays
    missing.

    The transform needs the complete window (:obj:`causal = False`): live, frames are collected
    until the window is complete. Other time series of a sample are not resampled.

    Args:
        num (int): Number of frames in each resampled window, at least two.

    Shapes:
        - **input:** windows :math:`(N, C \cdot T)`, :math:`(B, N, C \cdot T)` or a PyG batch
          :math:`(B \cdot N, C \cdot T)`, with :obj:`num_frames` :math:`T`; padded windows with
          :obj:`valid_frames` :math:`(B,)`
        - **output:** the same leading shape, with :math:`C \cdot` :obj:`num` features and
          :obj:`num_frames` :obj:`num`, without :obj:`valid_frames`

    Raises:
        ValueError: If :obj:`num` is not between 2 and 100,000, there are no readings or no
            :obj:`num_frames`, or :obj:`valid_frames` are not between 1 and :math:`T`.

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
        self.num = check_integer("num", num, 2, _MAX_FRAMES)

    def forward(self, data: Data) -> Data:
        r"""Sets :obj:`x` and :obj:`num_frames`."""
        signals = require_signals(self, data)
        valid = valid_frames(data, len(signals), signals.size(-1), signals.device)
        out = signals.new_empty((*signals.shape[:-1], self.num))
        for length in valid.unique().tolist():  # windows of equal length share a matrix
            index = (valid == length).nonzero().view(-1)
            rows: Tensor = signals if len(index) == len(signals) else signals[index]
            rows = rows[..., :length].flatten(0, -2)
            out[index] = _resample(rows, self.num).view(-1, *out.shape[1:])
        data.x = signals_to_windows(out, data)
        # In a PyG batch, this is a tensor with a number for each sample.
        old_num = data.num_frames
        data.num_frames = (
            torch.full_like(old_num, self.num) if isinstance(old_num, Tensor) else self.num
        )
        if "valid_frames" in data:
            del data.valid_frames
        return data

    def graph_step(
        self, constants: StaticData, changing: Set[str]
    ) -> Callable[[StaticData], StaticData]:
        r"""Returns a step that multiplies windows of one length by a matrix."""
        return _ResampleStep(self)

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.num})"


class _ResampleStep:
    r"""The step of :class:`Resample` in an exported graph, for windows without padding."""

    def __init__(self, part: Resample) -> None:
        self.part = part

    def __call__(self, data: StaticData) -> StaticData:
        if getattr(data, "valid_frames", None) is not None:
            raise NotImplementedError(f"{self.part!r} cannot be exported for padded windows")
        signals, num = require_signals(self.part, data), self.part.num
        signals = _resample(signals, num, _neighbours_by_doubling)
        data.x = signals_to_windows(signals, data)
        data.num_frames = num
        return data


def _resample(signals: Tensor, num: int, neighbours: _Neighbours | None = None) -> Tensor:
    r"""Resamples signals to another number of frames.

    Args:
        signals (torch.Tensor): The signals :math:`(\ldots, L)`.
        num (int): Number of new frames :math:`T`, at least two.
        neighbours (callable, optional): Finds the frames next to missing values in an exported
            graph.

    Shapes:
        - **output:** :math:`(\ldots, T)`
    """
    length = signals.size(-1)
    if length == num:
        return signals
    values, missing = signals.double(), signals.isnan()
    # An exported graph cannot depend on values, so it always handles missing readings.
    may_miss = neighbours is not None or bool(missing.any())
    if may_miss:
        values = _fill_missing(values, missing, *(neighbours or _neighbours)(missing))
    # With the first value subtracted, a constant signal is zero and stays constant despite
    # rounding.
    level = values[..., :1]
    matrix = _resampling_matrix(length, num).to(signals.device)
    out = (level + (values - level) @ matrix.t()).to(signals.dtype)
    out = torch.cat([signals[..., :1], out[..., 1:-1], signals[..., -1:]], dim=-1)
    if may_miss:
        nearest = (_new_times(length, num) + 0.5).floor().long().to(signals.device)
        out = out.masked_fill(missing[..., nearest], torch.nan)
    return out


def _fill_missing(values: Tensor, missing: Tensor, left: Tensor, right: Tensor) -> Tensor:
    # Interpolates missing values linearly, and extends signals with their first and last value. A
    # signal without any value becomes zero. `left` and `right` are the neighbouring frames with
    # values.
    length = values.size(-1)
    first, last = left.clamp(min=0), right.clamp(max=length - 1)
    first, last = torch.where(left < 0, last, first), torch.where(right >= length, first, last)
    start, stop = values.gather(-1, first), values.gather(-1, last)
    weight = (torch.arange(length, device=values.device) - first) / (last - first).clamp(min=1)
    interpolated = start + weight * (stop - start)
    return torch.where(missing, interpolated, values).nan_to_num(nan=0.0)


def _neighbours(missing: Tensor) -> tuple[Tensor, Tensor]:
    # Returns the last frame with a value at or before each frame (-1 if there is none), and the
    # first frame with a value at or after it (L if there is none).
    length = missing.size(-1)
    frames = torch.arange(length, device=missing.device).expand_as(missing)
    left = frames.masked_fill(missing, -1).cummax(dim=-1).values
    right = frames.masked_fill(missing, length).flip(-1).cummin(dim=-1).values.flip(-1)
    return left, right


def _neighbours_by_doubling(missing: Tensor) -> tuple[Tensor, Tensor]:
    # Like `_neighbours`, for ONNX, which has no running maximum: the maximum is computed over 1, 2,
    # 4, ... frames.
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
    r"""Returns the weights of the old frames in each new frame. The weights preserve constant
    signals, ramps, and the first and the last frame.

    Args:
        length (int): Number of old frames :math:`L`.
        num (int): Number of new frames :math:`T`, at least two.

    Shapes:
        - **output:** :math:`(T, L)`, in double precision; the matrix is cached and must not be
          written to
    """
    if length == num:
        return torch.eye(num, dtype=torch.double)
    times = _new_times(length, num)
    weight = _linear_weights(times, length) if length < num else _filter_weights(times, length)
    ends = torch.zeros(2, length, dtype=torch.double)
    ends[0, 0] = ends[1, -1] = 1.0
    weight[0], weight[-1] = ends
    return weight


def _new_times(length: int, num: int) -> Tensor:
    r"""Returns the times of the new frames in units of old frames. The times are spaced evenly from
    the first to the last old frame.

    Args:
        length (int): Number of old frames :math:`L`.
        num (int): Number of new frames :math:`T`, at least two.

    Shapes:
        - **output:** :math:`(T,)`, in double precision
    """
    return torch.arange(num, dtype=torch.double) * (length - 1) / (num - 1)


def _linear_weights(times: Tensor, length: int) -> Tensor:
    frames = torch.arange(length, dtype=torch.double)
    return (1 - (frames - times.unsqueeze(1)).abs()).clamp(min=0)


def _filter_weights(times: Tensor, length: int) -> Tensor:
    # The weights of a windowed sinc. The sinc is also evaluated on frames beyond both ends, whose
    # weights are then moved to frames of the signal.
    num = len(times)
    step = (length - 1) / (num - 1)
    half_width = min(_HALF_WIDTH, num - 1)
    margin = min(ceil(half_width * step), length - 1)
    frames = torch.arange(-margin, length + margin, dtype=torch.double)
    distance = frames - times.unsqueeze(1)
    window = (1 - (distance / (half_width * step)).square()).clamp(min=0)
    window = torch.special.i0(_BETA * window.sqrt()) * (distance.abs() <= half_width * step + 1e-9)
    weight = _preserve_ramps(torch.sinc(distance / step) * window, window, distance)
    return _fold_ends(weight, frames, length)


def _preserve_ramps(weight: Tensor, window: Tensor, distance: Tensor) -> Tensor:
    # A sampled filter preserves constants and ramps only approximately: its weights must sum to
    # one, and their mean distance must be zero. A linear function times the window is added to
    # make the distance zero.
    weight = weight / weight.sum(dim=1, keepdim=True)
    moments = [(window * distance**power).sum(dim=1) for power in (0, 1, 2)]
    excess = (weight * distance).sum(dim=1)
    scale = moments[0] * moments[2] - moments[1].square()
    level, slope = moments[1] * excess / scale, -moments[0] * excess / scale
    return weight + window * (level.unsqueeze(1) + slope.unsqueeze(1) * distance)


def _fold_ends(weight: Tensor, frames: Tensor, length: int) -> Tensor:
    # Moves the weights of frames beyond the ends to frames of the signal, which is extended by odd
    # reflection about its end points: x[-i] = 2 x[0] - x[i].
    index = frames.long()
    before, after = index < 0, index >= length
    out = weight[:, ~(before | after)].clone()
    out.index_add_(1, -index[before], weight[:, before], alpha=-1)
    out.index_add_(1, 2 * (length - 1) - index[after], weight[:, after], alpha=-1)
    out[:, 0] += 2 * weight[:, before].sum(dim=1)
    out[:, -1] += 2 * weight[:, after].sum(dim=1)
    return out
