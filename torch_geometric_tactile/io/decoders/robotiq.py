r"""Decoder of the Robotiq TSF-85 tactile fingertips."""

from typing import ClassVar

import numpy as np

from torch_geometric_tactile._checks import need
from torch_geometric_tactile.data.live_frame import LiveFrame
from torch_geometric_tactile.io.decoders._header_decoder import INCOMPLETE, NO_PACKET, HeaderDecoder

_HEADER = b"\x9a"
_HEADER_BYTES = 4  # header, check byte, command, length
_AUTOSEND = 0x58
_COMMANDS = frozenset((_AUTOSEND, 0x59, 0x61))  # sent periodically, sent when new, and requested
_NUM_TAXELS = 28
_MAX_FINGERS = 2
_STATIC_TYPE, _TIMESTAMP_TYPE = 0x10, 0x70
_NAME_OF_TYPE = {
    0x20: "dynamic",
    0x30: "accelerometer",
    0x40: "gyroscope",
    0x50: "magnetometer",
    0x60: "temp",
}
# Number of 16-bit values in a block of each type.
_NUM_VALUES = {_STATIC_TYPE: _NUM_TAXELS, 0x20: 1, 0x30: 3, 0x40: 3, 0x50: 3, 0x60: 1}

_Block = tuple[int, int, bytes]


