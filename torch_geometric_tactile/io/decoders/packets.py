r"""Our own packet for microcontrollers: COBS between zeros, a sequence number and a CRC32."""

import struct
import zlib
from typing import Any, ClassVar

import numpy as np

from torch_geometric_tactile._checks import need
from torch_geometric_tactile.data.live_frame import LiveFrame
from torch_geometric_tactile.io.decoders._header_decoder import SequenceNumbers
from torch_geometric_tactile.io.decoders.decoder import Decoder

_PACKET_VERSION = 1
_INSTALL = "pip install 'torch-geometric-tactile[live]'"
_HEAD = struct.Struct("<BBBBHI")  # version, flags, sample type, channels, taxels, sequence number
_WORD = struct.Struct("<I")
_WRAP = 2**32
_HAS_TIME, _HAS_JOINT = 1, 2
_SAMPLES = tuple(np.dtype(name) for name in ("<i2", "<u2", "<f4"))
_SHORTEST = _HEAD.size + _WORD.size


def encode_packet(
    sequence: int,
    tactile: np.ndarray,
    device_time: float | None = None,
    joint: np.ndarray | None = None,
) -> bytes:
    r"""Encodes one packet, as a device sends it and :class:`CobsDecoder` reads it.

    Args:
        sequence (int): Number of the frame; 32 bits of it are sent.
        tactile (numpy.ndarray): Readings :math:`(N, C)` of int16, uint16 or floats, which are sent
            as float32.
        device_time (float, optional): Time on the clock of the device in seconds; microseconds
            are sent, in 32 bits.
        joint (numpy.ndarray, optional): Joint angles in radians :math:`(J,)`.

    Raises:
        ValueError: If a shape, a type or a number does not fit.
        ImportError: If the library of COBS is missing.

    Examples:
        >>> encode_packet(7, np.uint16([[1, 2, 3]])).hex(" ")
        '00 02 01 04 01 03 01 02 07 01 01 02 01 02 02 02 03 05 87 48 17 51 00'
    """
    tactile = np.asarray(tactile)
    if tactile.ndim != 2 or not (1 <= len(tactile) < 2**16 and 1 <= tactile.shape[1] < 2**8):
        raise ValueError(
            "'tactile' must have shape (taxels, channels), up to 65535 and 255 (got "
            f"{tactile.shape})"
        )
    kind = np.dtype("<f4") if tactile.dtype.kind == "f" else tactile.dtype.newbyteorder("<")
    need(kind in _SAMPLES, "'tactile' must be int16, uint16 or floats", tactile.dtype)
    need(sequence >= 0, "'sequence' must be at least 0", sequence)
    flags, more = 0, b""
    if device_time is not None:
        flags |= _HAS_TIME
        more += _WORD.pack(round(device_time * 1e6) % _WRAP)
    if joint is not None:
        joint = np.asarray(joint, dtype="<f4")
        if joint.ndim != 1 or not 1 <= len(joint) < 2**8:
            raise ValueError(f"'joint' must have shape (joints,), up to 255 (got {joint.shape})")
        flags |= _HAS_JOINT
        more += bytes([len(joint)]) + joint.tobytes()
    channels, number = tactile.shape[1], sequence % _WRAP
    head = _HEAD.pack(_PACKET_VERSION, flags, _SAMPLES.index(kind), channels, len(tactile), number)
    content = head + more + tactile.astype(kind).tobytes()
    return b"\0" + _require_cobs().encode(content + _WORD.pack(zlib.crc32(content))) + b"\0"


def _require_cobs() -> Any:
    try:
        from cobs import cobs
    except ImportError as error:
        raise ImportError(f"our packets need cobs: {_INSTALL}") from error
    return cobs


