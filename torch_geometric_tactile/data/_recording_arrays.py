r"""Checks of the arrays of a recording, and conversion of masked arrays and dates."""

import warnings
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import DTypeLike

from torch_geometric_tactile._checks import need

_NUMBER_KINDS = "biuf"  # NumPy's codes of booleans, integers and floating-point numbers
_SEPARATORS = {"/", "\0"}  # characters that separate names in HDF5 and npz files
_MAX_DIMS = 9  # including the dimension of the frames
_MAX_EXACT_INTEGER = 2**24  # float32 represents every integer up to this number
# The units of NumPy's dates and time differences: fractions and multiples of a second.
_UNITS_PER_SECOND = {
    "ms": 10**3,
    "us": 10**6,
    "ns": 10**9,
    "ps": 10**12,
    "fs": 10**15,
    "as": 10**18,
}
_SECONDS_PER_UNIT = {"W": 7 * 86400, "D": 86400, "h": 3600, "m": 60, "s": 1}


def checked_numbers(name: str, value: Any, dtype: DTypeLike) -> np.ndarray:
    r"""Converts numbers to an array of floating-point numbers. Masked elements become NaN. An array
    that already has the type is not copied.

    Args:
        name (str): Name of the array in messages.
        value (array-like): The numbers.
        dtype (numpy.dtype): The floating-point type.

    Raises:
        ValueError: If the values are not numbers.
    """
    array = _as_array(f"'{name}' must be an array of numbers", value)
    need(array.dtype.kind in _NUMBER_KINDS, f"'{name}' must be an array of numbers", array.dtype)
    # A reading beyond float32 becomes infinite, which the caller reports.
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
    r"""Warns about integers (also in floating-point arrays) that are so large that float32 rounds
    them and loses small differences between them.

    Args:
        name (str): Name of the array in the message.
        array (numpy.ndarray): The numbers before the conversion, of any shape.
        numbers (numpy.ndarray): The same numbers in float32.
        stacklevel (int): The argument of :func:`warnings.warn`.
    """
    if array.dtype.kind == "b" or array.dtype.itemsize < 4 or array.dtype == np.float32:
        return
    is_large = (np.abs(numbers) > _MAX_EXACT_INTEGER) & np.isfinite(numbers)
    if not is_large.any():
        return
    exact = array[is_large].astype(np.float64)
    is_whole = (exact == np.floor(exact)).all() and np.abs(exact).max() <= 2**53
    if is_whole and (exact != numbers[is_large]).any():
        warnings.warn(
            f"'{name}' holds readings of up to {np.abs(exact).max():.15g}, which single precision "
            f"rounds: above {_MAX_EXACT_INTEGER} differences of 1 are lost. Subtract an offset "
            "from each taxel first, such as x - x[0]",
            UserWarning,
            stacklevel=stacklevel,
        )


def checked_time(value: Any) -> np.ndarray:
    r"""Checks times and returns them in seconds as float64. Dates become seconds since 1970, and
    time differences become seconds.

    Shapes:
        - **value:** Seconds as floating-point numbers, :class:`numpy.datetime64` or
          :class:`numpy.timedelta64` :math:`(T,)`.

    Raises:
        ValueError: If the times are masked, integers, not finite or not increasing.
    """
    refuse_masked("time", value)
    time = _as_array("'time' must be an array of numbers", value)
    need(time.ndim == 1, "'time' must have shape (num_frames,)", time.shape)
    if time.dtype.kind in "mM":
        time = _dates_to_seconds(time)
    elif time.dtype.kind != "f":
        raise ValueError(
            f"'time' must be an array of numbers (floats in seconds, got {time.dtype}): pass "
            "seconds as floats, milliseconds as time / 1e3, nanoseconds as time / 1e9, and dates "
            "as numpy.datetime64"
        )
    time = time.astype(np.float64, copy=False)
    invalid_frames = np.flatnonzero(~np.isfinite(time))
    if len(invalid_frames):
        raise ValueError(
            f"'time' must be finite (got {time[invalid_frames[0]]} in frame {invalid_frames[0]})"
        )
    invalid_frames = np.flatnonzero(time[1:] <= time[:-1])
    if len(invalid_frames):
        previous, frame = invalid_frames[0], invalid_frames[0] + 1
        raise ValueError(
            f"'time' must increase (got {float(time[frame])} s in frame {frame} after "
            f"{float(time[previous])} s in frame {previous})"
        )
    return time


