r"""From the clock of a device to the clock of this host."""

import math
from collections import deque

_TOLERANCE = 0.05  # seconds by which a device may seem ahead before it is a jump
_BATCH = 0.5  # seconds from the first to the last frame that may arrive together


class ClockMap:
    r"""Maps times of a device to this host's monotonic clock while frames arrive.

    A frame is never early and often late: by the jitter of the cable, the driver and the system. So
    the least difference of host and device over the last seconds is the best guess of the
    difference of the clocks. It follows slow drift. A clock that starts over after :obj:`period`
    seconds is unwrapped. A jump that the next frame confirms, such as that of a device that was
    restarted, begins anew; one that it does not confirm is a damaged time, and is left out.

    Args:
        period (float, optional): After how many seconds the clock of the device starts over, such
            as :math:`2^{32} / 10^6` for microseconds in 32 bits.
        window (float): Over how many seconds the least difference is taken.

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
        r"""Begins anew, as after the device was opened again."""
        self._least: deque[tuple[float, float]] = deque()  # (host, offset), offsets increasing
        self._last: tuple[float, float] | None = None
        self._jump: tuple[float, float] | None = None

    def map(self, device_time: float | None, received: int) -> float:
        r"""Returns the time of a frame on the host's monotonic clock in seconds, never later than
        it was received.

        Args:
            device_time (float, optional): Its time on the clock of the device in seconds.
            received (int): When it was received, on the host's monotonic clock in nanoseconds.
        """
        host = received * 1e-9
        if device_time is None or not math.isfinite(device_time):
            return host
        device = self._unwrapped(device_time, host)
        if self._is_jump(device, host):
            before, self._jump = self._jump, (device, host)
            if before is None or not _runs_on(before, device, host):
                return host
            self._least.clear()
            self._add(before[1], before[1] - before[0])
        self._jump = None
        self._last = (device, host)
        self._add(host, host - device)
        return min(device + self._least[0][1], host)

    def _unwrapped(self, device: float, host: float) -> float:
        if self.period is None or self._last is None:
            return device
        device %= self.period
        expected = self._last[0] + host - self._last[1]
        return device + self.period * round((expected - device) / self.period)

    def _is_jump(self, device: float, host: float) -> bool:
        if self._last is None:
            return False
        self._drop_old(host)
        ahead = bool(self._least) and host - device < self._least[0][1] - _TOLERANCE
        return ahead or device < self._last[0]

    def _add(self, host: float, offset: float) -> None:
        while self._least and self._least[-1][1] >= offset:
            self._least.pop()
        self._least.append((host, offset))
        self._drop_old(host)

    def _drop_old(self, host: float) -> None:
        while self._least and self._least[0][0] < host - self.window:
            self._least.popleft()

    def __repr__(self) -> str:
        return f"{type(self).__name__}(period={self.period}, window={self.window})"


def _runs_on(before: tuple[float, float], device: float, host: float) -> bool:
    # Whether device and host went on alike since a jump; frames of one read may be far apart.
    step = device - before[0]
    return step >= 0 and abs(step - (host - before[1])) < _BATCH