class RobotiqDecoder(HeaderDecoder):
    r"""Decoder of the Robotiq TSF-85 tactile fingertips.

    A packet is 9A, a check byte, a command, the number of following bytes, and blocks: a byte of
    type, finger (bits 2 and 3) and index (bits 0 and 1), then big-endian 16-bit values. This
    decoder follows the maker's open drivers, and has not been tested on a device:

    - The check byte is called a CRC-8, but no driver computes or checks it, and its polynomial is
      not published. This decoder does not check it either. Instead, the command must be known, and
      the blocks must fill the packet exactly. Damaged readings are not detected.
    - Type 10 is the static grid, 28 values row by row (7 rows of 4 in the newer drivers), 20 is
      dynamic pressure, 30 acceleration, 40 rate of rotation, 50 the magnetic field (in older
      drivers only), 60 temperature, and 70 the time in milliseconds. The time has 64 bits in newer
      firmware. The 16 bits of older firmware are ignored.
    - A frame begins with finger 0, and is complete when both fingers have sent their grid. A
      missing grid is NaN. Packets have no number, so lost frames are not counted.

    Readings are counts :math:`(28 F, 1)`. :obj:`extra` has the last values of :obj:`"dynamic"`
    :math:`(F,)`, :obj:`"accelerometer"`, :obj:`"gyroscope"` and :obj:`"magnetometer"`
    :math:`(F, 3)` and :obj:`"temp"` :math:`(F,)` as raw counts, or NaN before the first value.

    Args:
        num_fingers (int): Number of fingers :math:`F` that send readings, 1 or 2.
        period (float): Requested period in seconds, a multiple of a millisecond up to 0.255.

    Raises:
        ValueError: If an argument is out of its range.

    Examples:
        >>> decoder = RobotiqDecoder(num_fingers=1)
        >>> grid = np.arange(28, dtype=">u2").tobytes()
        >>> (frame,) = decoder.feed(b"\x9a\x00\x58\x39\x10" + grid + b"\x9a", now=0)
        >>> frame.tactile.shape, frame.tactile[27].item()
        ((28, 1), 27.0)
    """

    checksum: ClassVar[str] = "none"
    baudrate: ClassVar[int] = 115_200
    header: ClassVar[bytes] = _HEADER

    def __init__(self, num_fingers: int = 2, period: float = 0.001) -> None:
        super().__init__()
        need(num_fingers in (1, _MAX_FINGERS), "'num_fingers' must be 1 or 2", num_fingers)
        need(0.0005 < period < 0.2555, "'period' must be between 0.001 and 0.255 seconds", period)
        self.num_fingers, self.period = num_fingers, period
        self._extra = {
            name: np.full((num_fingers, _NUM_VALUES[kind]), np.nan, np.float32)
            for kind, name in _NAME_OF_TYPE.items()
        }
        self._clear_frame()

    def start(self) -> bytes:
        r"""Returns the command that makes the device send periodically."""
        return bytes([_HEADER[0], 0, _AUTOSEND, 1, round(self.period * 1000)])

    def reset(self) -> None:
        r"""Discards an incomplete packet and an incomplete frame."""
        super().reset()
        self._clear_frame()

    def _clear_frame(self) -> None:
        self._static = np.full((self.num_fingers, _NUM_TAXELS), np.nan, np.float32)
        self._fingers_received: set[int] = set()
        self._device_time: float | None = None

    def _size(self, buffer: bytes, start: int) -> int:
        if len(buffer) - start < _HEADER_BYTES:
            return INCOMPLETE
        command, length = buffer[start + 2], buffer[start + 3]
        if command not in _COMMANDS:
            return NO_PACKET
        end = start + _HEADER_BYTES + length
        if len(buffer) < end:
            return INCOMPLETE
        if self._is_aligned and not _may_contain_packet(buffer[start + _HEADER_BYTES : end]):
            return end - start
        # The header is a single byte, which readings contain too: wait for the next header.
        if len(buffer) == end:
            return INCOMPLETE
        return end - start if buffer[end] == _HEADER[0] else NO_PACKET

    def _read(self, packet: bytes, now: int) -> list[LiveFrame] | None:
        blocks = _split_blocks(packet, 8) or _split_blocks(packet, 2)
        if not blocks or any(finger >= self.num_fingers for _, finger, _ in blocks):
            return None
        frames = []
        for kind, finger, data in blocks:
            if kind == _STATIC_TYPE:
                if finger in self._fingers_received or (finger == 0 and self._fingers_received):
                    frames.append(self._frame(now))
                self._fingers_received.add(finger)
                self._static[finger] = np.frombuffer(data, ">u2")
            elif kind in _NAME_OF_TYPE:
                self._extra[_NAME_OF_TYPE[kind]][finger] = np.frombuffer(data, ">i2")
            elif kind == _TIMESTAMP_TYPE and len(data) == 8:
                self._device_time = int.from_bytes(data, "big") / 1000
        if len(self._fingers_received) == self.num_fingers:
            frames.append(self._frame(now))
        return frames

    def _frame(self, now: int) -> LiveFrame:
        extra = {
            name: values[:, 0].copy() if values.shape[1] == 1 else values.copy()
            for name, values in self._extra.items()
        }
        tactile, device_time = self._static.reshape(-1, 1), self._device_time
        self._clear_frame()
        return self._count_frame(now, tactile, None, device_time, **extra)


def _may_contain_packet(data: bytes) -> bool:
    r"""Returns whether another packet may begin within these bytes, as after a loss of bytes."""
    position = data.find(_HEADER)
    while position >= 0:
        if position + 2 >= len(data) or data[position + 2] in _COMMANDS:
            return True
        position = data.find(_HEADER, position + 1)
    return False


def _split_blocks(packet: bytes, timestamp_bytes: int) -> list[_Block] | None:
    r"""Returns the blocks of a packet (type, finger and values), or :obj:`None` if they do not fill
    the packet. A timestamp has :obj:`timestamp_bytes` bytes.
    """
    blocks = []
    position = _HEADER_BYTES
    while position < len(packet):
        kind, finger = packet[position] & 0xF0, packet[position] >> 2 & 3
        size = timestamp_bytes if kind == _TIMESTAMP_TYPE else 2 * _NUM_VALUES.get(kind, 0)
        data = packet[position + 1 : position + 1 + size]
        if size == 0 or len(data) < size:
            return None
        blocks.append((kind, finger, data))
        position += 1 + size
    return blocks