class CobsDecoder(Decoder):
    r"""Decoder of this package's own packets: COBS with a zero byte at both ends, a sequence number
    and a CRC32.

    The bytes are in ``docs/serial_formats.md``, with a sender in C. A damaged packet never passes
    but by the chance of its CRC32 (:math:`2^{-32}`), and never takes an intact neighbour with it.
    A gap in the 32-bit numbers is a loss, over the wrap as well. A step back, or a long one to a
    number near zero, is a device that has started over: the numbers of the frames go on, and no
    loss is counted, since nobody knows it. Infinite readings become NaN.

    Args:
        max_size (int): Longest packet in bytes; what is longer is garbage, and not kept.

    Raises:
        ValueError: If :obj:`max_size` is too small for any packet.
        ImportError: If the library of COBS is missing.

    Examples:
        >>> decoder = CobsDecoder()
        >>> (frame,) = decoder.feed(encode_packet(7, np.uint16([[1, 2, 3]])), now=0)
        >>> frame.sequence, frame.tactile.tolist()
        (7, [[1.0, 2.0, 3.0]])
    """

    checksum: ClassVar[str] = "crc32"
    clock_period: ClassVar[float | None] = _WRAP / 1e6

    def __init__(self, max_size: int = 2**17) -> None:
        super().__init__()
        need(max_size >= _SHORTEST, f"'max_size' must be at least {_SHORTEST} bytes", max_size)
        self.max_size = max_size
        self._cobs = _require_cobs()
        self._buffer = b""
        self._inside = False  # whether a zero came before what is in the buffer
        self._too_long = False
        self._numbers = SequenceNumbers()

    def feed(self, data: bytes, now: int) -> list[LiveFrame]:
        r"""Takes bytes, and returns the frames that they complete."""
        *pieces, rest = (self._buffer + data).split(b"\0") if self._buffer else data.split(b"\0")
        frames = []
        for piece in pieces:
            if piece or self._too_long:
                frame = self._frame(piece, now)
                if frame is not None:
                    frames.append(frame)
            self._inside, self._too_long = True, False
        if len(rest) > self.max_size or self._too_long:
            self.counts.skipped += len(rest)
            self.counts.refuse(f"no zero byte ends a packet of up to {self.max_size} bytes")
            rest, self._too_long = b"", True
        self._buffer = rest
        return frames

    def reset(self) -> None:
        r"""Forgets a half packet."""
        self.counts.skipped += len(self._buffer)
        self._buffer, self._inside, self._too_long = b"", False, False

    def _frame(self, piece: bytes, now: int) -> LiveFrame | None:
        content = b"" if self._too_long else self._checked(piece)
        found = _read_content(content) if content else None
        if found is None:
            # What comes before the first zero is the end of a packet that nobody damaged.
            self.counts.corrupt += self._inside
            self.counts.skipped += len(piece)
            self.counts.refuse("what is between two zero bytes is no packet with a good CRC32")
            return None
        number, device_time, joint, tactile = found
        self.counts.good += 1
        sequence, lost = self._numbers.unwrapped(number)
        self.counts.lost += lost
        return LiveFrame(sequence, now / 1e9, now, device_time, tactile, joint)

    def _checked(self, piece: bytes) -> bytes:
        try:
            content: bytes = self._cobs.decode(piece)
        except self._cobs.DecodeError:
            return b""
        if len(content) < _SHORTEST or len(piece) > self.max_size:
            return b""
        body, check = content[:-4], content[-4:]
        return body if _WORD.unpack(check)[0] == zlib.crc32(body) else b""


def _read_content(
    content: bytes,
) -> tuple[int, float | None, np.ndarray | None, np.ndarray] | None:
    version, flags, kind, channels, taxels, number = _HEAD.unpack_from(content)
    if version != _PACKET_VERSION or flags & ~3 or kind >= len(_SAMPLES):
        return None
    place, device_time, joint = _HEAD.size, None, None
    if flags & _HAS_TIME:
        if len(content) < place + 4:
            return None
        device_time = _WORD.unpack_from(content, place)[0] / 1e6
        place += 4
    if flags & _HAS_JOINT:
        joints = content[place] if len(content) > place else 0
        place += 1
        if not joints or len(content) < place + 4 * joints:
            return None
        joint = _finite(np.frombuffer(content, "<f4", joints, place).astype(np.float32))
        place += 4 * joints
    size = _SAMPLES[kind].itemsize * taxels * channels
    if size == 0 or len(content) != place + size:
        return None
    values = np.frombuffer(content, _SAMPLES[kind], offset=place).astype(np.float32)
    if _SAMPLES[kind].kind == "f":
        values = _finite(values)
    return number, device_time, joint, values.reshape(taxels, channels)


def _finite(values: np.ndarray) -> np.ndarray:
    values[np.isinf(values)] = np.nan
    return values
