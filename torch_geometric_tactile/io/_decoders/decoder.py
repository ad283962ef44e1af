r"""From bytes on a wire to frames: what decoders share."""

from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from torch_geometric_tactile.data.live_frame import LiveFrame

WAIT, NONE = 0, -1
_WRAP = 2**32
_NEAR_ZERO = 2**16
_LONGEST_GAP = 2**20  # 19 minutes at 900 frames a second


@dataclass(slots=True)
class DecoderCounts:
    r"""The numbers of good, corrupt and lost frames and of skipped bytes of a decoder.

    Args:
        good (int): Frames that were whole, and passed the check if the format has one.
        corrupt (int): Packets that were found and failed their check.
        skipped (int): Bytes that belong to no frame.
        lost (int): Frames that the numbers or times of the others say are missing.
        reason (str): The first reason why bytes made no frame; empty if none was told.

    Examples:
        >>> from torch_geometric_tactile.io import decoder_of
        >>> decoder = decoder_of("text", shape="1x3")
        >>> frames = decoder.feed(b"\r\n1 2 3 \r\n\r\n1 2 x \r\n\r\n", now=0)
        >>> decoder.counts.good, decoder.counts.corrupt
        (1, 1)
        >>> decoder.counts.reason
        "a frame of 1 rows of 3 must have 'shape' 1x3 and numbers from 0 to 255"
    """

    good: int = 0
    corrupt: int = 0
    skipped: int = 0
    lost: int = 0
    reason: str = field(default="", compare=False, repr=False)

    def refuse(self, reason: str) -> None:
        r"""Keeps the first reason why bytes made no frame.

        Args:
            reason (str): The reason.
        """
        self.reason = self.reason or reason


class Decoder(ABC):
    r"""Base class of decoders, which turn bytes into frames. A decoder has no port, no thread and
    no clock.

    Attributes:
        counts (DecoderCounts): What it has seen.
        checksum (str): What guards a frame, such as :obj:`"crc32"`; :obj:`"none"` if a damaged
            reading may pass.
        baudrate (int): Speed of the serial line in bits per second.
        unit (str): Unit of the readings; :obj:`"count"` if they are raw, or
            :obj:`"newton"`, :obj:`"microtesla"`.
        clock_period (float, optional): After how many seconds the clock of the device starts
            over; :obj:`None` if it has no clock or never does.

    Examples:
        >>> import numpy as np
        >>> class OneByte(Decoder):
        ...     def feed(self, data, now):
        ...         self.counts.good += len(data)
        ...         return [
        ...             LiveFrame(i, now / 1e9, now, None, np.float32([[value]]))
        ...             for i, value in enumerate(data)
        ...         ]
        ...     def reset(self):
        ...         pass
        >>> decoder = OneByte()
        >>> [float(frame.tactile[0, 0]) for frame in decoder.feed(b"\x01\x02", now=0)]
        [1.0, 2.0]
    """

    checksum: ClassVar[str] = "none"
    baudrate: ClassVar[int] = 115_200
    unit: ClassVar[str] = "count"
    clock_period: ClassVar[float | None] = None

    def __init__(self) -> None:
        self.counts = DecoderCounts()
        self._sequence = -1
        self._missing = 0  # bytes, or rows of text, since the last good frame

    @abstractmethod
    def feed(self, data: bytes, now: int) -> list[LiveFrame]:
        r"""Takes bytes, in pieces of any size, and returns the frames that they complete.

        It never raises, whatever the bytes are: why they make no frame is told to
        :meth:`DecoderCounts.refuse`, so that a user with other settings sees it.

        Args:
            data (bytes): The bytes that were read.
            now (int): When, on the monotonic clock in nanoseconds.
        """

    @abstractmethod
    def reset(self) -> None:
        r"""Forgets a half frame, as after the port was opened again; the counts stay."""

    @property
    def layout(self) -> str | None:
        r"""Name of the layout of the sensor, if one comes with the package."""
        return None

    def start(self) -> bytes:
        r"""Returns what has to be written to the device before it sends, if anything."""
        return b""

    def _good_frame(
        self,
        now: int,
        tactile: np.ndarray,
        size: int | None = None,
        device_time: float | None = None,
        **extra: np.ndarray,
    ) -> LiveFrame:
        """Counts a frame of a device that gives no numbers, and as many lost before it as fit into
        what is missing, if a frame has a size; returns it.
        """
        lost = round(self._missing / size) if size is not None and self._sequence >= 0 else 0
        self._missing = 0
        self._sequence += 1 + lost
        self.counts.lost += lost
        self.counts.good += 1
        return LiveFrame(self._sequence, now / 1e9, now, device_time, tactile, None, extra)

    def __repr__(self) -> str:
        return f"{type(self).__name__}(checksum={self.checksum!r})"


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
