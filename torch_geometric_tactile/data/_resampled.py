r"""Signals of a recording at another rate."""

import math
from collections.abc import Mapping

import numpy as np

from torch_geometric_tactile.data._gaps import ROUNDING, part_numbers
from torch_geometric_tactile.data.frame_rate import measure_rate

_MAX_FRAMES = 10**8


def resampled_values(
    time: np.ndarray, signals: Mapping[str, np.ndarray], rate: float
) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    r"""Returns new times and the signals at them: floating-point ones averaged over each new frame
    or joined by straight lines, others those of the nearest frame.

    Shapes:
        - **time:** Increasing times in seconds :math:`(T,)`.
        - **signals:** Values by name :math:`(T, ...)`.
        - **output:** times :math:`(K,)` and values :math:`(K, ...)`
    """
    if not (isinstance(rate, int | float) and 0 < rate < math.inf):
        raise ValueError(f"'rate' must be frames per second, above 0 (got {rate!r})")
    if len(time) < 2:
        return time, dict(signals)
    measured = measure_rate(time)
    part = part_numbers(time, measured.max_gap)
    bounds = np.flatnonzero(np.diff(part, prepend=-1, append=part[-1] + 1))
    starts, ends = bounds[:-1], bounds[1:]
    counts = np.floor((time[ends - 1] - time[starts]) * rate + ROUNDING).astype(np.int64) + 1
    if counts.sum() > _MAX_FRAMES:
        raise ValueError(
            f"'rate' must make at most {_MAX_FRAMES} frames (got {counts.sum()} at {rate:g} Hz)"
        )
    is_slower = rate < measured.rate * (1 - ROUNDING)  # a resampled recording stays as it is
    width = 1 / rate if is_slower else 0.0
    new_time = []
    new: dict[str, list[np.ndarray]] = {name: [] for name in signals}
    for start, end, count in zip(starts, ends, counts, strict=True):
        old = time[start:end]
        times = old[0] + np.arange(count) / rate
        new_time.append(times)
        nearest = _nearest(old, times)
        for name, value in signals.items():
            values = value[start:end]
            if value.dtype.kind == "f" and len(old) > 1:
                new[name].append(_float_values(old, values, times, nearest, width))
            else:
                new[name].append(values[nearest])
    return np.concatenate(new_time), {name: np.concatenate(parts) for name, parts in new.items()}


def _nearest(old: np.ndarray, times: np.ndarray) -> np.ndarray:
    after = np.searchsorted(old, times).clip(1, max(len(old) - 1, 1))
    if len(old) == 1:
        return np.zeros(len(times), np.int64)
    return np.asarray(after - (times - old[after - 1] <= old[after] - times))


def _float_values(
    old: np.ndarray, values: np.ndarray, times: np.ndarray, nearest: np.ndarray, width: float
) -> np.ndarray:
    flat = values.reshape(len(old), -1).astype(np.float64)
    missing = np.isnan(flat)
    if missing.any():
        flat = _bridged(old, flat, missing)
    if width == 0:
        out = _lines(old, flat, times)
    else:  # the integral of the lines, over each new frame within the part
        steps = np.diff(old)[:, None]
        area = np.concatenate(
            [np.zeros((1, flat.shape[1])), np.cumsum(0.5 * steps * (flat[1:] + flat[:-1]), axis=0)]
        )
        low = np.maximum(times - width / 2, old[0])
        high = np.minimum(times + width / 2, old[-1])
        out = _integral(old, flat, area, high) - _integral(old, flat, area, low)
        out /= (high - low)[:, None]
    out[missing[nearest]] = np.nan
    return out.reshape(len(times), *values.shape[1:]).astype(values.dtype)


def _lines(old: np.ndarray, flat: np.ndarray, times: np.ndarray) -> np.ndarray:
    after = np.searchsorted(old, times, side="right").clip(1, len(old) - 1)
    before = after - 1
    share = ((times - old[before]) / (old[after] - old[before])).clip(0, 1)[:, None]
    return np.asarray(flat[before] + share * (flat[after] - flat[before]))


def _integral(old: np.ndarray, flat: np.ndarray, area: np.ndarray, times: np.ndarray) -> np.ndarray:
    before = np.searchsorted(old, times, side="right").clip(1, len(old) - 1) - 1
    value = _lines(old, flat, times)
    part = 0.5 * (times - old[before])[:, None] * (flat[before] + value)
    return np.asarray(area[before] + part)


def _bridged(old: np.ndarray, flat: np.ndarray, missing: np.ndarray) -> np.ndarray:
    # Straight lines over missing values; zero where a signal has none.
    out = np.nan_to_num(flat)
    for column in np.flatnonzero(missing.any(axis=0)):
        known = ~missing[:, column]
        if known.any():
            out[:, column] = np.interp(old, old[known], flat[known, column])
    return out
