r"""A packet format for microcontrollers: COBS between zeros, a sequence number and a CRC32."""

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
# Version, flags, sample dtype, channels, taxels, sequence number.
_HEADER = struct.Struct("<BBBBHI")
_UINT32 = struct.Struct("<I")
_WRAP = 2**32
_HAS_TIME, _HAS_JOINT = 1, 2
_SAMPLE_DTYPES = tuple(np.dtype(name) for name in ("<i2", "<u2", "<f4"))
_MIN_CONTENT_BYTES = _HEADER.size + _UINT32.size


def encode_packet(
    sequence: int,
    tactile: np.ndarray,
    device_time: float | None = None,
    joint: np.ndarray | None = None,
) -> bytes:
    r"""Encodes a packet for :class:`CobsDecoder`, as sent by a device.

    Args:
        sequence (int): Number of the frame, of which the lower 32 bits are sent.
        tactile (numpy.ndarray): Readings :math:`(N, C)` of type int16, uint16 or float, which is
            sent as float32.
        device_time (float, optional): Time on the clock of the device in seconds. It is sent in
            microseconds with 32 bits.
        joint (numpy.ndarray, optional): Joint angles in radians :math:`(J,)`.

    Raises:
        ValueError: If a shape or a type is invalid, or a number is out of range.
        ImportError: If the package :obj:`cobs` is missing.

    Examples:
        >>> encode_packet(7, np.uint16([[1, 2, 3]])).hex(" ")
        '00 02 01 04 01 03 01 02 07 01 01 02 01 02 02 02 03 05 87 48 17 51 00'
    """
    tactile = np.asarray(tactile)
    if tactile.ndim != 2 or not (1 <= len(tactile) < 2**16 and 1 <= tactile.shape[1] < 2**8):
        raise ValueError(
            "'tactile' must have shape (num_taxels, num_channels), at most (65535, 255) (got "
            f"{tactile.shape})"
        )
    dtype = np.dtype("<f4") if tactile.dtype.kind == "f" else tactile.dtype.newbyteorder("<")
    need(dtype in _SAMPLE_DTYPES, "'tactile' must be int16, uint16 or floats", tactile.dtype)
    need(sequence >= 0, "'sequence' must be at least 0", sequence)
    flags, optional_fields = 0, b""
    if device_time is not None:
        flags |= _HAS_TIME
        optional_fields += _UINT32.pack(round(device_time * 1e6) % _WRAP)
    if joint is not None:
        joint = np.asarray(joint, dtype="<f4")
        if joint.ndim != 1 or not 1 <= len(joint) < 2**8:
            raise ValueError(
                f"'joint' must have shape (num_joints,), at most (255,) (got {joint.shape})"
            )
        flags |= _HAS_JOINT
        optional_fields += bytes([len(joint)]) + joint.tobytes()
    channels, number = tactile.shape[1], sequence % _WRAP
    header = _HEADER.pack(
        _PACKET_VERSION, flags, _SAMPLE_DTYPES.index(dtype), channels, len(tactile), number
    )
    content = header + optional_fields + tactile.astype(dtype).tobytes()
    return b"\0" + _require_cobs().encode(content + _UINT32.pack(zlib.crc32(content))) + b"\0"


def _require_cobs() -> Any:
    try:
        from cobs import cobs
    except ImportError as error:
        raise ImportError(f"CobsDecoder and encode_packet need cobs: {_INSTALL}") from error
    return cobs


