r"""Packets of a 32 x 32 pressure array, such as the array of the letter data set."""

import struct
import zlib
from typing import ClassVar

import numpy as np

from torch_geometric_tactile._checks import need
from torch_geometric_tactile.data.live_frame import LiveFrame
from torch_geometric_tactile.io.decoders._header_decoder import (
    INCOMPLETE,
    HeaderDecoder,
    SequenceNumbers,
)

_NUM_ROWS = 32
_HEADER = b"\xa5\x5aLA"
_UINT32 = struct.Struct("<I")
_PACKET_BYTES = len(_HEADER) + 4 + 2 * _NUM_ROWS**2 + 4


def encode_letter_array(sequence: int, counts: np.ndarray) -> bytes:
    r"""Encodes a packet of a 32 x 32 pressure array for :class:`LetterArrayDecoder`, as sent by a
    microcontroller.

    Args:
        sequence (int): Number of the frame, of which the lower 32 bits are sent.
        counts (numpy.ndarray): Integers from 0 to 65535 :math:`(32, 32)`, or
            :math:`(1024, 1)`.

    Raises:
        ValueError: If a shape is invalid, or a number is out of range.

    Examples:
        >>> packet = encode_letter_array(7, np.zeros((32, 32), int))
        >>> len(packet), packet[:8].hex(" ")
        (2060, 'a5 5a 4c 41 07 00 00 00')
    """
    counts = np.asarray(counts)
    if counts.shape not in ((_NUM_ROWS, _NUM_ROWS), (_NUM_ROWS**2, 1)):
        raise ValueError(f"'counts' must have shape (32, 32) or (1024, 1) (got {counts.shape})")
    if not ((counts >= 0) & (counts < 2**16) & (counts == np.floor(counts))).all():
        raise ValueError("'counts' must be integers from 0 to 65535 (got other numbers)")
    need(sequence >= 0, "'sequence' must be at least 0", sequence)
    content = _HEADER + _UINT32.pack(sequence % 2**32) + counts.astype("<u2").tobytes()
    return content + _UINT32.pack(zlib.crc32(content))


class LetterArrayDecoder(HeaderDecoder):
    r"""Decoder of packets of a 32 x 32 pressure array, such as the array of the letter data set.

    No packet format is published for this array, so this package defines one: A5 5A 4C 41, the
    number of the frame as little-endian uint32, 1024 little-endian uint16 row by row, and the CRC32
    (of zlib) of the previous bytes, little-endian. Gaps in the numbers are treated as in
    :class:`CobsDecoder`.

    Readings are counts :math:`(1024, 1)`.

    Examples:
        >>> decoder = LetterArrayDecoder()
        >>> (frame,) = decoder.feed(encode_letter_array(7, np.full((32, 32), 5)), now=0)
        >>> frame.sequence, frame.tactile.shape, frame.tactile[0].item()
        (7, (1024, 1), 5.0)
    """

    checksum: ClassVar[str] = "crc32"
    baudrate: ClassVar[int] = 921_600
    header: ClassVar[bytes] = _HEADER

    def __init__(self) -> None:
        super().__init__()
        self._numbers = SequenceNumbers()

    def _size(self, buffer: bytes, start: int) -> int:
        # The length is fixed; `_read` checks the CRC32.
        return _PACKET_BYTES if len(buffer) - start >= _PACKET_BYTES else INCOMPLETE

    def _read(self, packet: bytes, now: int) -> list[LiveFrame] | None:
        if _UINT32.unpack_from(packet, _PACKET_BYTES - 4)[0] != zlib.crc32(packet[:-4]):
            return None
        self.counts.good += 1
        sequence, lost = self._numbers.unwrap(_UINT32.unpack_from(packet, len(_HEADER))[0])
        self.counts.lost += lost
        counts = np.frombuffer(packet, "<u2", _NUM_ROWS**2, len(_HEADER) + 4)
        tactile = counts.astype(np.float32).reshape(-1, 1)
        return [LiveFrame(sequence, now / 1e9, now, None, tactile)]