def checked_rows(kind: str, value: Any, num_frames: int) -> dict[str, np.ndarray]:
    r"""Checks named arrays with one row for each frame and returns them, without a copy.

    Args:
        kind (str): Name of the mapping in messages, such as :obj:`"extra"`.
        value (Mapping of str to array-like): Numbers, truth values or texts :math:`(T, ...)` by
            name.
        num_frames (int): Number of frames :math:`T`.

    Raises:
        ValueError: If a name, a type or a shape cannot be stored in HDF5, npz and MCAP files.
    """
    if not isinstance(value, Mapping):
        raise ValueError(f"'{kind}' must be a mapping (got {type(value).__name__})")
    for name in value:
        if (
            not isinstance(name, str)
            or not 0 < len(name) <= 255
            or name == "."
            or {*name} & _SEPARATORS
        ):
            raise ValueError(
                f"'{kind}' must have names of 1 to 255 characters, without '/' or NUL and not '.' "
                f"(got {name!r:.80})"
            )
        check_utf8(f"names in '{kind}'", name)
    return {name: _checked_rows(kind, name, array, num_frames) for name, array in value.items()}


def check_utf8(name: str, *texts: str) -> None:
    r"""Checks that texts can be encoded in UTF-8, which all file formats use.

    Raises:
        ValueError: If a text cannot be encoded.
    """
    for text in texts:
        try:
            text.encode()
        except UnicodeEncodeError as error:
            raise ValueError(
                f"{name} must hold texts that can be encoded in UTF-8 (got {text!r:.80})"
            ) from error


def check_frames(name: str, array: np.ndarray, num_frames: int) -> None:
    r"""Checks that an array has one row for each frame.

    Raises:
        ValueError: If the number of rows differs.
    """
    if len(array) != num_frames:
        raise ValueError(f"'{name}' must have {num_frames} frames, like 'time' (got {len(array)})")


def refuse_masked(name: str, value: Any) -> None:
    r"""Checks that no element of an array is masked.

    Raises:
        ValueError: If an element is masked.
    """
    if isinstance(value, np.ma.MaskedArray) and np.ma.is_masked(value):
        row = int(np.argwhere(np.ma.getmaskarray(value))[0][0]) if value.ndim else 0
        raise ValueError(f"'{name}' must not be masked (got a masked value in frame {row})")


def _checked_rows(kind: str, name: str, value: Any, num_frames: int) -> np.ndarray:
    refuse_masked(name, value)
    array = _as_array(f"{kind} '{name}' must be an array", value)
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


def _as_array(requirement: str, value: Any) -> np.ndarray:
    # `requirement` begins the error message.
    if str(getattr(value, "dtype", "")) == "torch.bfloat16":  # a type that NumPy lacks
        value = value.float()
    try:
        return np.asarray(value)
    except (OverflowError, RuntimeError, TypeError, ValueError) as error:
        raise ValueError(f"{requirement} ({error})") from error


def _dates_to_seconds(time: np.ndarray) -> np.ndarray:
    missing = np.flatnonzero(np.isnat(time))
    if len(missing):
        raise ValueError(f"'time' must be finite (got NaT in frame {missing[0]})")
    kind, unit = time.dtype.kind, np.datetime_data(time.dtype)[0]
    if kind == "M" and unit in ("Y", "M"):
        unit = "D"  # years and months begin on a day
    if unit not in _SECONDS_PER_UNIT and unit not in _UNITS_PER_SECOND:
        raise ValueError(
            f"'time' must be in a unit of a fixed number of seconds (got {time.dtype}): convert "
            "it with time.astype('timedelta64[s]')"
        )
    ticks = time.astype(f"{kind}8[{unit}]").astype(np.int64)
    if unit in _SECONDS_PER_UNIT:
        return ticks.astype(np.float64) * _SECONDS_PER_UNIT[unit]
    # float64 cannot represent nanoseconds since 1970, so whole seconds and fractions are converted
    # separately.
    per_second = _UNITS_PER_SECOND[unit]
    fraction = np.fmod(ticks, per_second)
    return (ticks - fraction) // per_second + fraction / per_second
