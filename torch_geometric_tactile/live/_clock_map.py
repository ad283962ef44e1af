r"""Conversion of device times to the clock of this host."""

import math
from collections import deque

_MAX_AHEAD_SECONDS = 0.05  # a device that is further ahead has jumped
_BATCH_SECONDS = 0.5  # longest time between frames that arrive together


class ClockMap:
    r"""Maps times of a device to this host's monotonic clock while frames arrive.

    Frames are never early. They are often late, because of jitter in the cable, the driver and the
    system. The smallest difference between host and device times over the last seconds is therefore
    the best estimate of the offset between the clocks. It follows slow drift. A clock that wraps
    around after :obj:`period` seconds is unwrapped. If the time jumps and the next frame confirms
    the jump, as after a restart of the device, the estimate restarts. A jump that is not confirmed
    is treated as a damaged time and ignored.

    Args:
        period (float, optional): Seconds after which the clock of the device wraps around, such as
            :math:`2^{32} / 10^6` for microseconds in 32 bits.
        window (float): Seconds over which the smallest difference is taken.

    Raises:
        ValueError: If an argument is not positive.

    Examples:
        >>> clock = ClockMap()
        >>> clock.map(5.0, 1_000_000_000), clock.map(6.0, 2_003_000_000)  # 3 ms late
        (1.0, 2.0)
    """

    def __init__(self, period: float | None = None, window: float = 5.0) -> None:
        if period is not None and not (period > 0 and math.isfinite(period)):
            raise ValueError(f"'period' must be a positive number of seconds (got {period})")
        if not (window > 0 and math.isfinite(window)):
            raise ValueError(f"'window' must be a positive number of seconds (got {window})")
        self.period = period
        self.window = window
        self.reset()

    def reset(self) -> None:
        r"""Forgets all times, for a device that was opened again."""
        self._min_offsets: deque[tuple[float, float]] = (
            deque()
        )  # (host, offset), offsets increasing
        self._last: tuple[float, float] | None = None
        self._jump: tuple[float, float] | None = None

    def map(self, device_time: float | None, received: int) -> float:
        r"""Returns the time of a frame on the host's monotonic clock in seconds. It is never later
        than the time of reception.

        Args:
            device_time (float, optional): Time on the clock of the device in seconds.
            received (int): Time of reception on the host's monotonic clock in nanoseconds.
        """
        host = received * 1e-9
        if device_time is None or not math.isfinite(device_time):
            return host
        device = self._unwrap(device_time, host)
        if self._is_jump(device, host):
            jump, self._jump = self._jump, (device, host)
            if jump is None or not _agrees_with_jump(jump, device, host):
                return host
            self._min_offsets.clear()
            self._add_offset(jump[1], jump[1] - jump[0])
        self._jump = None
        self._last = (device, host)
        self._add_offset(host, host - device)
        return min(device + self._min_offsets[0][1], host)

    def _unwrap(self, device: float, host: float) -> float:
        if self.period is None or self._last is None:
            return device
        device %= self.period
        expected = self._last[0] + host - self._last[1]
        return device + self.period * round((expected - device) / self.period)

    def _is_jump(self, device: float, host: float) -> bool:
        if self._last is None:
            return False
        self._drop_old(host)
        is_ahead = (
            bool(self._min_offsets) and host - device < self._min_offsets[0][1] - _MAX_AHEAD_SECONDS
        )
        return is_ahead or device < self._last[0]

    def _add_offset(self, host: float, offset: float) -> None:
        while self._min_offsets and self._min_offsets[-1][1] >= offset:
            self._min_offsets.pop()
        self._min_offsets.append((host, offset))
        self._drop_old(host)

    def _drop_old(self, host: float) -> None:
        while self._min_offsets and self._min_offsets[0][0] < host - self.window:
            self._min_offsets.popleft()

    def __repr__(self) -> str:
        return f"{type(self).__name__}(period={self.period}, window={self.window})"


def _agrees_with_jump(jump: tuple[float, float], device: float, host: float) -> bool:
    # Whether both clocks advanced equally since a jump, up to the frames of one read.
    step = device - jump[0]
    return step >= 0 and abs(step - (host - jump[1])) < _BATCH_SECONDS
