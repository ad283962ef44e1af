r"""Decoder of FlexiTac boards."""

from typing import ClassVar

import numpy as np

from torch_geometric_tactile.data.live_frame import LiveFrame
from torch_geometric_tactile.io.decoders._header_decoder import (
    INCOMPLETE,
    NO_PACKET,
    HeaderDecoder,
    check_shape,
)


class FlexiTacDecoder(HeaderDecoder):
    r"""Decoder of `FlexiTac <https://flexitac.github.io>`_ boards with the maker's firmware of
    March 2026, as flashed and read by the package :obj:`flexitac` 0.3.1.

    A frame is AA 55, then one byte for each taxel, row by row. There is no checksum, and readings
    may contain AA 55, so headers are recognised by their distance. A frame is returned at once if
    it begins at the end of the previous frame and contains no header, and otherwise when another
    header follows it. Frames with missing bytes are detected, but damaged readings are not. The
    number of lost frames is estimated from the skipped bytes. Two neighbouring taxels that read 170
    and 85 in every frame after the port was opened may be mistaken for the header until one of them
    changes.

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
        self.shape = check_shape(shape)
        self._length = len(self.header) + self.shape[0] * self.shape[1]

    @property
    def layout(self) -> str | None:
        r"""Name of the layout of pads of 12 x 32 taxels, or else :obj:`None`."""
        return "flexitac" if self.shape == (12, 32) else None

    def _size(self, buffer: bytes, start: int) -> int:
        end = start + self._length
        if len(buffer) < end:
            return INCOMPLETE
        inner_header = buffer.find(self.header, start + 1, end + 1)
        # If the last byte is half a header and the other half follows, this frame has lost a byte.
        is_ambiguous = len(buffer) == end and buffer[end - 1] == self.header[0]
        if self._is_aligned and inner_header < 0 and not is_ambiguous:
            return self._length
        next_bytes = buffer[end : end + len(self.header)]
        if next_bytes == self.header:
            return self._length
        return INCOMPLETE if self.header.startswith(next_bytes) else NO_PACKET

    def _read(self, packet: bytes, now: int) -> list[LiveFrame] | None:
        counts = np.frombuffer(packet, np.uint8, offset=len(self.header)).astype(np.float32)
        return [self._count_frame(now, counts.reshape(-1, 1), self._length)]
