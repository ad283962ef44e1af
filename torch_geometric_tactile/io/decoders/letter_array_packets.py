r"""Our packets of the 32 x 32 array of the letters, of which no framing is published."""

import struct
import zlib
from typing import ClassVar

import numpy as np

from torch_geometric_tactile._checks import need
from torch_geometric_tactile.data.live_frame import LiveFrame
from torch_geometric_tactile.io.decoders._header_decoder import WAIT, HeaderDecoder, SequenceNumbers

_SIDE = 32
_HEADER = b"\xa5\x5aLA"
_WORD = struct.Struct("<I")
_SIZE = len(_HEADER) + 4 + 2 * _SIDE**2 + 4


def encode_letter_array(sequence: int, counts: np.ndarray) -> bytes:
    r"""Encodes one packet of a 32 x 32 pressure array, as a microcontroller sends it and
    :class:`LetterArrayDecoder` reads it.

    Args:
        sequence (int): Number of the frame; 32 bits of it are sent.
        counts (numpy.ndarray): Whole numbers from 0 to 65535 :math:`(32, 32)`, or
            :math:`(1024, 1)`.

    Raises:
        ValueError: If a shape or a number does not fit.

    Examples:
        >>> packet = encode_letter_array(7, np.zeros((32, 32), int))
        >>> len(packet), packet[:8].hex(" ")
        (2060, 'a5 5a 4c 41 07 00 00 00')
    """
    counts = np.asarray(counts)
    if counts.shape not in ((_SIDE, _SIDE), (_SIDE**2, 1)):
        raise ValueError(f"'counts' must have shape (32, 32) or (1024, 1) (got {counts.shape})")
    if not ((counts >= 0) & (counts < 2**16) & (counts == np.floor(counts))).all():
        raise ValueError("'counts' must be whole numbers from 0 to 65535 (got others)")
    need(sequence >= 0, "'sequence' must be at least 0", sequence)
    content = _HEADER + _WORD.pack(sequence % 2**32) + counts.astype("<u2").tobytes()
    return content + _WORD.pack(zlib.crc32(content))


class LetterArrayDecoder(HeaderDecoder):
    r"""Decoder of this package's own packets of a 32 x 32 pressure array, such as that of the
    letters.

    No framing of the array is published, so this one is ours: A5 5A 4C 41, the number of the
    frame as little-endian uint32, 1024 little-endian uint16 row by row, and the CRC32 (that of
    zlib) of all before it, little-endian. The numbers are read as by :class:`CobsDecoder`.

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
        return _SIZE if len(buffer) - start >= _SIZE else WAIT

    def _read(self, packet: bytes, now: int) -> list[LiveFrame] | None:
        if _WORD.unpack_from(packet, _SIZE - 4)[0] != zlib.crc32(packet[:-4]):
            return None
        self.counts.good += 1
        sequence, lost = self._numbers.unwrapped(_WORD.unpack_from(packet, len(_HEADER))[0])
        self.counts.lost += lost
        counts = np.frombuffer(packet, "<u2", _SIDE**2, len(_HEADER) + 4)
        tactile = counts.astype(np.float32).reshape(-1, 1)
        return [LiveFrame(sequence, now / 1e9, now, None, tactile)]
