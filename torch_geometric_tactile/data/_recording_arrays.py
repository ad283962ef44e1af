r"""Arrays of a recording from what users have: masked arrays, dates, and what is no number."""

import warnings
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import DTypeLike

from torch_geometric_tactile._checks import need

_NUMBERS = "biuf"
_NO_NAME = {"/", "\0"}  # where names of a file end
_MAX_DIMS = 9  # with that of the frames
# Powers of ten, and seconds, of the units that dates and time differences of numpy have.
_PARTS_OF_SECOND = {"ms": 10**3, "us": 10**6, "ns": 10**9, "ps": 10**12, "fs": 10**15, "as": 10**18}
_LARGEST_EXACT = 2**24  # up to which float32 holds every integer
_SECONDS = {"W": 7 * 86400, "D": 86400, "h": 3600, "m": 60, "s": 1}


def checked_numbers(name: str, value: Any, dtype: DTypeLike) -> np.ndarray:
    r"""Returns an array of floating-point numbers, NaN where a masked array is masked; without a
    copy if the type fits.
    """
    array = _array(f"'{name}' must be an array of numbers", value)
    need(array.dtype.kind in _NUMBERS, f"'{name}' must be an array of numbers", array.dtype)
    # A reading beyond float32 becomes infinite here and is reported as such by the caller.
    with np.errstate(over="ignore"):
        numbers: np.ndarray = array.astype(dtype, copy=False)
    if numbers.dtype == np.float32:
        warn_of_rounding(name, array, numbers, stacklevel=5)
    if isinstance(value, np.ma.MaskedArray) and np.ma.is_masked(value):
        numbers = np.where(np.ma.getmaskarray(value), np.nan, numbers).astype(dtype, copy=False)
    return numbers


def warn_of_rounding(
    name: str, array: np.ndarray, numbers: np.ndarray, stacklevel: int = 3
) -> None:
    r"""Warns if integers, or floating-point numbers that are integers, are so large that float32
    rounds them, such that small differences between them are lost.

    Args:
        name (str): What the numbers are, for the message.
        array (numpy.ndarray): The numbers before they were converted, of any shape.
        numbers (numpy.ndarray): The same in float32.
        stacklevel (int): As of :func:`warnings.warn`.
    """
    if array.dtype.kind == "b" or array.dtype.itemsize < 4 or array.dtype == np.float32:
        return
    is_large = (np.abs(numbers) > _LARGEST_EXACT) & np.isfinite(numbers)
    if not is_large.any():
        return
    before = array[is_large].astype(np.float64)
    is_whole = (before == np.floor(before)).all() and np.abs(before).max() <= 2**53
    if is_whole and (before != numbers[is_large]).any():
        warnings.warn(
            f"'{name}' holds readings of up to {np.abs(before).max():.15g}, which single precision "
            f"rounds: above {_LARGEST_EXACT} differences of 1 are lost. Subtract an offset of each "
            "taxel before, such as x - x[0]",
            UserWarning,
            stacklevel=stacklevel,
        )


def checked_time(value: Any) -> np.ndarray:
    r"""Returns times in seconds as float64: dates as seconds since 1970, and time differences as
    they are.

    Shapes:
        - **value:** Seconds as floating-point numbers, :class:`numpy.datetime64` or
          :class:`numpy.timedelta64` :math:`(T,)`.
    """
    refuse_masked("time", value)
    time = _array("'time' must be an array of numbers", value)
    need(time.ndim == 1, "'time' must have shape (num_frames,)", time.shape)
    if time.dtype.kind in "mM":
        time = _seconds(time)
    elif time.dtype.kind != "f":
        raise ValueError(
            f"'time' must be an array of numbers (floats in seconds, got {time.dtype}): give "
            "seconds as floats, milliseconds as time / 1e3, nanoseconds as time / 1e9, and dates "
            "as numpy.datetime64"
        )
    time = time.astype(np.float64, copy=False)
    wrong = np.flatnonzero(~np.isfinite(time))
    if len(wrong):
        raise ValueError(f"'time' must be finite (got {time[wrong[0]]} in frame {wrong[0]})")
    wrong = np.flatnonzero(time[1:] <= time[:-1])
    if len(wrong):
        before, frame = wrong[0], wrong[0] + 1
        raise ValueError(
            f"'time' must increase (got {float(time[frame])} s in frame {frame} after "
            f"{float(time[before])} s in frame {before})"
        )
    return time


