r"""Regular times of frames, from their numbers and when they arrived."""

import math
from collections import deque
from collections.abc import Sequence

_BLOCK = 0.25  # seconds of arrivals between two fits
_MIN_ARRIVALS = 8  # for a period, and kept however old they are
_MIN_SECONDS = 0.5
_SLEW = 0.05  # share of the period by which the distance of two frames may be corrected
_STEP = 1e-6  # between frames that cannot be told apart: times as of 1970 keep it in a double
_GAP_ARRIVALS = 5
_GAP_SECONDS = 0.05  # a busy machine stops a process for about so long
_UNKNOWN_GAP = 0.5  # seconds, while nothing is known of the rate
_CATCH_UP = 0.5  # seconds that a sender may be late and make up for

_Point = tuple[int, float]  # a number, and when it arrived


class FrameClock:
    r"""Estimates when frames were measured, from their numbers and from when they arrived.

    Frames leave a sensor at a constant period, and arrive late: by the jitter of the system, and
    by waiting for others that are sent or read with them. So the frame with number :math:`n` was
    measured at :math:`a + p n`, the highest line below all arrivals of the last seconds, more
    exactly the edge of their lower convex hull at the mean number. Slow drift is followed by at
    most 5 % of a period for each frame. Before a period is known, the frames of one read are spread
    evenly from the previous arrival on.

    After a loss the numbers tell how much time has passed. If they do not, as after a pause of the
    device or a loss that nobody could count, frames stay late; the line then begins anew at the
    present, with the same period.

    Args:
        window (float): Over how many seconds of arrivals the line is fitted.

    Examples:
        >>> clock = FrameClock()
        >>> clock.times([0], 1.0)
        [1.0]
        >>> clock.times([1, 2, 3, 4], 1.5)  # read together
        [1.125, 1.25, 1.375, 1.5]
    """

    def __init__(self, window: float = 5.0) -> None:
        self.window = window
        self._last: _Point | None = None  # number and time of the last frame
        self._device_number = 0
        self._spacing: float | None = None  # seconds, known or rough
        self._seconds = 0.0  # over which the rate was measured
        self.reset()

    def reset(self) -> None:
        r"""Begins anew, as after the device was opened again."""
        self._blocks: deque[list[_Point]] = deque()
        self._sizes: deque[int] = deque()  # arrivals in each block
        self._block_began = -math.inf
        self._first: _Point | None = None
        self._line: _Point | None = None
        self._period: float | None = None
        self._is_fitted = False
        self._late_since: tuple[float, float] | None = None  # arrival, and how late it was

    @property
    def rate(self) -> float | None:
        r"""Frames per second by their numbers, as measured over the last seconds; :obj:`None` until
        a second of arrivals has been seen."""
        return None if self._spacing is None or self._seconds < 1 else 1 / self._spacing

    @property
    def largest_gap(self) -> float:
        r"""The longest time between two frames in seconds that is no outage: five periods, and at
        least 50 ms."""
        if self._spacing is None:
            return _UNKNOWN_GAP
        return max(_GAP_SECONDS, _GAP_ARRIVALS * self._spacing)

    def times(
        self,
        numbers: Sequence[int],
        arrival: float,
        *,
        waited: float = math.inf,
        since: float = -math.inf,
    ) -> list[float]:
        r"""Returns the times of frames that arrived together, on the clock of :obj:`arrival` and
        never later than it, strictly increasing over all calls.

        Args:
            numbers (sequence of int): Their numbers. A step back is a device that has started over.
            arrival (float): When they arrived, in seconds.
            waited (float): How long the reader had waited for them in seconds. If shorter than a
                gap, it was the reader who was late.
            since (float): The first frames are not older than this, such as the time of opening.
        """
        places = self._places(numbers)
        last = places[-1]
        if self._first is None:
            begins = True
        elif self._line is not None and self._period is not None:
            begins = self._is_outage(last, arrival, waited)
        else:
            begins = self._is_rough_outage(last, arrival)
        if begins:
            times = self._begun(places, arrival, since)
            self._restart(last, arrival)
        else:
            times = self._continued(places, arrival)
        self._last = last, times[-1]
        self._add(last, arrival)
        return times

    def observe(self, number: int, time: float) -> float:
        r"""Takes note of a frame whose time is known, and returns the time, or one just after that
        of the frame before if it is not later.

        Args:
            number (int): Its number.
            time (float): Its time in seconds.
        """
        before = -math.inf if self._last is None else self._last[1]
        self.times([number], time)
        assert self._last is not None
        self._last = self._last[0], max(time, before + _STEP)
        return self._last[1]

    def _places(self, numbers: Sequence[int]) -> list[int]:
        # The numbers, such that they increase.
        place = numbers[0] - 1 if self._last is None else self._last[0]
        before = place if self._last is None else self._device_number
        places = []
        for number in numbers:
            place += number - before if number > before else 1
            before = number
            places.append(place)
        self._device_number = before
        return places

    def _is_outage(self, number: int, arrival: float, waited: float) -> bool:
        # Lowers the line where a frame came early, and tells whether it has to begin anew.
        assert self._line is not None
        assert self._period is not None
        late = arrival - self._line[1] - self._period * (number - self._line[0])
        gap = self.largest_gap
        if late <= 0:
            self._line = self._line[0], self._line[1] + late
            if -late > gap:  # numbers that jumped without reason
                self._clear()
            late = 0.0
        if late <= gap:
            self._late_since = None
            return False
        if late > _CATCH_UP and waited > gap:
            return True
        before = self._late_since
        if before is None or late < before[1] - self._period / 2:  # it catches up
            self._late_since = before = (arrival, late)
        return arrival - before[0] > gap

    def _is_rough_outage(self, number: int, arrival: float) -> bool:
        # The same before the period is known.
        if self._spacing is None or self._last is None:
            return False
        expected = self._spacing * (number - self._last[0])
        return arrival - self._last[1] - expected > self.largest_gap

    def _begun(self, places: list[int], arrival: float, since: float) -> list[float]:
        # At the present, and back from there at the period as far as it is known.
        count = places[-1] - places[0] + 1
        start = since if self._last is None else self._last[1]
        if self._spacing is not None:
            start = max(start, arrival - self._spacing * count)
        elif not arrival - _UNKNOWN_GAP < start < arrival:
            start = arrival - _STEP * count
        return _spread(places, places[0] - 1, start, arrival)

    def _continued(self, places: list[int], arrival: float) -> list[float]:
        assert self._last is not None
        number, time = self._last
        last, end = places[-1], arrival
        if self._line is not None and self._period is not None:
            step = self._period * (last - number)
            wanted = self._line[1] + self._period * (last - self._line[0]) - time
            slew = _SLEW * step
            if wanted > step + slew:
                wanted = step + slew
            elif wanted < step - slew:
                wanted = step - slew
            end = time + wanted
        return _spread(places, number, time, min(end, arrival))

    def _restart(self, number: int, arrival: float) -> None:
        self._clear()
        if not self._is_fitted:  # late again so soon: the rate is another one
            self._period = None
        self._is_fitted = False
        self._first = number, arrival
        self._line = (number, arrival) if self._period is not None else None
        self._late_since = None

    def _clear(self) -> None:
        self._blocks.clear()
        self._sizes.clear()
        self._block_began = -math.inf

    def _add(self, number: int, arrival: float) -> None:
        if self._first is None:
            self._first = number, arrival
        if not self._blocks or arrival - self._block_began >= _BLOCK:
            if self._blocks:
                self._fit()
            self._blocks.append([])
            self._sizes.append(0)
            self._block_began = arrival
            while (
                self._blocks[0]
                and self._blocks[0][-1][1] < arrival - self.window
                and sum(self._sizes) - self._sizes[0] > 2 * _MIN_ARRIVALS
            ):
                self._blocks.popleft()
                self._sizes.popleft()
        _push(self._blocks[-1], (number, arrival))
        self._sizes[-1] += 1
        if self._seconds < 1:
            self._seconds = max(self._seconds, arrival - self._first[1])
        if self._period is None:
            self._measure_roughly(number, arrival)

    def _measure_roughly(self, number: int, arrival: float) -> None:
        # From the first arrival to the last one.
        assert self._first is not None
        seconds = arrival - self._first[1]
        if sum(self._sizes) > 2 and seconds > 0:
            self._spacing = seconds / (number - self._first[0])

    def _fit(self) -> None:
        hull: list[_Point] = []
        for block in self._blocks:
            for point in block:
                _push(hull, point)
        (first, began), (last, ended) = hull[0], hull[-1]
        if sum(self._sizes) < _MIN_ARRIVALS or ended - began < _MIN_SECONDS:
            return
        middle = (first + last) / 2
        i = next(i for i in range(1, len(hull)) if hull[i][0] >= middle)
        (n, t), (m, u) = hull[i - 1], hull[i]
        if u > t:
            self._period = self._spacing = (u - t) / (m - n)
            self._line = m, u
            self._is_fitted = True

    def __repr__(self) -> str:
        return f"{type(self).__name__}(rate={self.rate}, window={self.window})"


def _spread(places: list[int], number: int, time: float, end: float) -> list[float]:
    # Evenly by their numbers, from one frame to the end.
    end = end if end > time else time + _STEP * (places[-1] - number)
    if len(places) == 1:  # the usual case
        return [end]
    step = (end - time) / (places[-1] - number)
    return [*[time + step * (place - number) for place in places[:-1]], end]


def _push(hull: list[_Point], point: _Point) -> None:
    # Adds a point at the right of a lower convex hull.
    n, t = point
    while len(hull) > 1:
        (a, u), (b, v) = hull[-2], hull[-1]
        if (v - u) * (n - b) < (t - v) * (b - a):
            break
        hull.pop()
    hull.append(point)
