r"""Decoder of lines of numbers as text, as most self-made sensors send them."""

from typing import ClassVar

import numpy as np

from torch_geometric_tactile._checks import need
from torch_geometric_tactile.data.live_frame import LiveFrame
from torch_geometric_tactile.io.decoders._number_line import parse_line
from torch_geometric_tactile.io.decoders.decoder import Decoder

# Units of the time: seconds of one, and the period after which a board's 32-bit counter wraps.
_TIME_UNITS: dict[str, tuple[float, float | None]] = {
    "none": (0.0, None),
    "s": (1.0, None),
    "ms": (1e-3, 2**32 / 1e3),
    "us": (1e-6, 2**32 / 1e6),
}
_MAX_LINE_BYTES = 2**16
_MAX_VALUES = 2**15  # of two characters each in a line
_MAX_TIME = 2**53  # largest integer that is exact in float64
_NUM_FIRST_LINES = 3  # consecutive lines that must agree before their number of values is used
_TOO_LONG = f"a line must end within {_MAX_LINE_BYTES} bytes"


class LinesDecoder(Decoder):
    r"""Decoder of lines of numbers, with one line per frame, as printed by :obj:`Serial.println`.

    The numbers are integers or floats, separated by commas, semicolons, or blanks and tabs. A line
    ends with LF or CR LF. Labels before the numbers, as in :obj:`a:12,b:13`, are ignored. A line
    with a different number of values or with other text is skipped. There is no checksum, so a
    damaged or missing digit gives a wrong number. The first line after the port was opened is left
    out, since the beginning of its first number may be missing.

    Readings are counts :math:`(N, C)`, all channels of taxel 0, then of taxel 1. Numbers that are
    infinite or too large for float32 become NaN.

    Args:
        time (str): Unit of the time, which is the first number of each line: :obj:`"s"`,
            :obj:`"ms"` or :obj:`"us"`; :obj:`"none"` if the lines have no time. Milliseconds and
            microseconds may wrap after 32 bits.
        num_taxels (int): Number of taxels :math:`N`. With 0, the first three consecutive lines with
            the same number of values determine it.
        num_channels (int): Number of channels :math:`C`.

    Raises:
        ValueError: If the unit of the time is unknown, or a number is out of range.

    Examples:
        >>> decoder = LinesDecoder(time="ms", num_taxels=3)
        >>> (frame,) = decoder.feed(b"3,900\r\n1250,512,513,900\r\n", now=0)
        >>> frame.device_time, frame.tactile.ravel().tolist()
        (1.25, [512.0, 513.0, 900.0])
    """

    checksum: ClassVar[str] = "none"
    baudrate: ClassVar[int] = 115_200

    def __init__(self, time: str = "none", num_taxels: int = 0, num_channels: int = 1) -> None:
        super().__init__()
        need(time in _TIME_UNITS, f"'time' must be one of {', '.join(_TIME_UNITS)}", repr(time))
        need(
            1 <= num_channels <= 255,
            "'num_channels' must be an integer from 1 to 255",
            num_channels,
        )
        max_taxels = _MAX_VALUES // num_channels
        need(
            0 <= num_taxels <= max_taxels,
            f"'num_taxels' must be an integer from 0 to {max_taxels}",
            num_taxels,
        )
        self.time = time
        self.num_taxels = num_taxels
        self.num_channels = num_channels
        self._time_scale, self.clock_period = _TIME_UNITS[time]
        self._num_times = int(time != "none")
        self._first_lines: list[tuple[list[float], int, int]] = []  # values, bytes, arrival
        self._buffer = b""
        self._has_start = False  # whether the content of the buffer follows a line end

    def feed(self, data: bytes, now: int) -> list[LiveFrame]:
        r"""Decodes bytes, and returns the frames that they complete."""
        *lines, self._buffer = (self._buffer + data).split(b"\n")
        frames = []
        for line in lines:
            if self._has_start:
                frames += self._line_to_frames(line, now)
            else:
                self.counts.skipped += len(line) + 1
            self._has_start = True
        if len(self._buffer) > _MAX_LINE_BYTES:
            self._drop_buffer()
        return frames

    def reset(self) -> None:
        r"""Discards an incomplete line. The number of values in a line is kept."""
        self.counts.skipped += len(self._buffer)
        self._skip_first_lines()
        self._buffer, self._has_start = b"", False

    def _drop_buffer(self) -> None:
        if self._has_start:
            self._skip_line(len(self._buffer), _TOO_LONG)
        else:
            self.counts.skipped += len(self._buffer)
        self._buffer, self._has_start = b"", False

    def _line_to_frames(self, line: bytes, now: int) -> list[LiveFrame]:
        if not line.strip(b"\r"):
            return []  # an empty line
        size = len(line) + 1
        values = parse_line(line) if len(line) <= _MAX_LINE_BYTES else None
        if values is None:
            is_long = len(line) > _MAX_LINE_BYTES
            self._skip_line(
                size, _TOO_LONG if is_long else f"a line must be numbers (got {line[:40]!r})"
            )
            return []
        reason = self._why_no_frame(values)
        if reason:
            self._skip_line(size, reason)
            return []
        if self.num_taxels:
            return [self._values_to_frame(values, now)]
        if self._first_lines and len(values) != len(self._first_lines[0][0]):
            self._skip_first_lines()
        self._first_lines.append((values, size, now))
        if len(self._first_lines) < _NUM_FIRST_LINES:
            return []
        self.num_taxels = (len(values) - self._num_times) // self.num_channels
        first_lines, self._first_lines = self._first_lines, []
        return [self._values_to_frame(values, arrival) for values, _, arrival in first_lines]

    def _why_no_frame(self, values: list[float]) -> str:
        r"""Returns the reason why the numbers of a line are not a frame, or an empty string."""
        if self._num_times and not abs(values[0]) <= _MAX_TIME:
            return f"the time of a line must be a number of up to 2^53 (got {values[0]})"
        if self.num_taxels:
            num_values = self.num_taxels * self.num_channels + self._num_times
            is_right = len(values) == num_values
            return "" if is_right else f"a line must have {num_values} numbers (got {len(values)})"
        num_readings = len(values) - self._num_times
        if num_readings and num_readings % self.num_channels == 0:
            return ""
        return (
            f"a line must have a multiple of num_channels={self.num_channels} readings "
            f"(got {num_readings})"
        )

    def _values_to_frame(self, values: list[float], now: int) -> LiveFrame:
        with np.errstate(over="ignore"):
            tactile = np.array(values[self._num_times :], dtype=np.float32)
        tactile[np.isinf(tactile)] = np.nan
        device_time = values[0] * self._time_scale if self._num_times else None
        return self._count_frame(now, tactile.reshape(-1, self.num_channels), 1, device_time)

    def _skip_line(self, size: int, reason: str) -> None:
        self._skip_first_lines()
        self.counts.skipped += size
        self.counts.refuse(reason)
        if self.counts.good:  # before the first frame, lines are startup messages
            self.counts.corrupt += 1
            self._missing += 1

    def _skip_first_lines(self) -> None:
        self.counts.skipped += sum(size for _, size, _ in self._first_lines)
        self._first_lines = []