class CobsDecoder(Decoder):
    r"""Decoder of the packet format of this package: COBS with a zero byte at both ends, a sequence
    number and a CRC32.

    ``docs/serial_formats.md`` describes the bytes, with a sender in C. A damaged packet is accepted
    only with the probability of its CRC32 (:math:`2^{-32}`), and never affects an intact neighbour.
    A gap in the 32-bit numbers is counted as lost frames, even across the wrap. A step back, or a
    large step to a number near zero, means that the device has restarted. The frame numbers then
    continue, and no loss is counted, since it is unknown. Infinite readings become NaN.

    Args:
        max_size (int): Maximum size of a packet in bytes. Longer packets are skipped.

    Raises:
        ValueError: If :obj:`max_size` is too small for any packet.
        ImportError: If the package :obj:`cobs` is missing.

    Examples:
        >>> decoder = CobsDecoder()
        >>> (frame,) = decoder.feed(encode_packet(7, np.uint16([[1, 2, 3]])), now=0)
        >>> frame.sequence, frame.tactile.tolist()
        (7, [[1.0, 2.0, 3.0]])
    """

    checksum: ClassVar[str] = "crc32"
    clock_period: float | None = _WRAP / 1e6

    def __init__(self, max_size: int = 2**17) -> None:
        super().__init__()
        need(
            max_size >= _MIN_CONTENT_BYTES,
            f"'max_size' must be at least {_MIN_CONTENT_BYTES} bytes",
            max_size,
        )
        self.max_size = max_size
        self._cobs = _require_cobs()
        self._buffer = b""
        self._inside = False  # whether the content of the buffer follows a zero byte
        self._too_long = False
        self._numbers = SequenceNumbers()

    def feed(self, data: bytes, now: int) -> list[LiveFrame]:
        r"""Decodes bytes, and returns the frames that they complete."""
        *pieces, incomplete = (
            (self._buffer + data).split(b"\0") if self._buffer else data.split(b"\0")
        )
        frames = []
        for piece in pieces:
            if piece or self._too_long:
                frame = self._frame(piece, now)
                if frame is not None:
                    frames.append(frame)
            self._inside, self._too_long = True, False
        if len(incomplete) > self.max_size or self._too_long:
            self.counts.skipped += len(incomplete)
            self.counts.refuse(f"no zero byte ends a packet of up to {self.max_size} bytes")
            incomplete, self._too_long = b"", True
        self._buffer = incomplete
        return frames

    def reset(self) -> None:
        r"""Discards an incomplete packet."""
        self.counts.skipped += len(self._buffer)
        self._buffer, self._inside, self._too_long = b"", False, False

    def _frame(self, piece: bytes, now: int) -> LiveFrame | None:
        content = b"" if self._too_long else self._decode_checked(piece)
        fields = _parse_content(content) if content else None
        if fields is None:
            # Bytes before the first zero are the end of a packet, not a corrupt one.
            self.counts.corrupt += self._inside
            self.counts.skipped += len(piece)
            self.counts.refuse(
                "the bytes between two zero bytes are not a packet with a correct CRC32"
            )
            return None
        number, device_time, joint, tactile = fields
        self.counts.good += 1
        sequence, num_lost = self._numbers.unwrap(number)
        self.counts.lost += num_lost
        return LiveFrame(sequence, now / 1e9, now, device_time, tactile, joint)

    def _decode_checked(self, piece: bytes) -> bytes:
        try:
            content: bytes = self._cobs.decode(piece)
        except self._cobs.DecodeError:
            return b""
        if len(content) < _MIN_CONTENT_BYTES or len(piece) > self.max_size:
            return b""
        body, check = content[:-4], content[-4:]
        return body if _UINT32.unpack(check)[0] == zlib.crc32(body) else b""


def _parse_content(
    content: bytes,
) -> tuple[int, float | None, np.ndarray | None, np.ndarray] | None:
    version, flags, dtype_index, num_channels, num_taxels, number = _HEADER.unpack_from(content)
    if version != _PACKET_VERSION or flags & ~3 or dtype_index >= len(_SAMPLE_DTYPES):
        return None
    position, device_time, joint = _HEADER.size, None, None
    if flags & _HAS_TIME:
        if len(content) < position + 4:
            return None
        device_time = _UINT32.unpack_from(content, position)[0] / 1e6
        position += 4
    if flags & _HAS_JOINT:
        num_joints = content[position] if len(content) > position else 0
        position += 1
        if not num_joints or len(content) < position + 4 * num_joints:
            return None
        joint = _replace_infinite(
            np.frombuffer(content, "<f4", num_joints, position).astype(np.float32)
        )
        position += 4 * num_joints
    size = _SAMPLE_DTYPES[dtype_index].itemsize * num_taxels * num_channels
    if size == 0 or len(content) != position + size:
        return None
    values = np.frombuffer(content, _SAMPLE_DTYPES[dtype_index], offset=position).astype(np.float32)
    if _SAMPLE_DTYPES[dtype_index].kind == "f":
        values = _replace_infinite(values)
    return number, device_time, joint, values.reshape(num_taxels, num_channels)


def _replace_infinite(values: np.ndarray) -> np.ndarray:
    values[np.isinf(values)] = np.nan
    return values
