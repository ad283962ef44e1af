r"""Bytes of the 16 x 16 piezoresistive array M1616."""

from typing import ClassVar

import numpy as np

from torch_geometric_tactile.data.live_frame import LiveFrame
from torch_geometric_tactile.io.decoders._header_decoder import WAIT, HeaderDecoder

_TAXELS = 256
_SIZE = 3 + 2 * _TAXELS + 4


class M1616Decoder(HeaderDecoder):
    r"""Decoder of the 16 x 16 piezoresistive array M1616.

    A packet is AA AB AC, 256 big-endian uint16 row by row, and 4 bytes that nobody has published;
    they are not read. There is no checksum: a packet that lost bytes is found out, since the next
    header is inside of it, but a damaged reading is not. Frames lost are estimated from the
    bytes skipped. A reading of AAAB or more, which a converter of 12 bits never has, may look like
    a header, and costs its packet.

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
        # A header inside, or over the end, belongs to the next packet: this one lost bytes.
        inside = buffer.find(self.header, start + 1, start + _SIZE + 2)
        if inside >= 0:
            return inside - start
        half = self._half_header(buffer[start + 1 : start + _SIZE])
        told = buffer[start + _SIZE : start + _SIZE + len(self.header) - half]
        unclear = half and self.header[half:].startswith(told)
        return WAIT if len(buffer) - start < _SIZE or unclear else _SIZE

    def _read(self, packet: bytes, now: int) -> list[LiveFrame] | None:
        if len(packet) != _SIZE:
            return None
        counts = np.frombuffer(packet, ">u2", _TAXELS, len(self.header))
        tactile = counts.astype(np.float32).reshape(-1, 1)
        return [self._good_frame(now, tactile, _SIZE)]
