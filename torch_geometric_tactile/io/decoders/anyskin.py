r"""Bytes of ReSkin and AnySkin boards."""

from typing import ClassVar

import numpy as np

from torch_geometric_tactile.data.live_frame import LiveFrame
from torch_geometric_tactile.io.decoders.decoder import Decoder

_END = b"\r\n"
_LOOK_AHEAD = 4  # frames in a row that may be damaged before their places are forgotten
# What a MLX90393 can say at any gain: 16 bits of 1/45.2 °C around 25 °C, or of up to 12.6 µT.
# Compared as integers, which order as the sizes of floats do, and NaN and infinity come last.
_LIMIT = np.array([1000.0, 5e5, 5e5, 5e5], dtype=np.float32).view(np.uint32)
_SMALLEST = np.array([1e-6], dtype=np.float32).view(np.uint32)  # nearer to zero is only zero
_MOST_AT_ONCE = 64  # so that a large piece with damage everywhere is read once, not many times
_SIZE_BITS = np.uint32(0x7FFFFFFF)


class AnySkinDecoder(Decoder):
    r"""Decoder of `ReSkin and AnySkin <https://any-skin.github.io>`_ boards.

    A frame is :obj:`t, x, y, z` of each magnetometer as little-endian float32, then CR LF. There is
    neither header nor checksum, and CR LF is also found inside of floats. A frame is taken if it
    ends with CR LF, all its numbers are some that the chip can say, and it begins where the frame
    before has ended, at a multiple of the length after it, or behind a CR LF: at once, with no
    frame of delay. Everything else is skipped, and frames lost are estimated from the bytes
    skipped.

    Of the damage that is left, most cannot be seen: with 1 % of all *bytes* replaced at random
    (which damages 56 % of the packets), every intact packet is delivered, and of the damaged ones
    about 7 in 10 pass as wrong readings (``tests/io/test_anyskin.py`` counts them). On a cable that
    damages bytes, use packets with a checksum (:class:`CobsDecoder`).

    Readings are :math:`(M, 3)` in microtesla; :obj:`extra` has the temperatures in degrees Celsius
    as :obj:`"temp"` :math:`(M,)`, as far as the chip is calibrated.

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
        self.stride = 16 * num_magnetometers + len(_END)
        self._buffer, self._begin = b"", 0
        self._looked = 0  # up to where terminators were looked for
        self._in_place = True  # whether the next frame is expected where the buffer begins

    @property
    def layout(self) -> str | None:
        r"""Name of the layout of boards with five magnetometers."""
        return "anyskin" if self.num_magnetometers == 5 else None

    def feed(self, data: bytes, now: int) -> list[LiveFrame]:
        r"""Takes bytes, and returns the frames that they complete."""
        self._buffer += data
        frames: list[LiveFrame] = []
        while len(self._buffer) - self._begin >= self.stride:
            run = self._run()
            frames += [self._frame(values, now) for values in run]
            self._begin += len(run) * self.stride
            if len(run) == 0 and not self._found():
                break
        left = len(self._buffer) - self._begin
        self._in_place = self._in_place and left <= _LOOK_AHEAD * self.stride
        if not self._in_place and left > self.stride + 1:
            self._skip(left - self.stride - 1)
        self._buffer = self._buffer[self._begin :]
        self._looked, self._begin = max(0, self._looked - self._begin), 0
        return frames

    def reset(self) -> None:
        r"""Forgets a half frame."""
        self._skip(len(self._buffer))
        self._buffer, self._begin = b"", 0
        self._looked, self._in_place = 0, True

    def _run(self) -> np.ndarray:
        """Whole frames where they are expected, one after another."""
        number = (len(self._buffer) - self._begin) // self.stride if self._in_place else 0
        number = min(number, _MOST_AT_ONCE)
        rows = np.frombuffer(self._buffer, np.uint8, number * self.stride, self._begin)
        rows = rows.reshape(number, self.stride)
        values = np.ascontiguousarray(rows[:, :-2]).view("<f4")
        values = values.reshape(number, self.num_magnetometers, 4)
        good = (rows[:, -2] == _END[0]) & (rows[:, -1] == _END[1]) & _are_plausible(values)
        return values if good.all() else values[: int(good.argmin())]

    def _found(self) -> bool:
        """Whether a frame is there, after what is damaged was skipped."""
        while True:
            place = self._buffer.find(_END, max(self._looked, self._begin))
            if place < 0:
                self._looked = max(self._looked, len(self._buffer) - 1)
                return False
            self._looked = place + 1
            start = place + len(_END) - self.stride
            ahead = start - self._begin
            if ahead < 0:
                continue
            in_place = self._in_place and ahead % self.stride == 0
            in_place = in_place and ahead < _LOOK_AHEAD * self.stride
            behind_end = ahead >= len(_END) and self._buffer.startswith(_END, start - len(_END))
            if not (in_place or behind_end):
                continue
            values = np.frombuffer(self._buffer, "<f4", 4 * self.num_magnetometers, start)
            if not _are_plausible(values.reshape(1, -1, 4)).all():
                continue
            if in_place and self._sequence >= 0:
                self.counts.corrupt += ahead // self.stride
            self._skip(ahead)
            self._in_place = True
            return True

    def _frame(self, values: np.ndarray, now: int) -> LiveFrame:
        temp, tactile = values[:, 0].astype(np.float32), values[:, 1:].astype(np.float32)
        return self._good_frame(now, tactile, self.stride, temp=temp)

    def _skip(self, size: int) -> None:
        self._begin += size
        self._missing += size
        self.counts.skipped += size
        if size:
            self.counts.refuse(
                f"CR LF does not follow on {self.stride - 2} plausible bytes, as with "
                f"num_magnetometers={self.num_magnetometers}"
            )


def _are_plausible(values: np.ndarray) -> np.ndarray:
    bits = values.view("<u4") & _SIZE_BITS
    # Zero less one is the largest of all.
    possible = (bits < _LIMIT) & (bits - np.uint32(1) >= _SMALLEST)
    return np.asarray(possible.all(axis=(1, 2)))
