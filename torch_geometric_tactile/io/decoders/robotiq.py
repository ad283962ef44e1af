r"""Bytes of the Robotiq TSF-85 tactile fingertips."""

from typing import ClassVar

import numpy as np

from torch_geometric_tactile._checks import need
from torch_geometric_tactile.data.live_frame import LiveFrame
from torch_geometric_tactile.io.decoders._header_decoder import NONE, WAIT, HeaderDecoder

_HEADER = b"\x9a"
_HEAD = 4  # header, check byte, command, length
_AUTOSEND = 0x58
_COMMANDS = frozenset((_AUTOSEND, 0x59, 0x61))  # sent by period, sent when new, asked for
_TAXELS = 28
_FINGERS = 2
_STATIC, _TIMESTAMP = 0x10, 0x70
_NAMES = {
    0x20: "dynamic",
    0x30: "accelerometer",
    0x40: "gyroscope",
    0x50: "magnetometer",
    0x60: "temp",
}
# Values of 16 bits in a block of each type.
_VALUES = {_STATIC: _TAXELS, 0x20: 1, 0x30: 3, 0x40: 3, 0x50: 3, 0x60: 1}

_Block = tuple[int, int, bytes]


class RobotiqDecoder(HeaderDecoder):
    r"""Decoder of the Robotiq TSF-85 tactile fingertips.

    A packet is 9A, a check byte, a command, the number of bytes that follow, and blocks: a byte of
    type, finger (bits 2 and 3) and index (bits 0 and 1), then big-endian 16-bit values. What is
    known comes from the maker's open drivers, and was tried on no device here:

    - The check byte is called a CRC-8, but no driver computes or checks it, and its polynomial is
      not published. It is not checked here either; instead, the command must be known and the
      blocks must fill the packet exactly. A damaged reading is not found out.
    - Type 10 is the static grid, 28 values row by row (7 rows of 4 in the newer drivers), 20 is
      dynamic pressure, 30 acceleration, 40 rate of rotation, 50 the magnetic field, which only
      older drivers name, 60 temperature, and 70 the time in milliseconds: 64 bits in newer
      firmware, and 16 in older, which are not used here.
    - A frame begins with finger 0, and is complete when both have sent their grid; if one has not,
      it is NaN. Packets have no number, so nothing tells what is lost.

    Readings are counts :math:`(28 F, 1)`; :obj:`extra` has the last values of :obj:`"dynamic"`
    :math:`(F,)`, :obj:`"accelerometer"`, :obj:`"gyroscope"` and :obj:`"magnetometer"`
    :math:`(F, 3)` and :obj:`"temp"` :math:`(F,)` as raw counts, NaN until they come.

    Args:
        num_fingers (int): Number of fingers :math:`F` that send, 1 or 2.
        period (float): Period that is asked for in seconds, a whole number of milliseconds up to
            255.

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
        need(num_fingers in (1, _FINGERS), "'num_fingers' must be 1 or 2", num_fingers)
        need(0.0005 < period < 0.2555, "'period' must be between 0.001 and 0.255 seconds", period)
        self.num_fingers, self.period = num_fingers, period
        self._extra = {
            name: np.full((num_fingers, _VALUES[kind]), np.nan, np.float32)
            for kind, name in _NAMES.items()
        }
        self._clear()

    def start(self) -> bytes:
        r"""Returns the command that makes the device send."""
        return bytes([_HEADER[0], 0, _AUTOSEND, 1, round(self.period * 1000)])

    def reset(self) -> None:
        r"""Forgets a half packet, and a half frame."""
        super().reset()
        self._clear()

    def _clear(self) -> None:
        self._static = np.full((self.num_fingers, _TAXELS), np.nan, np.float32)
        self._seen: set[int] = set()
        self._device_time: float | None = None

    def _size(self, buffer: bytes, start: int) -> int:
        if len(buffer) - start < _HEAD:
            return WAIT
        command, length = buffer[start + 2], buffer[start + 3]
        if command not in _COMMANDS:
            return NONE
        end = start + _HEAD + length
        if len(buffer) < end:
            return WAIT
        if self._in_place and not _may_hold_header(buffer[start + _HEAD : end]):
            return end - start
        # The header is a single byte, which is in readings too: another must follow the packet.
        if len(buffer) == end:
            return WAIT
        return end - start if buffer[end] == _HEADER[0] else NONE

    def _read(self, packet: bytes, now: int) -> list[LiveFrame] | None:
        blocks = _blocks(packet, 8) or _blocks(packet, 2)
        if not blocks or any(finger >= self.num_fingers for _, finger, _ in blocks):
            return None
        frames = []
        for kind, finger, data in blocks:
            if kind == _STATIC:
                if finger in self._seen or (finger == 0 and self._seen):
                    frames.append(self._frame(now))
                self._seen.add(finger)
                self._static[finger] = np.frombuffer(data, ">u2")
            elif kind in _NAMES:
                self._extra[_NAMES[kind]][finger] = np.frombuffer(data, ">i2")
            elif kind == _TIMESTAMP and len(data) == 8:
                self._device_time = int.from_bytes(data, "big") / 1000
        if len(self._seen) == self.num_fingers:
            frames.append(self._frame(now))
        return frames

    def _frame(self, now: int) -> LiveFrame:
        extra = {
            name: values[:, 0].copy() if values.shape[1] == 1 else values.copy()
            for name, values in self._extra.items()
        }
        tactile, device_time = self._static.reshape(-1, 1), self._device_time
        self._clear()
        return self._good_frame(now, tactile, None, device_time, **extra)


def _may_hold_header(data: bytes) -> bool:
    """Whether another packet may begin in this one, as when bytes are lost."""
    place = data.find(_HEADER)
    while place >= 0:
        if place + 2 >= len(data) or data[place + 2] in _COMMANDS:
            return True
        place = data.find(_HEADER, place + 1)
    return False


def _blocks(packet: bytes, timestamp: int) -> list[_Block] | None:
    """The blocks of a packet, or :obj:`None` if they do not fill it."""
    blocks = []
    place = _HEAD
    while place < len(packet):
        kind, finger = packet[place] & 0xF0, packet[place] >> 2 & 3
        size = timestamp if kind == _TIMESTAMP else 2 * _VALUES.get(kind, 0)
        data = packet[place + 1 : place + 1 + size]
        if size == 0 or len(data) < size:
            return None
        blocks.append((kind, finger, data))
        place += 1 + size
    return blocks
