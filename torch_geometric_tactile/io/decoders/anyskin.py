r"""Decoder of ReSkin and AnySkin boards."""

from typing import ClassVar

import numpy as np

from torch_geometric_tactile.data.live_frame import LiveFrame
from torch_geometric_tactile.io.decoders.decoder import Decoder

_TERMINATOR = b"\r\n"
_MAX_DAMAGED_FRAMES = 4  # consecutive damaged frames, after which the alignment is given up
# The range of an MLX90393 at any gain: 16 bits of 1/45.2 °C around 25 °C, or of up to 12.6 µT.
# Compared as integers: they have the order of the absolute floats, with infinity and NaN last.
_MAX_SIZES = np.array([1000.0, 5e5, 5e5, 5e5], dtype=np.float32).view(np.uint32)
# Smaller numbers, except zero, are damaged.
_MIN_SIZE = np.array([1e-6], dtype=np.float32).view(np.uint32)
_MAX_FRAMES_PER_STEP = 64  # limits the repeated parsing of large pieces with much damage
_SIZE_BITS = np.uint32(0x7FFFFFFF)


class AnySkinDecoder(Decoder):
    r"""Decoder of `ReSkin and AnySkin <https://any-skin.github.io>`_ boards.

    A frame holds :obj:`t, x, y, z` of each magnetometer as little-endian float32, then CR LF. There
    is no header and no checksum, and CR LF also occurs within floats. A frame is accepted if it
    ends with CR LF, all its numbers are in the range of the chip, and it begins at the end of the
    previous frame, a multiple of the frame length later, or after a CR LF. It is returned without
    delay. Other bytes are skipped, and the number of lost frames is estimated from them.

    Most of the remaining damage cannot be detected: with 1 % of all *bytes* replaced at random
    (which damages 56 % of the packets), every intact packet is returned, and about 7 in 10 damaged
    packets give wrong readings (measured in ``tests/io/test_anyskin.py``). On a cable that damages
    bytes, use packets with a checksum (:class:`CobsDecoder`).

    Readings are :math:`(M, 3)` in microtesla. :obj:`extra` has the temperatures in degrees Celsius
    as :obj:`"temp"` :math:`(M,)`, with the accuracy of the chip's calibration.

    Args:
        num_magnetometers (int): Number of magnetometers :math:`M`.

    Raises:
        ValueError: If there is no magnetometer.

    Examples:
        >>> decoder = AnySkinDecoder(num_magnetometers=1)
        >>> data = np.float32([25, 1, 2, 3]).tobytes() + b"\r\n"
        >>> (frame,) = decoder.feed(data, now=0)
        >>> frame.tactile.tolist(), frame.extra["temp"].tolist()
        ([[1.0, 2.0, 3.0]], [25.0])
    """

    checksum: ClassVar[str] = "none"
    baudrate: ClassVar[int] = 115_200
    unit: ClassVar[str] = "microtesla"

    def __init__(self, num_magnetometers: int = 5) -> None:
        super().__init__()
        if not 1 <= num_magnetometers <= 1024:
            raise ValueError(
                f"'num_magnetometers' must be between 1 and 1024 (got {num_magnetometers})"
            )
        self.num_magnetometers = num_magnetometers
        self.stride = 16 * num_magnetometers + len(_TERMINATOR)
        self._buffer, self._start = b"", 0
        self._searched = 0  # position up to which terminators were searched
        self._is_aligned = True  # whether the next frame is expected at the start

    @property
    def layout(self) -> str | None:
        r"""Name of the layout of boards with five magnetometers, or else :obj:`None`."""
        return "anyskin" if self.num_magnetometers == 5 else None

    def feed(self, data: bytes, now: int) -> list[LiveFrame]:
        r"""Decodes bytes, and returns the frames that they complete."""
        self._buffer += data
        frames: list[LiveFrame] = []
        while len(self._buffer) - self._start >= self.stride:
            aligned = self._aligned_frames()
            frames += [self._frame(values, now) for values in aligned]
            self._start += len(aligned) * self.stride
            if len(aligned) == 0 and not self._skip_to_frame():
                break
        num_left = len(self._buffer) - self._start
        self._is_aligned = self._is_aligned and num_left <= _MAX_DAMAGED_FRAMES * self.stride
        if not self._is_aligned and num_left > self.stride + 1:
            self._skip(num_left - self.stride - 1)
        self._buffer = self._buffer[self._start :]
        self._searched, self._start = max(0, self._searched - self._start), 0
        return frames

    def reset(self) -> None:
        r"""Discards an incomplete frame."""
        self._skip(len(self._buffer))
        self._buffer, self._start = b"", 0
        self._searched, self._is_aligned = 0, True

    def _aligned_frames(self) -> np.ndarray:
        r"""Returns the values of consecutive plausible frames at the expected position."""
        num_frames = (len(self._buffer) - self._start) // self.stride if self._is_aligned else 0
        num_frames = min(num_frames, _MAX_FRAMES_PER_STEP)
        rows = np.frombuffer(self._buffer, np.uint8, num_frames * self.stride, self._start)
        rows = rows.reshape(num_frames, self.stride)
        values = np.ascontiguousarray(rows[:, :-2]).view("<f4")
        values = values.reshape(num_frames, self.num_magnetometers, 4)
        is_plausible = (
            (rows[:, -2] == _TERMINATOR[0])
            & (rows[:, -1] == _TERMINATOR[1])
            & _are_plausible(values)
        )
        return values if is_plausible.all() else values[: int(is_plausible.argmin())]

    def _skip_to_frame(self) -> bool:
        r"""Skips to the next plausible frame, and returns whether there is one."""
        while True:
            terminator = self._buffer.find(_TERMINATOR, max(self._searched, self._start))
            if terminator < 0:
                self._searched = max(self._searched, len(self._buffer) - 1)
                return False
            self._searched = terminator + 1
            start = terminator + len(_TERMINATOR) - self.stride
            num_skipped = start - self._start
            if num_skipped < 0:
                continue
            is_aligned = self._is_aligned and num_skipped % self.stride == 0
            is_aligned = is_aligned and num_skipped < _MAX_DAMAGED_FRAMES * self.stride
            follows_terminator = num_skipped >= len(_TERMINATOR) and self._buffer.startswith(
                _TERMINATOR, start - len(_TERMINATOR)
            )
            if not (is_aligned or follows_terminator):
                continue
            values = np.frombuffer(self._buffer, "<f4", 4 * self.num_magnetometers, start)
            if not _are_plausible(values.reshape(1, -1, 4)).all():
                continue
            if is_aligned and self._sequence >= 0:
                self.counts.corrupt += num_skipped // self.stride
            self._skip(num_skipped)
            self._is_aligned = True
            return True

    def _frame(self, values: np.ndarray, now: int) -> LiveFrame:
        temp, tactile = values[:, 0].astype(np.float32), values[:, 1:].astype(np.float32)
        return self._count_frame(now, tactile, self.stride, temp=temp)

    def _skip(self, size: int) -> None:
        self._start += size
        self._missing += size
        self.counts.skipped += size
        if size:
            self.counts.refuse(
                f"CR LF does not follow {self.stride - 2} plausible bytes, as expected for "
                f"num_magnetometers={self.num_magnetometers}"
            )


def _are_plausible(values: np.ndarray) -> np.ndarray:
    bits = values.view("<u4") & _SIZE_BITS
    # For zero, the subtraction wraps to the largest integer, so that zero is plausible.
    is_plausible = (bits < _MAX_SIZES) & (bits - np.uint32(1) >= _MIN_SIZE)
    return np.asarray(is_plausible.all(axis=(1, 2)))
