r"""Bytes of FlexiTac boards."""

from typing import ClassVar

import numpy as np

from torch_geometric_tactile.data.live_frame import LiveFrame
from torch_geometric_tactile.io.decoders._header_decoder import (
    NONE,
    WAIT,
    HeaderDecoder,
    checked_shape,
)


class FlexiTacDecoder(HeaderDecoder):
    r"""Decoder of `FlexiTac <https://flexitac.github.io>`_ boards with the maker's firmware of
    March 2026, as the package :obj:`flexitac` 0.3.1 flashes and reads it.

    A frame is AA 55, then one byte for each taxel, row by row. There is no checksum, and AA 55 may
    be among the readings, so headers are known by their distance: a frame is taken at once if it
    begins where the one before has ended and has no header inside; otherwise when another header
    follows it. A frame that lost bytes is found out, a damaged reading is not. Frames lost are
    estimated from the bytes skipped. Two neighbours that read 170 and 85 in every frame from the
    opening of the port on may be taken for the header, until one of them changes.

    Readings are counts :math:`(R \cdot C, 1)`, row by row.

    Args:
        shape (tuple of int): Number of rows :math:`R` and of columns :math:`C`.

    Raises:
        ValueError: If the shape is not two positive numbers.

    Examples:
        >>> decoder = FlexiTacDecoder(shape=(1, 2))
        >>> frames = decoder.feed(b"\xaa\x55\x01\x02\xaa\x55\x03\x04", now=0)
        >>> [frame.tactile.ravel().tolist() for frame in frames]
        [[1.0, 2.0], [3.0, 4.0]]
    """

    checksum: ClassVar[str] = "none"
    baudrate: ClassVar[int] = 2_000_000
    header: ClassVar[bytes] = b"\xaa\x55"

    def __init__(self, shape: tuple[int, int] = (12, 32)) -> None:
        super().__init__()
        self.shape = checked_shape(shape)
        self._length = len(self.header) + self.shape[0] * self.shape[1]

    def _size(self, buffer: bytes, start: int) -> int:
        end = start + self._length
        if len(buffer) < end:
            return WAIT
        inside = buffer.find(self.header, start + 1, end + 1)
        # Half a header at the end, whose other half may come: a byte of this frame was lost.
        unclear = len(buffer) == end and buffer[end - 1] == self.header[0]
        if self._in_place and inside < 0 and not unclear:
            return self._length
        told = buffer[end : end + len(self.header)]
        if told == self.header:
            return self._length
        return WAIT if self.header.startswith(told) else NONE

    def _read(self, packet: bytes, now: int) -> list[LiveFrame] | None:
        counts = np.frombuffer(packet, np.uint8, offset=len(self.header)).astype(np.float32)
        return [self._good_frame(now, counts.reshape(-1, 1), self._length)]
