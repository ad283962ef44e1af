r"""Decoder of rows of numbers as text, as sent by 3D-ViTac boards."""

import logging
import re
from typing import ClassVar

import numpy as np

from torch_geometric_tactile.data.live_frame import LiveFrame
from torch_geometric_tactile.io.decoders._header_decoder import check_shape
from torch_geometric_tactile.io.decoders._number_line import parse_line
from torch_geometric_tactile.io.decoders.decoder import Decoder

_VALID_BYTES = b"0123456789 \t\r\n"
_LEADING_BREAKS = re.compile(rb"[\r\n]*")
_EMPTY_ROW = re.compile(rb"\n\r?\n")
_MAX_COUNT = 255
_log = logging.getLogger(__name__)


class TextRowsDecoder(Decoder):
    r"""Decoder of `3D-ViTac <https://binghao-huang.github.io/3D-ViTac/>`_ boards.

    A frame consists of rows of numbers from 0 to 255 in ASCII, separated by blanks. Each row ends
    with CR LF, and an empty row ends the frame. A frame with a different number of rows or columns,
    or with other characters, is corrupt. There is no checksum, so a damaged or missing digit gives
    a wrong number. The first frame after the port was opened is left out, since the beginning of
    its first number may be missing.

    Readings are counts :math:`(R \cdot C, 1)`, row by row.

    Args:
        shape (tuple of int): Number of rows :math:`R` and of columns :math:`C`.

    Raises:
        ValueError: If the shape is not two positive numbers.

    Examples:
        >>> decoder = TextRowsDecoder(shape=(2, 3))
        >>> (frame,) = decoder.feed(b"\r\n1 2 3 \r\n4 5 255 \r\n\r\n", now=0)
        >>> frame.tactile.ravel().tolist()
        [1.0, 2.0, 3.0, 4.0, 5.0, 255.0]
    """

    checksum: ClassVar[str] = "none"
    baudrate: ClassVar[int] = 2_000_000

    def __init__(self, shape: tuple[int, int] = (16, 16)) -> None:
        super().__init__()
        self.shape = check_shape(shape)
        # Size of a frame, with up to two blanks per number.
        self._max_bytes = self.shape[0] * (5 * self.shape[1] + 2)
        self._buffer = b""
        self._has_start = False  # whether the content of the buffer follows an empty row
        self._too_long = False

    def feed(self, data: bytes, now: int) -> list[LiveFrame]:
        r"""Decodes bytes, and returns the frames that they complete."""
        buffer = self._buffer + data
        frames = []
        start = self._skip_empty_rows(buffer, 0)
        while (end := _EMPTY_ROW.search(buffer, start)) is not None:
            frame = self._frame(buffer[start : end.start() + 1], now)
            if frame is not None:
                frames.append(frame)
            self._has_start, self._too_long = True, False
            start = self._skip_empty_rows(buffer, end.end())
        self._buffer = buffer[start:]
        if len(self._buffer) > self._max_bytes + 2 or self._too_long:
            if not self.counts.reason:  # once
                self._warn_of_lines()
            self._skip(self._buffer[:-2])
            self.counts.refuse(f"no empty row ends a frame of up to {self._max_bytes} bytes")
            # The last two bytes may be the start of an empty row.
            self._buffer, self._too_long = self._buffer[-2:], True
        return frames

    def _warn_of_lines(self) -> None:
        num_taxels = self.shape[0] * self.shape[1]
        lines = self._buffer.split(b"\n")[:-1]
        if self.shape[0] > 1 and any(len(parse_line(line) or ()) == num_taxels for line in lines):
            _log.warning(
                "a line has all %d numbers of a frame: use protocol=lines instead of text",
                num_taxels,
            )

    def _skip_empty_rows(self, buffer: bytes, start: int) -> int:
        r"""Returns the position of the next frame, after empty rows."""
        if self._too_long:
            return start
        empty = _LEADING_BREAKS.match(buffer, start)
        end = empty.end() if empty else start
        self._has_start = self._has_start or b"\n" in buffer[start:end]
        return end

    def reset(self) -> None:
        r"""Discards an incomplete frame."""
        self._skip(self._buffer)
        self._buffer, self._has_start, self._too_long = b"", False, False

    def _frame(self, block: bytes, now: int) -> LiveFrame | None:
        counts = self._parse_counts(block) if self._has_start and not self._too_long else None
        if counts is None:
            self.counts.corrupt += self._has_start
            if self._has_start:
                rows = block.rstrip(b"\r\n").split(b"\n")
                self.counts.refuse(
                    f"a frame of {len(rows)} rows of {len(rows[0].split())} must have 'shape' "
                    f"{self.shape[0]}x{self.shape[1]} and numbers from 0 to {_MAX_COUNT}"
                )
            self._skip(block)
            return None
        return self._count_frame(now, counts, self.shape[0])

    def _parse_counts(self, block: bytes) -> np.ndarray | None:
        if len(block) > self._max_bytes or block.translate(None, _VALID_BYTES):
            return None
        rows = [row.split() for row in block.rstrip(b"\r\n").split(b"\n")]
        if len(rows) != self.shape[0] or any(len(row) != self.shape[1] for row in rows):
            return None
        cells = [cell for row in rows for cell in row]
        if max(map(len, cells)) > 3:
            return None
        counts = np.array(list(map(int, cells)), dtype=np.float32)
        return counts.reshape(-1, 1) if counts.max() <= _MAX_COUNT else None

    def _skip(self, data: bytes) -> None:
        self.counts.skipped += len(data)
        self._missing += data.count(b"\n")
