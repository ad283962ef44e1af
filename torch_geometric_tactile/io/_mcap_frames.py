r"""Conversion of the frame messages of an MCAP file to the arrays of a recording."""

import math
from typing import Any

import numpy as np

from torch_geometric_tactile._checks import need
from torch_geometric_tactile._limits import ARRAY_BYTES, EXPANSION, FRAME_BYTES
from torch_geometric_tactile.io._mcap_schemas import FRAME, decode


class _Column:
    # An array with one row for each frame, which grows with the frames.

    def __init__(self, value: np.ndarray) -> None:
        self.template = value
        self.data = bytearray()
        self.num_rows = 0
        self.is_complete = True

    def accepts(self, value: np.ndarray) -> bool:
        is_text = self.template.dtype.kind == value.dtype.kind == "U"
        return self.template.shape == value.shape and (
            is_text or self.template.dtype == value.dtype
        )

    def set_row(self, row: int, value: np.ndarray) -> None:
        self.fill_missing(row)
        if value.dtype.itemsize > self.template.dtype.itemsize:  # a longer text needs wider rows
            self.data = bytearray(self.array().astype(value.dtype).tobytes())
            self.template = value
        self.data += value.astype(self.template.dtype, copy=False).tobytes()
        self.num_rows = row + 1

    def fill_missing(self, row: int) -> None:
        # Fills the rows of frames without this array with NaN, if its type has NaN.
        if self.num_rows < row:
            self.is_complete &= self.template.dtype.kind == "f"
            missing = np.full_like(self.template, math.nan if self.is_complete else 0)
            self.data += missing.tobytes() * (row - self.num_rows)
            self.num_rows = row

    def array(self) -> np.ndarray:
        return np.ndarray((self.num_rows, *self.template.shape), self.template.dtype, self.data)


class FrameRows:
    r"""Collects the frames of a file.

    Args:
        file_size (int): Size of the file in bytes.
        allow_large (bool): Whether to accept frames far larger than the file.
    """

    def __init__(self, file_size: int, allow_large: bool) -> None:
        self.num_frames = 0
        self._limit = 2**63 if allow_large else max(ARRAY_BYTES, EXPANSION * file_size)
        self._columns: dict[str, _Column] = {}
        self._widths: dict[str, int] = {}

    def add(self, data: bytes) -> None:
        r"""Adds the frame of a message.

        Raises:
            MemoryError: If the frames take too much memory.
            ValueError: If the message is not a frame, or differs from the previous frames.
        """
        values = _decode_frame(decode(FRAME, data))
        for name, value in values.items():
            column = self._columns.get(name)
            if column is not None and not column.accepts(value):
                raise ValueError(
                    f"'{name}' must have shape {column.template.shape} and type "
                    f"{column.template.dtype}, as in the previous frames (got {value.shape} and "
                    f"{value.dtype})"
                )
        for name, value in values.items():
            self._widths[name] = max(value.nbytes, self._widths.get(name, 0))
        if sum(self._widths.values()) * (self.num_frames + 1) > self._limit:
            raise MemoryError(
                f"its frames would take more than {self._limit / 2**30:.1f} GiB, as in a file "
                "made to exhaust the memory: pass allow_large=True if you trust it"
            )
        for name, value in values.items():
            self._columns.setdefault(name, _Column(value)).set_row(self.num_frames, value)
        self.num_frames += 1

    def arrays(self) -> tuple[dict[str, np.ndarray], list[str]]:
        r"""Returns the arrays, and the names of arrays that some frames lack and that have no NaN.

        The names are those of
        :func:`~torch_geometric_tactile.io._recording_schema.recording_to_arrays`, and
        :obj:`"sequence"`, :obj:`"received"` and :obj:`"device_time"`.
        """
        for column in self._columns.values():
            column.fill_missing(self.num_frames)
        incomplete = [name for name, column in self._columns.items() if not column.is_complete]
        complete = {name: column for name, column in self._columns.items() if column.is_complete}
        return {name: column.array() for name, column in complete.items()}, incomplete


def _decode_frame(frame: Any) -> dict[str, np.ndarray]:
    shape, tactile = tuple(frame.shape), np.array(frame.tactile, np.float32)
    joint = np.array(frame.joint, np.float32)
    if len(shape) != 2 or 0 in shape or math.prod(shape) != len(tactile):
        raise ValueError(
            f"'tactile' must have the shape declared in its frame (got {len(tactile)} numbers "
            f"for {shape[:4]})"
        )
    need(math.isfinite(frame.time), "'time' must be finite", frame.time)
    for name, readings in (("tactile", tactile), ("joint", joint)):
        if np.isinf(readings).any():
            raise ValueError(f"'{name}' must hold finite readings, or NaN for missing ones")
    arrays = {
        "time": np.array(frame.time),
        "sequence": np.array(frame.sequence),
        "received": np.array(frame.received),
        "device_time": np.array(frame.device_time if frame.HasField("device_time") else math.nan),
        "tactile": tactile.reshape(shape),
    }
    if len(joint):
        arrays["joint"] = joint
    arrays |= {f"extra/{signal.name}": _decode_signal(signal) for signal in frame.extra}
    arrays |= {f"privileged/{signal.name}": _decode_signal(signal) for signal in frame.privileged}
    if sum(value.nbytes for value in arrays.values()) > FRAME_BYTES:
        raise ValueError(f"a frame must take at most {FRAME_BYTES} bytes (got more)")
    return arrays


def _decode_signal(signal: Any) -> np.ndarray:
    name, dtype_name, shape, data = signal.name, signal.dtype, tuple(signal.shape), signal.data
    if not name or "/" in name:
        raise ValueError(f"a signal must have a name without '/' (got {name[:40]!r})")
    try:
        dtype = np.dtype(dtype_name[:20])
    except (TypeError, ValueError, SyntaxError) as error:
        raise ValueError(f"'{name}' must be of a known type (got {dtype_name[:20]!r})") from error
    if dtype.kind not in "biufU" or len(shape) > 8:
        raise ValueError(f"'{name}' must hold numbers or texts (got {dtype_name[:20]!r})")
    if math.prod(shape) * dtype.itemsize != len(data):
        raise ValueError(f"'{name}' must have shape {shape} (got {len(data)} bytes)")
    if dtype.itemsize == 0:
        return np.zeros(shape, dtype)
    array = np.frombuffer(data, dtype).reshape(shape)
    if dtype.kind == "U" and array.size and np.frombuffer(data, np.uint32).max() > 0x10FFFF:
        raise ValueError(f"'{name}' must hold texts (got invalid characters)")
    return array.astype(dtype.newbyteorder("="), copy=False)
