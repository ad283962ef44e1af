r"""Decoder of PaXini PX-6AX sensors with a high-speed communication board."""

from typing import ClassVar

import numpy as np

from torch_geometric_tactile.data.live_frame import LiveFrame
from torch_geometric_tactile.io.decoders._header_decoder import INCOMPLETE, NO_PACKET, HeaderDecoder

_HEADER_BYTES = 6  # header, reserved byte, length of error code and data, error code
_FORCE_BYTES = 6  # total force of a module: x, y, z, of which only the lower bytes are used
_LAYOUTS: dict[tuple[int, ...], str] = {(31,): "paxini_31", (52,): "paxini_52"}
_NEWTONS_PER_STEP = np.float32(0.1)
# Writes 1 to the register that enables pushed frames.
_START_COMMAND = bytes.fromhex("55 AA 00 10 17 00 01 00 01")


class PaXiniDecoder(HeaderDecoder):
    r"""Decoder of PaXini PX-6AX (GEN3) modules with their high-speed communication board, which
    pushes frames. The serial converter board of a single module only answers requests, and is not
    supported. This decoder follows the open package :obj:`paxini-sdk` 0.1.0, and has not been
    tested on a device.

    A frame is AA 56, a reserved byte, the length, an error code, and for each module its total
    force (3 x 2 bytes) and the force at each of its points (3 bytes: signed x and y, unsigned z, in
    steps of 0.1 N). The last byte makes the sum of all bytes zero. Frames have no number, so the
    number of lost frames is estimated from the skipped bytes.

    Readings are newtons :math:`(N, 3)`, module by module. :obj:`extra` has the total force of each
    module as :obj:`"force"` :math:`(M, 3)` and the :obj:`"error"` :math:`(1,)` of the board.

    Args:
        points (tuple of int): Number of points of each module, in the order of the board: thumb,
            index, middle, ring and little finger, palm. In a URL, it is written as
            :obj:`"52x52"`.

    Raises:
        ValueError: If there is no module, or a module has no point or more than 512.

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
        self._length = sum(_FORCE_BYTES + 3 * number for number in self.points)

    @property
    def layout(self) -> str | None:
        r"""Name of the layout of a single module of 31 or 52 points, or else :obj:`None`."""
        return _LAYOUTS.get(self.points)

    def start(self) -> bytes:
        r"""Returns the command that makes the board push frames."""
        return _START_COMMAND + bytes([-sum(_START_COMMAND) % 256])

    def _size(self, buffer: bytes, start: int) -> int:
        if len(buffer) - start < _HEADER_BYTES:
            return INCOMPLETE
        length = int.from_bytes(buffer[start + 3 : start + 5], "little") - 1
        if length not in (0, self._length):  # 0: the answer to `start`
            return NO_PACKET
        size = _HEADER_BYTES + length + 1
        return size if len(buffer) - start >= size else INCOMPLETE

    def _read(self, packet: bytes, now: int) -> list[LiveFrame] | None:
        if sum(packet) % 256:
            return None
        if len(packet) == _HEADER_BYTES + 1:
            return []
        forces, readings, position = [], [], _HEADER_BYTES
        for num_points in self.points:
            forces.append(_bytes_to_newtons(packet[position : position + _FORCE_BYTES : 2]))
            position += _FORCE_BYTES
            readings.append(_bytes_to_newtons(packet[position : position + 3 * num_points]))
            position += 3 * num_points
        error = np.array([packet[_HEADER_BYTES - 1]], dtype=np.float32)
        tactile, force = np.concatenate(readings), np.concatenate(forces)
        return [self._count_frame(now, tactile, len(packet), force=force, error=error)]


def _bytes_to_newtons(data: bytes) -> np.ndarray:
    # Triples (x, y, z): x and y are signed, z is unsigned.
    steps = np.frombuffer(data, np.int8).reshape(-1, 3).astype(np.float32)
    steps[:, 2] %= 256
    return steps * _NEWTONS_PER_STEP
