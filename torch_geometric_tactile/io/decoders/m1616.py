r"""Decoder of the 16 x 16 piezoresistive array M1616."""

from typing import ClassVar

import numpy as np

from torch_geometric_tactile.data.live_frame import LiveFrame
from torch_geometric_tactile.io.decoders._header_decoder import INCOMPLETE, HeaderDecoder

_NUM_TAXELS = 256
_PACKET_BYTES = 3 + 2 * _NUM_TAXELS + 4


class M1616Decoder(HeaderDecoder):
    r"""Decoder of the 16 x 16 piezoresistive array M1616.

    A packet is AA AB AC, 256 big-endian uint16 row by row, and 4 bytes of unpublished meaning,
    which are ignored. There is no checksum. A packet with missing bytes is detected, since it
    contains the next header, but damaged readings are not. The number of lost frames is estimated
    from the skipped bytes. A reading of AAAB or more, which a 12-bit converter never gives, may
    look like a header, and its packet is lost.

    Readings are counts :math:`(256, 1)`.

    Examples:
        >>> decoder = M1616Decoder()
        >>> counts = np.arange(256, dtype=">u2")
        >>> (frame,) = decoder.feed(b"\xaa\xab\xac" + counts.tobytes() + bytes(4), now=0)
        >>> frame.tactile.shape, frame.tactile[255].item()
        ((256, 1), 255.0)
    """

    checksum: ClassVar[str] = "none"
    baudrate: ClassVar[int] = 115_200
    header: ClassVar[bytes] = b"\xaa\xab\xac"

    def _size(self, buffer: bytes, start: int) -> int:
        # A header within the packet or across its end begins the next packet: bytes are missing.
        inner_header = buffer.find(self.header, start + 1, start + _PACKET_BYTES + 2)
        if inner_header >= 0:
            return inner_header - start
        partial_size = self._partial_header_size(buffer[start + 1 : start + _PACKET_BYTES])
        next_bytes = buffer[
            start + _PACKET_BYTES : start + _PACKET_BYTES + len(self.header) - partial_size
        ]
        is_ambiguous = partial_size and self.header[partial_size:].startswith(next_bytes)
        return INCOMPLETE if len(buffer) - start < _PACKET_BYTES or is_ambiguous else _PACKET_BYTES

    def _read(self, packet: bytes, now: int) -> list[LiveFrame] | None:
        if len(packet) != _PACKET_BYTES:
            return None
        counts = np.frombuffer(packet, ">u2", _NUM_TAXELS, len(self.header))
        tactile = counts.astype(np.float32).reshape(-1, 1)
        return [self._count_frame(now, tactile, _PACKET_BYTES)]