def checked_rows(kind: str, value: Any, num_frames: int) -> dict[str, np.ndarray]:
    r"""Returns arrays by their names, with one row for each frame, without a copy.

    Shapes:
        - **value:** Numbers, truth values or texts :math:`(T, ...)` by their names.
        - **num_frames:** The number of frames :math:`T`.
    """
    if not isinstance(value, Mapping):
        raise ValueError(f"'{kind}' must be a mapping (got {type(value).__name__})")
    for name in value:
        if (
            not isinstance(name, str)
            or not 0 < len(name) <= 255
            or name == "."
            or {*name} & _NO_NAME
        ):
            raise ValueError(
                f"'{kind}' must have names that are texts without '/' or NUL, of 1 to 255 "
                f"characters and not '.' (got {name!r:.80})"
            )
        check_utf8(f"names in '{kind}'", name)
    return {name: _checked_rows(kind, name, array, num_frames) for name, array in value.items()}


def check_utf8(name: str, *texts: str) -> None:
    r"""Checks that texts can be written to any file."""
    for text in texts:
        try:
            text.encode()
        except UnicodeEncodeError as error:
            raise ValueError(
                f"{name} must hold texts that UTF-8 can hold (got {text!r:.80})"
            ) from error


def check_frames(name: str, array: np.ndarray, num_frames: int) -> None:
    r"""Checks that an array has one row for each frame."""
    if len(array) != num_frames:
        raise ValueError(
            f"'{name}' must have {num_frames} frames, as 'time' has (got {len(array)})"
        )


def refuse_masked(name: str, value: Any) -> None:
    r"""Checks that nothing is masked."""
    if isinstance(value, np.ma.MaskedArray) and np.ma.is_masked(value):
        row = int(np.argwhere(np.ma.getmaskarray(value))[0][0]) if value.ndim else 0
        raise ValueError(f"'{name}' must not be masked (got a masked value in frame {row})")


def _checked_rows(kind: str, name: str, value: Any, num_frames: int) -> np.ndarray:
    refuse_masked(name, value)
    array = _array(f"{kind} '{name}' must be an array", value)
    if array.dtype.kind not in "biufU":
        raise ValueError(
            f"{kind} '{name}' must hold numbers, truth values or texts (got {array.dtype})"
        )
    if array.dtype.kind != "U" and array.dtype.itemsize > 8:
        raise ValueError(
            f"{kind} '{name}' must hold numbers of at most 8 bytes (got {array.dtype})"
        )
    need(array.ndim != 0, f"{kind} '{name}' must have one row per frame (got a scalar)")
    check_frames(name, array, num_frames)
    if array.ndim > _MAX_DIMS or 0 in array.shape[1:]:
        raise ValueError(
            f"{kind} '{name}' must have values in each row, in at most {_MAX_DIMS} dimensions (got "
            f"shape {array.shape})"
        )
    if array.dtype.kind == "U":
        check_utf8(f"{kind} '{name}'", *array.flat)
    return array


def _array(what: str, value: Any) -> np.ndarray:
    try:
        return np.asarray(value)
    except (OverflowError, RuntimeError, TypeError, ValueError) as error:
        raise ValueError(f"{what} ({error})") from error


def _seconds(time: np.ndarray) -> np.ndarray:
    missing = np.flatnonzero(np.isnat(time))
    if len(missing):
        raise ValueError(f"'time' must be finite (got NaT in frame {missing[0]})")
    kind, unit = time.dtype.kind, np.datetime_data(time.dtype)[0]
    if kind == "M" and unit in ("Y", "M"):
        unit = "D"  # a year or month begins on a day
    if unit not in _SECONDS and unit not in _PARTS_OF_SECOND:
        raise ValueError(
            f"'time' must be in a unit of a fixed number of seconds (got {time.dtype}): convert "
            "it with time.astype('timedelta64[s]')"
        )
    ticks = time.astype(f"{kind}8[{unit}]").astype(np.int64)
    if unit in _SECONDS:
        return ticks.astype(np.float64) * _SECONDS[unit]
    # Nanoseconds since 1970 are more than float64 holds: whole seconds and the rest apart.
    parts = _PARTS_OF_SECOND[unit]
    rest = np.fmod(ticks, parts)
    return (ticks - rest) // parts + rest / parts
