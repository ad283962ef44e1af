r"""Base class for packets with a header, and helpers for sequence numbers and shapes."""

from abc import abstractmethod
from typing import ClassVar

from torch_geometric_tactile.data.live_frame import LiveFrame
from torch_geometric_tactile.io.decoders.decoder import Decoder

INCOMPLETE, NO_PACKET = 0, -1
_WRAP = 2**32
_NEAR_ZERO = 2**16
_MAX_GAP = 2**20  # numbers: 19 minutes at 900 frames per second


class HeaderDecoder(Decoder):
    r"""Base class of decoders of packets that begin with a header of fixed bytes.

    If a packet fails its check, the next header is searched for inside the packet, so that an
    intact packet is found after any damage.

    Attributes:
        header (bytes): The first bytes of each packet.
    """

    header: ClassVar[bytes]

    def __init__(self) -> None:
        super().__init__()
        self._buffer = b""
        self._is_aligned = False  # whether the previous packet was intact and ended here

    @abstractmethod
    def _size(self, buffer: bytes, start: int) -> int:
        r"""Returns the size of the packet at :obj:`start`, :obj:`INCOMPLETE` if more bytes are
        needed, or :obj:`NO_PACKET` if no packet begins there.
        """

    @abstractmethod
    def _read(self, packet: bytes, now: int) -> list[LiveFrame] | None:
        r"""Returns the frames that a packet completes, or :obj:`None` if it fails its check."""

    def feed(self, data: bytes, now: int) -> list[LiveFrame]:
        r"""Decodes bytes, and returns the frames that they complete."""
        buffer = self._buffer + data
        frames: list[LiveFrame] = []
        start = 0
        while True:
            header_start = buffer.find(self.header, start)
            if header_start < 0:
                header_start = len(buffer) - self._partial_header_size(buffer[start:])
            self._skip(header_start - start)
            start = header_start
            size = (
                self._size(buffer, start) if len(buffer) - start >= len(self.header) else INCOMPLETE
            )
            if size == INCOMPLETE:
                break
            packet_frames = (
                None if size == NO_PACKET else self._read(buffer[start : start + size], now)
            )
            if packet_frames is None:
                self.counts.corrupt += self._is_aligned or len(self.header) > 1
                self._skip(1)
                start += 1
                continue
            frames += packet_frames
            start += size
            self._is_aligned, self._missing = True, 0
        self._buffer = buffer[start:]
        return frames

    def reset(self) -> None:
        r"""Discards an incomplete packet."""
        self._skip(len(self._buffer))
        self._buffer, self._is_aligned = b"", False

    def _skip(self, size: int) -> None:
        if size:
            self._is_aligned = False
            self._missing += size
            self.counts.skipped += size
            header = self.header.hex(" ").upper()
            self.counts.refuse(
                f"no complete packet begins with {header}, the header of this protocol"
            )

    def _partial_header_size(self, data: bytes) -> int:
        sizes = range(len(self.header) - 1, 0, -1)
        return next((size for size in sizes if data.endswith(self.header[:size])), 0)


class SequenceNumbers:
    r"""Unwraps the 32-bit frame numbers of a device, and counts missing numbers.

    A step back, or a large step to a number near zero, means that the device has restarted. The
    unwrapped numbers then continue, and no loss is counted, since it is unknown.

    Examples:
        >>> numbers = SequenceNumbers()
        >>> [numbers.unwrap(number) for number in (2**32 - 1, 0, 3, 0)]
        [(4294967295, 0), (4294967296, 0), (4294967299, 2), (4294967300, 0)]
    """

    def __init__(self) -> None:
        self._device: int | None = None
        self._last = 0

    def unwrap(self, number: int) -> tuple[int, int]:
        r"""Returns the unwrapped number, and the number of missing frames before it."""
        num_missing = 0
        if self._device is None:
            self._last = number
        else:
            num_missing = (number - self._device - 1) % _WRAP
            is_long_gap = num_missing > _MAX_GAP and number < _NEAR_ZERO
            has_restarted = is_long_gap or num_missing >= _WRAP // 2
            num_missing = 0 if has_restarted else num_missing
            self._last += 1 + num_missing
        self._device = number
        return self._last, num_missing


def check_shape(shape: tuple[int, int]) -> tuple[int, int]:
    r"""Returns the rows and columns of a shape, and raises an error unless they are 1 to 1024."""
    if len(shape) != 2 or not all(1 <= size <= 1024 for size in shape):
        raise ValueError(f"'shape' must be rows and columns, from 1 to 1024 each (got {shape})")
    return int(shape[0]), int(shape[1])
