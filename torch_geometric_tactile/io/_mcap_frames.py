r"""Arrays of a recording, from messages of its frames."""

import math
from typing import Any

import numpy as np

from torch_geometric_tactile._checks import need
from torch_geometric_tactile._limits import ARRAY_BYTES, EXPANSION, FRAME_BYTES
from torch_geometric_tactile.io._mcap_schemas import FRAME, decode


class _Column:
    # One array with a row for each frame.

    def __init__(self, value: np.ndarray) -> None:
        self.like = value
        self.data = bytearray()
        self.rows = 0
        self.whole = True

    def takes(self, value: np.ndarray) -> bool:
        is_text = self.like.dtype.kind == value.dtype.kind == "U"
        return self.like.shape == value.shape and (is_text or self.like.dtype == value.dtype)

    def put(self, row: int, value: np.ndarray) -> None:
        self.leave_out(row)
        if value.dtype.itemsize > self.like.dtype.itemsize:  # a longer text
            self.data = bytearray(self.array().astype(value.dtype).tobytes())
            self.like = value
        self.data += value.astype(self.like.dtype, copy=False).tobytes()
        self.rows = row + 1

    def leave_out(self, row: int) -> None:
        # What is missing in some frames is NaN there, if it can be.
        if self.rows < row:
            self.whole &= self.like.dtype.kind == "f"
            missing = np.full_like(self.like, math.nan if self.whole else 0)
            self.data += missing.tobytes() * (row - self.rows)
            self.rows = row

    def array(self) -> np.ndarray:
        return np.ndarray((self.rows, *self.like.shape), self.like.dtype, self.data)


class FrameRows:
    r"""Collects the frames of a file."""

    def __init__(self, file_size: int, allow_large: bool) -> None:
        self.num_frames = 0
        self._limit = 2**63 if allow_large else max(ARRAY_BYTES, EXPANSION * file_size)
        self._columns: dict[str, _Column] = {}
        self._widths: dict[str, int] = {}

    def add(self, data: bytes) -> None:
        r"""Takes a message of a frame."""
        values = _values(decode(FRAME, data))
        for name, value in values.items():
            column = self._columns.get(name)
            if column is not None and not column.takes(value):
                raise ValueError(
                    f"'{name}' must have shape {column.like.shape} and type {column.like.dtype}, "
                    f"as in the frames before (got {value.shape} and {value.dtype})"
                )
        for name, value in values.items():
            self._widths[name] = max(value.nbytes, self._widths.get(name, 0))
        if sum(self._widths.values()) * (self.num_frames + 1) > self._limit:
            raise MemoryError(
                f"its frames would take more than {self._limit / 2**30:.1f} GiB, as in a file that "
                "is made to fill the memory: pass allow_large=True if it is right"
            )
        for name, value in values.items():
            self._columns.setdefault(name, _Column(value)).put(self.num_frames, value)
        self.num_frames += 1

    def arrays(self) -> tuple[dict[str, np.ndarray], list[str]]:
        r"""Returns the arrays by their names, as
        :func:`~torch_geometric_tactile.io._recording_schema.recording_to_arrays` names them, and
        with :obj:`"sequence"`, :obj:`"received"` and :obj:`"device_time"`; and the names of those
        that are missing in some frames and cannot be NaN.
        """
        for column in self._columns.values():
            column.leave_out(self.num_frames)
        lost = [name for name, column in self._columns.items() if not column.whole]
        whole = {name: column for name, column in self._columns.items() if column.whole}
        return {name: column.array() for name, column in whole.items()}, lost


def _values(frame: Any) -> dict[str, np.ndarray]:
    shape, tactile = tuple(frame.shape), np.array(frame.tactile, np.float32)
    joint = np.array(frame.joint, np.float32)
    if len(shape) != 2 or 0 in shape or math.prod(shape) != len(tactile):
        raise ValueError(
            f"'tactile' must have the shape that its frame says (got {len(tactile)} numbers and "
            f"{shape[:4]})"
        )
    need(math.isfinite(frame.time), "'time' must be finite", frame.time)
    for name, readings in (("tactile", tactile), ("joint", joint)):
        if np.isinf(readings).any():
            raise ValueError(f"'{name}' must hold finite readings, or NaN where one is missing")
    out = {
        "time": np.array(frame.time),
        "sequence": np.array(frame.sequence),
        "received": np.array(frame.received),
        "device_time": np.array(frame.device_time if frame.HasField("device_time") else math.nan),
        "tactile": tactile.reshape(shape),
    }
    if len(joint):
        out["joint"] = joint
    out |= {f"extra/{signal.name}": _signal(signal) for signal in frame.extra}
    out |= {f"privileged/{signal.name}": _signal(signal) for signal in frame.privileged}
    if sum(value.nbytes for value in out.values()) > FRAME_BYTES:
        raise ValueError(f"a frame must take at most {FRAME_BYTES} bytes (got more)")
    return out


def _signal(signal: Any) -> np.ndarray:
    name, text, shape, data = signal.name, signal.dtype, tuple(signal.shape), signal.data
    if not name or "/" in name:
        raise ValueError(f"a signal must have a name without '/' (got {name[:40]!r})")
    try:
        dtype = np.dtype(text[:20])
    except (TypeError, ValueError, SyntaxError) as error:
        raise ValueError(f"'{name}' must be of a known type (got {text[:20]!r})") from error
    if dtype.kind not in "biufU" or len(shape) > 8:
        raise ValueError(f"'{name}' must hold numbers or texts (got {text[:20]!r})")
    if math.prod(shape) * dtype.itemsize != len(data):
        raise ValueError(f"'{name}' must have shape {shape} (got {len(data)} bytes)")
    if dtype.itemsize == 0:
        return np.zeros(shape, dtype)
    array = np.frombuffer(data, dtype).reshape(shape)
    if dtype.kind == "U" and array.size and np.frombuffer(data, np.uint32).max() > 0x10FFFF:
        raise ValueError(f"'{name}' must hold texts (got no characters)")
    return array.astype(dtype.newbyteorder("="), copy=False)
