r"""From one number of frames to another."""

from functools import lru_cache
from math import ceil

import torch
from torch import Tensor

# The filter of `scipy.signal.resample_poly`: a Kaiser window of ten new frames to each side.
_HALF_WIDTH = 10
_BETA = 5.0


@lru_cache(maxsize=128)
def resampling_matrix(length: int, num: int) -> Tensor:
    r"""Returns the weights of old frames in each new one.

    Constant signals and ramps stay what they are, and the first and the last frame are kept.

    Shapes:
        - **length:** Number of old frames :math:`L`.
        - **num:** Number of new frames :math:`T`, at least two.
        - **output:** :math:`(T, L)`, double, not to be written to
    """
    if length == num:
        return torch.eye(num, dtype=torch.double)
    times = new_times(length, num)
    weight = _interpolated(times, length) if length < num else _filtered(times, length)
    ends = torch.zeros(2, length, dtype=torch.double)
    ends[0, 0] = ends[1, -1] = 1.0
    weight[0], weight[-1] = ends
    return weight


def new_times(length: int, num: int) -> Tensor:
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


def resampled(signals: Tensor, num: int) -> Tensor:
    r"""Returns signals with another number of frames.

    Shapes:
        - **signals:** The signals :math:`(R, L)`.
        - **num:** Number of new frames :math:`T`, at least two.
        - **output:** :math:`(R, T)`
    """
    length = signals.size(1)
    if length == num:
        return signals
    values, missing = signals.double(), signals.isnan()
    gaps = bool(missing.any())
    if gaps:
        values = _bridged(values, missing)
    level = values[:, :1]  # what is constant stays so to the last bit
    matrix = resampling_matrix(length, num).to(signals.device)
    out = (level + (values - level) @ matrix.t()).to(signals.dtype)
    out[:, 0], out[:, -1] = signals[:, 0], signals[:, -1]
    if gaps:
        nearest = (new_times(length, num) + 0.5).floor().long().to(signals.device)
        out = out.masked_fill(missing[:, nearest], torch.nan)
    return out


def _bridged(values: Tensor, missing: Tensor) -> Tensor:
    # Straight lines over the gaps, the nearest reading beyond the ends, zero if there is none.
    length = values.size(1)
    frames = torch.arange(length, device=values.device).expand_as(values)
    left = frames.masked_fill(missing, -1).cummax(dim=1).values
    right = frames.masked_fill(missing, length).flip(1).cummin(dim=1).values.flip(1)
    first, last = left.clamp(min=0), right.clamp(max=length - 1)
    first, last = torch.where(left < 0, last, first), torch.where(right >= length, first, last)
    start, stop = values.gather(1, first), values.gather(1, last)
    part = (frames - first) / (last - first).clamp(min=1)
    line = start + part * (stop - start)
    return torch.where(missing, line, values).nan_to_num(nan=0.0)
