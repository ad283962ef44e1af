r"""Resampling of the signals of a recording."""

import math
from collections.abc import Collection, Mapping

import numpy as np

from torch_geometric_tactile.data._gaps import ROUNDING, part_numbers
from torch_geometric_tactile.data.frame_rate import measure_rate

_MAX_FRAMES = 10**8


def resampled_values(
    time: np.ndarray,
    signals: Mapping[str, np.ndarray],
    rate: float,
    zero_order_hold: Collection[str] = (),
) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    r"""Resamples signals to another rate. Each part between gaps is resampled separately.

    Floating-point values are averaged over each new frame if the rate is lower, and interpolated
    linearly otherwise. Other values are taken from the nearest frame.

    Args:
        time (numpy.ndarray): Increasing times in seconds :math:`(T,)`.
        signals (Mapping of str to numpy.ndarray): Values by name :math:`(T, ...)`.
        rate (float): Frames per second.
        zero_order_hold (collection of str): Signals, such as commands, that keep their value until
            the next frame. They are taken from the last frame at or before each new frame.

    Shapes:
        - **output:** times :math:`(K,)` and values :math:`(K, ...)`

    Raises:
        ValueError: If the rate is not positive, or would give too many frames.
    """
    if not (isinstance(rate, int | float) and 0 < rate < math.inf):
        raise ValueError(f"'rate' must be a number of frames per second above 0 (got {rate!r})")
    if len(time) < 2:
        return time, dict(signals)
    measured = measure_rate(time)
    part = part_numbers(time, measured.max_gap)
    bounds = np.flatnonzero(np.diff(part, prepend=-1, append=part[-1] + 1))
    starts, ends = bounds[:-1], bounds[1:]
    counts = np.floor((time[ends - 1] - time[starts]) * rate + ROUNDING).astype(np.int64) + 1
    if counts.sum() > _MAX_FRAMES:
        raise ValueError(
            f"'rate' must give at most {_MAX_FRAMES} frames (got {counts.sum()} at {rate:g} Hz)"
        )
    # With a tolerance, so that a recording that already has this rate is not averaged.
    is_slower = rate < measured.rate * (1 - ROUNDING)
    width = 1 / rate if is_slower else 0.0
    time_parts = []
    value_parts: dict[str, list[np.ndarray]] = {name: [] for name in signals}
    for start, end, count in zip(starts, ends, counts, strict=True):
        old_time = time[start:end]
        new_time = old_time[0] + np.arange(count) / rate
        time_parts.append(new_time)
        nearest = _nearest_frames(old_time, new_time)
        # With a tolerance, since the new times are rounded.
        last = np.searchsorted(old_time, new_time + ROUNDING / rate, side="right") - 1
        for name, value in signals.items():
            values = value[start:end]
            if name in zero_order_hold:
                value_parts[name].append(values[last])
            elif value.dtype.kind == "f" and len(old_time) > 1:
                value_parts[name].append(
                    _resample_floats(old_time, values, new_time, nearest, width)
                )
            else:
                value_parts[name].append(values[nearest])
    return np.concatenate(time_parts), {
        name: np.concatenate(parts) for name, parts in value_parts.items()
    }


def _nearest_frames(old_time: np.ndarray, new_time: np.ndarray) -> np.ndarray:
    after = np.searchsorted(old_time, new_time).clip(1, max(len(old_time) - 1, 1))
    if len(old_time) == 1:
        return np.zeros(len(new_time), np.int64)
    return np.asarray(after - (new_time - old_time[after - 1] <= old_time[after] - new_time))


def _resample_floats(
    old_time: np.ndarray,
    values: np.ndarray,
    new_time: np.ndarray,
    nearest: np.ndarray,
    width: float,
) -> np.ndarray:
    # Returns averages over `width` seconds around each new time, or interpolated values if `width`
    # is zero.
    flat = values.reshape(len(old_time), -1).astype(np.float64)
    missing = np.isnan(flat)
    if missing.any():
        flat = _fill_missing(old_time, flat, missing)
    if width == 0:
        out = _interpolate(old_time, flat, new_time)
    else:  # the mean of the interpolated signal, from its cumulative integral
        steps = np.diff(old_time)[:, None]
        area = np.concatenate(
            [np.zeros((1, flat.shape[1])), np.cumsum(0.5 * steps * (flat[1:] + flat[:-1]), axis=0)]
        )
        low = np.maximum(new_time - width / 2, old_time[0])
        high = np.minimum(new_time + width / 2, old_time[-1])
        out = _integral(old_time, flat, area, high) - _integral(old_time, flat, area, low)
        out /= (high - low)[:, None]
    out[missing[nearest]] = np.nan
    return out.reshape(len(new_time), *values.shape[1:]).astype(values.dtype)


def _interpolate(old_time: np.ndarray, flat: np.ndarray, new_time: np.ndarray) -> np.ndarray:
    after = np.searchsorted(old_time, new_time, side="right").clip(1, len(old_time) - 1)
    before = after - 1
    weight = ((new_time - old_time[before]) / (old_time[after] - old_time[before])).clip(0, 1)[
        :, None
    ]
    return np.asarray(flat[before] + weight * (flat[after] - flat[before]))


def _integral(
    old_time: np.ndarray, flat: np.ndarray, area: np.ndarray, new_time: np.ndarray
) -> np.ndarray:
    # Returns the integral of the interpolated signal from the first frame to each new time. `area`
    # is the integral at the old times.
    before = np.searchsorted(old_time, new_time, side="right").clip(1, len(old_time) - 1) - 1
    value = _interpolate(old_time, flat, new_time)
    part = 0.5 * (new_time - old_time[before])[:, None] * (flat[before] + value)
    return np.asarray(area[before] + part)


def _fill_missing(old_time: np.ndarray, flat: np.ndarray, missing: np.ndarray) -> np.ndarray:
    # Missing values are interpolated, so that they do not spread to their neighbours. A signal
    # without any value is zero here and becomes NaN again at the end.
    out = np.nan_to_num(flat)
    for column in np.flatnonzero(missing.any(axis=0)):
        is_present = ~missing[:, column]
        if is_present.any():
            out[:, column] = np.interp(old_time, old_time[is_present], flat[is_present, column])
    return out
