r"""The base class of the decoders, and the counts of a decoder."""

from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from torch_geometric_tactile.data.live_frame import LiveFrame


@dataclass(slots=True)
class DecoderCounts:
    r"""The numbers of good, corrupt and lost frames and of skipped bytes of a decoder.

    Args:
        good (int): Complete frames that passed the check of the format, if it has one.
        corrupt (int): Packets that failed their check.
        skipped (int): Bytes that belong to no frame.
        lost (int): Missing frames, from the numbers or times of the other frames.
        reason (str): The first reason why bytes were skipped; empty if there is none.

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
        r"""Stores the reason why bytes were skipped, unless there is an earlier one.

        Args:
            reason (str): The reason.
        """
        self.reason = self.reason or reason


class Decoder(ABC):
    r"""Base class of decoders, which convert bytes to frames. A decoder has no port, thread or
    clock.

    Attributes:
        counts (DecoderCounts): The counts of frames and bytes.
        checksum (str): The checksum of a frame, such as :obj:`"crc32"`, or :obj:`"none"` if damaged
            readings cannot be detected.
        baudrate (int): Speed of the serial line in bits per second.
        unit (str): Unit of the readings: :obj:`"count"` for raw readings, :obj:`"newton"` or
            :obj:`"microtesla"`.
        clock_period (float, optional): Seconds after which the clock of the device wraps around, or
            :obj:`None` if the device has no clock or the clock does not wrap.

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
    clock_period: float | None = None

    def __init__(self) -> None:
        self.counts = DecoderCounts()
        self._sequence = -1
        self._missing = 0  # skipped bytes or rows of text since the last intact frame

    @abstractmethod
    def feed(self, data: bytes, now: int) -> list[LiveFrame]:
        r"""Decodes bytes, in pieces of any size, and returns the frames that they complete.

        This method never raises an error. The reason why bytes are skipped goes to
        :meth:`DecoderCounts.refuse`, which helps users with wrong settings.

        Args:
            data (bytes): The next bytes.
            now (int): Time of arrival on the monotonic clock in nanoseconds.
        """

    @abstractmethod
    def reset(self) -> None:
        r"""Discards an incomplete frame, for example after the port was reopened. The counts are
        kept.
        """

    @property
    def layout(self) -> str | None:
        r"""Name of the layout of the sensor, or :obj:`None` if the package has none."""
        return None

    def start(self) -> bytes:
        r"""Returns the command that makes the device send. It is empty if none is needed."""
        return b""

    def _count_frame(
        self,
        now: int,
        tactile: np.ndarray,
        size: int | None = None,
        device_time: float | None = None,
        **extra: np.ndarray,
    ) -> LiveFrame:
        r"""Counts and returns a frame of a device without frame numbers. The number of lost frames
        is estimated from the skipped bytes, if the frame has a fixed size.
        """
        num_lost = round(self._missing / size) if size is not None and self._sequence >= 0 else 0
        self._missing = 0
        self._sequence += 1 + num_lost
        self.counts.lost += num_lost
        self.counts.good += 1
        return LiveFrame(self._sequence, now / 1e9, now, device_time, tactile, None, extra)

    def __repr__(self) -> str:
        return f"{type(self).__name__}(checksum={self.checksum!r})"
