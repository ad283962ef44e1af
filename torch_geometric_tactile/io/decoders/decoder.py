r"""From bytes on a wire to frames."""

from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from torch_geometric_tactile.data.live_frame import LiveFrame


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
