r"""What the decoders of several formats share: headers, sequence numbers, shapes."""

from abc import abstractmethod
from typing import ClassVar

from torch_geometric_tactile.data.live_frame import LiveFrame
from torch_geometric_tactile.io.decoders.decoder import Decoder

WAIT, NONE = 0, -1
_WRAP = 2**32
_NEAR_ZERO = 2**16
_LONGEST_GAP = 2**20  # 19 minutes at 900 frames a second


class HeaderDecoder(Decoder):
    r"""Base class of decoders of packets that begin with a header of fixed bytes.

    A packet that fails its check is looked through for the header of another: an intact packet is
    found whatever came before it.

    Attributes:
        header (bytes): The first bytes of each packet.
    """

    header: ClassVar[bytes]

    def __init__(self) -> None:
        super().__init__()
        self._buffer = b""
        self._in_place = False  # whether a good packet ended where this one begins

    @abstractmethod
    def _size(self, buffer: bytes, start: int) -> int:
        """Size of the packet that begins at :obj:`start`, :obj:`WAIT` if more bytes have to tell,
        :obj:`NONE` if none begins there."""

    @abstractmethod
    def _read(self, packet: bytes, now: int) -> list[LiveFrame] | None:
        """The frames that a packet completes, or :obj:`None` if it fails its check."""

    def feed(self, data: bytes, now: int) -> list[LiveFrame]:
        r"""Takes bytes, and returns the frames that they complete."""
        buffer = self._buffer + data
        frames: list[LiveFrame] = []
        start = 0
        while True:
            place = buffer.find(self.header, start)
            if place < 0:
                place = len(buffer) - self._half_header(buffer[start:])
            self._skip(place - start)
            start = place
            size = self._size(buffer, start) if len(buffer) - start >= len(self.header) else WAIT
            if size == WAIT:
                break
            found = None if size == NONE else self._read(buffer[start : start + size], now)
            if found is None:
                self.counts.corrupt += self._in_place or len(self.header) > 1
                self._skip(1)
                start += 1
                continue
            frames += found
            start += size
            self._in_place, self._missing = True, 0
        self._buffer = buffer[start:]
        return frames

    def reset(self) -> None:
        r"""Forgets a half packet."""
        self._skip(len(self._buffer))
        self._buffer, self._in_place = b"", False

    def _skip(self, size: int) -> None:
        if size:
            self._in_place = False
            self._missing += size
            self.counts.skipped += size
            header = self.header.hex(" ").upper()
            self.counts.refuse(f"no whole packet begins with {header}, the header of this protocol")

    def _half_header(self, rest: bytes) -> int:
        sizes = range(len(self.header) - 1, 0, -1)
        return next((size for size in sizes if rest.endswith(self.header[:size])), 0)


class SequenceNumbers:
    r"""Unwraps the 32-bit numbers of a device, and tells how many are missing.

    A step back, or a long one to a number near zero, is a device that has started over: the
    numbers go on, and no loss is told, since nobody knows it.

    Examples:
        >>> numbers = SequenceNumbers()
        >>> [numbers.unwrapped(number) for number in (2**32 - 1, 0, 3, 0)]
        [(4294967295, 0), (4294967296, 0), (4294967299, 2), (4294967300, 0)]
    """

    def __init__(self) -> None:
        self._device: int | None = None
        self._last = 0

    def unwrapped(self, number: int) -> tuple[int, int]:
        r"""Returns the number without wraps, and how many before it are missing."""
        missing = 0
        if self._device is None:
            self._last = number
        else:
            missing = (number - self._device - 1) % _WRAP
            too_long = missing > _LONGEST_GAP and number < _NEAR_ZERO
            started_over = too_long or missing >= _WRAP // 2
            missing = 0 if started_over else missing
            self._last += 1 + missing
        self._device = number
        return self._last, missing


def checked_shape(shape: tuple[int, int]) -> tuple[int, int]:
    r"""Returns numbers of rows and columns, from 1 to 1024 each."""
    if len(shape) != 2 or not all(1 <= size <= 1024 for size in shape):
        raise ValueError(f"'shape' must be rows and columns, from 1 to 1024 each (got {shape})")
    return int(shape[0]), int(shape[1])
