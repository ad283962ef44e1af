r"""Bytes of PaXini PX-6AX sensors behind a high-speed communication board."""

from typing import ClassVar

import numpy as np

from torch_geometric_tactile.data.live_frame import LiveFrame
from torch_geometric_tactile.io.decoders._header_decoder import NONE, WAIT, HeaderDecoder

_HEAD = 6  # bytes before the data: header, reserved, length of error code and data, error code
_FORCE = 6  # bytes of the whole force of a module: x, y, z, of which the lower bytes are read
_NEWTON = np.float32(0.1)  # of one step
_START = bytes.fromhex("55 AA 00 10 17 00 01 00 01")  # writes 1 to the register of pushed frames


class PaXiniDecoder(HeaderDecoder):
    r"""Decoder of PaXini PX-6AX (GEN3) modules behind their high-speed communication board, which
    pushes frames; the serial converter board of a single module only answers requests, and is not
    read. Written from the open package :obj:`paxini-sdk` 0.1.0, and not tested on a device.

    A frame is AA 56, a reserved byte, the length, an error code, and for each module its force
    (3 x 2 bytes) and the force at each of its points (3 bytes: signed x and y, unsigned z; 0.1 N a
    step), as the board sends after it was switched on; then a byte that makes the sum of all zero.
    There is no number: frames lost are estimated from the bytes skipped.

    Readings are newtons :math:`(N, 3)`, module after module; :obj:`extra` has the force of each
    module as :obj:`"force"` :math:`(M, 3)` and the :obj:`"error"` :math:`(1,)` of the board.

    Args:
        points (tuple of int): Number of points of each module, in the order of the board: thumb,
            index, middle, ring and little finger, palm; such as :obj:`"52x52"` in a URL.

    Raises:
        ValueError: If there is no module, or one has no point or more than 512.

    Examples:
        >>> decoder = PaXiniDecoder(points=(1,))
        >>> body = bytes.fromhex("AA 56 00 0A 00 00") + bytes([1, 0, 0, 0, 9, 0, 255, 2, 200])
        >>> (frame,) = decoder.feed(body + bytes([-sum(body) % 256]), now=0)
        >>> frame.tactile.round(1).tolist()
        [[-0.10000000149011612, 0.20000000298023224, 20.0]]
    """

    checksum: ClassVar[str] = "sum"
    baudrate: ClassVar[int] = 921_600
    header: ClassVar[bytes] = b"\xaa\x56"
    unit: ClassVar[str] = "newton"

    def __init__(self, points: tuple[int, ...] = (52,)) -> None:
        super().__init__()
        if not 1 <= len(points) <= 28 or not all(1 <= number <= 512 for number in points):
            raise ValueError(
                "'points' must be the number of points of each of up to 28 modules, from 1 to 512 "
                f"each (got {points})"
            )
        self.points = tuple(map(int, points))
        self._length = sum(_FORCE + 3 * number for number in self.points)

    def start(self) -> bytes:
        r"""Returns what asks the board to push frames."""
        return _START + bytes([-sum(_START) % 256])

    def _size(self, buffer: bytes, start: int) -> int:
        if len(buffer) - start < _HEAD:
            return WAIT
        length = int.from_bytes(buffer[start + 3 : start + 5], "little") - 1
        if length not in (0, self._length):  # 0: the answer to `start`
            return NONE
        size = _HEAD + length + 1
        return size if len(buffer) - start >= size else WAIT

    def _read(self, packet: bytes, now: int) -> list[LiveFrame] | None:
        if sum(packet) % 256:
            return None
        if len(packet) == _HEAD + 1:
            return []
        forces, readings, place = [], [], _HEAD
        for number in self.points:
            forces.append(_newtons(packet[place : place + _FORCE : 2]))
            place += _FORCE
            readings.append(_newtons(packet[place : place + 3 * number]))
            place += 3 * number
        error = np.array([packet[_HEAD - 1]], dtype=np.float32)
        tactile, force = np.concatenate(readings), np.concatenate(forces)
        return [self._good_frame(now, tactile, len(packet), force=force, error=error)]


def _newtons(data: bytes) -> np.ndarray:
    # (x, y, z) in a row, of which z has no sign.
    steps = np.frombuffer(data, np.int8).reshape(-1, 3).astype(np.float32)
    steps[:, 2] %= 256
    return steps * _NEWTON
