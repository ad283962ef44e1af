r"""Regular times of frames, estimated from their numbers and their arrivals."""

import math
from collections import deque
from collections.abc import Sequence

_BLOCK_SECONDS = 0.25  # seconds of arrivals between two fits
_MIN_ARRIVALS = 8  # fewer arrivals do not define a period; as many are kept even if they are old
_MIN_SECONDS = 0.5
_SLEW = 0.05  # largest correction of the time between two frames, as a fraction of the period
_MIN_STEP = 1e-6  # seconds between frames of one arrival: a double resolves it in times since 1970
_GAP_PERIODS = 5
_MIN_GAP_SECONDS = 0.05  # a busy machine may stop a process for this long
_DEFAULT_GAP_SECONDS = 0.5  # while the rate is unknown
_MAX_LATE_SECONDS = 0.5  # a sender that is later does not catch up

_Point = tuple[int, float]  # number and arrival of a frame


class FrameClock:
    r"""Estimates the times at which frames were measured, from their numbers and arrivals.

    Frames leave a sensor at a constant period but arrive late, because of jitter and because they
    wait for frames that are sent or read with them. The frame with number :math:`n` was measured at
    :math:`a + p n`, the highest line below all arrivals of the last seconds. More exactly, the line
    is the edge of their lower convex hull at the mean number. The times follow slow drift by at
    most 5 % of a period for each frame. Before the period is known, the frames of one read are
    spread evenly over the time since the previous arrival.

    After a loss, the frame numbers give the elapsed time. After a pause of the device or an
    uncounted loss they do not, and frames stay late. The line then restarts at the present with the
    same period.

    Args:
        window (float): Seconds of arrivals over which the line is fitted.

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
        self._spacing: float | None = None  # seconds between frames, fitted or a first estimate
        self._observed_seconds = 0.0  # time over which the rate was measured
        self.reset()

    def reset(self) -> None:
        r"""Forgets all arrivals, for a device that was opened again."""
        self._blocks: deque[list[_Point]] = deque()
        self._block_sizes: deque[int] = deque()  # number of arrivals in each block
        self._block_start = -math.inf
        self._first: _Point | None = None
        self._line: _Point | None = None
        self._period: float | None = None
        self._is_fitted = False
        self._late_since: tuple[float, float] | None = None  # arrival and delay in seconds

    @property
    def rate(self) -> float | None:
        r"""Frames per second over the last seconds, by frame numbers; :obj:`None` in the first
        second."""
        return None if self._spacing is None or self._observed_seconds < 1 else 1 / self._spacing

    @property
    def largest_gap(self) -> float:
        r"""Longest time in seconds between two frames that is not an outage: five periods, and at
        least 50 ms."""
        if self._spacing is None:
            return _DEFAULT_GAP_SECONDS
        return max(_MIN_GAP_SECONDS, _GAP_PERIODS * self._spacing)

    def times(
        self,
        numbers: Sequence[int],
        arrival: float,
        *,
        waited: float = math.inf,
        since: float = -math.inf,
    ) -> list[float]:
        r"""Returns the times of frames that arrived together, on the clock of :obj:`arrival`. They
        are never later than the arrival, and increase strictly over all calls.

        Args:
            numbers (sequence of int): Numbers of the frames. A step back means that the device has
                started again.
            arrival (float): Time of arrival in seconds.
            waited (float): Seconds that the reader waited for the frames. If it is shorter than a
                gap, the reader was late, not the sender.
            since (float): Earliest possible time of the first frames, such as the time of opening.
        """
        increasing = self._to_increasing_numbers(numbers)
        last = increasing[-1]
        if self._first is None:
            is_restart = True
        elif self._line is not None and self._period is not None:
            is_restart = self._is_outage(last, arrival, waited)
        else:
            is_restart = self._is_rough_outage(last, arrival)
        if is_restart:
            times = self._restart_times(increasing, arrival, since)
            self._restart(last, arrival)
        else:
            times = self._continued_times(increasing, arrival)
        self._last = last, times[-1]
        self._add_arrival(last, arrival)
        return times

    def observe(self, number: int, time: float) -> float:
        r"""Adds a frame with an exact time, and returns the time. If it is not later than the
        previous frame, returns a time just after the previous frame.

        Args:
            number (int): Number of the frame.
            time (float): Time of the frame in seconds.
        """
        previous_time = -math.inf if self._last is None else self._last[1]
        self.times([number], time)
        assert self._last is not None
        self._last = self._last[0], max(time, previous_time + _MIN_STEP)
        return self._last[1]

    def _to_increasing_numbers(self, numbers: Sequence[int]) -> list[int]:
        # Device numbers step back after a restart of the device; the returned numbers continue.
        count = numbers[0] - 1 if self._last is None else self._last[0]
        previous = count if self._last is None else self._device_number
        increasing = []
        for number in numbers:
            count += number - previous if number > previous else 1
            previous = number
            increasing.append(count)
        self._device_number = previous
        return increasing

    def _is_outage(self, number: int, arrival: float, waited: float) -> bool:
        # Lowers the line if a frame is early. Returns whether the line has to restart.
        assert self._line is not None
        assert self._period is not None
        delay = arrival - self._line[1] - self._period * (number - self._line[0])
        gap = self.largest_gap
        if delay <= 0:
            self._line = self._line[0], self._line[1] + delay
            if -delay > gap:  # the numbers jumped without a loss
                self._clear()
            delay = 0.0
        if delay <= gap:
            self._late_since = None
            return False
        if delay > _MAX_LATE_SECONDS and waited > gap:
            return True
        late_start = self._late_since
        if late_start is None or delay < late_start[1] - self._period / 2:  # it catches up
            self._late_since = late_start = (arrival, delay)
        return arrival - late_start[0] > gap

    def _is_rough_outage(self, number: int, arrival: float) -> bool:
        # As `_is_outage`, before the period is known.
        if self._spacing is None or self._last is None:
            return False
        expected = self._spacing * (number - self._last[0])
        return arrival - self._last[1] - expected > self.largest_gap

    def _restart_times(self, numbers: list[int], arrival: float, since: float) -> list[float]:
        # The last frame is at its arrival, the others before it at the period, if it is known.
        num_periods = numbers[-1] - numbers[0] + 1
        start = since if self._last is None else self._last[1]
        if self._spacing is not None:
            start = max(start, arrival - self._spacing * num_periods)
        elif not arrival - _DEFAULT_GAP_SECONDS < start < arrival:
            start = arrival - _MIN_STEP * num_periods
        return _spread_times(numbers, numbers[0] - 1, start, arrival)

    def _continued_times(self, numbers: list[int], arrival: float) -> list[float]:
        assert self._last is not None
        number, time = self._last
        last, end = numbers[-1], arrival
        if self._line is not None and self._period is not None:
            step = self._period * (last - number)
            fitted_step = self._line[1] + self._period * (last - self._line[0]) - time
            # Limited, so that a new fit does not make the times jump.
            slew = _SLEW * step
            if fitted_step > step + slew:
                fitted_step = step + slew
            elif fitted_step < step - slew:
                fitted_step = step - slew
            end = time + fitted_step
        return _spread_times(numbers, number, time, min(end, arrival))

    def _restart(self, number: int, arrival: float) -> None:
        self._clear()
        if not self._is_fitted:  # late again before a fit: the rate has changed
            self._period = None
        self._is_fitted = False
        self._first = number, arrival
        self._line = (number, arrival) if self._period is not None else None
        self._late_since = None

    def _clear(self) -> None:
        self._blocks.clear()
        self._block_sizes.clear()
        self._block_start = -math.inf

    def _add_arrival(self, number: int, arrival: float) -> None:
        if self._first is None:
            self._first = number, arrival
        if not self._blocks or arrival - self._block_start >= _BLOCK_SECONDS:
            if self._blocks:
                self._fit_line()
            self._blocks.append([])
            self._block_sizes.append(0)
            self._block_start = arrival
            while (
                self._blocks[0]
                and self._blocks[0][-1][1] < arrival - self.window
                and sum(self._block_sizes) - self._block_sizes[0] > 2 * _MIN_ARRIVALS
            ):
                self._blocks.popleft()
                self._block_sizes.popleft()
        _push_to_hull(self._blocks[-1], (number, arrival))
        self._block_sizes[-1] += 1
        if self._observed_seconds < 1:
            self._observed_seconds = max(self._observed_seconds, arrival - self._first[1])
        if self._period is None:
            self._estimate_spacing(number, arrival)

    def _estimate_spacing(self, number: int, arrival: float) -> None:
        assert self._first is not None
        seconds = arrival - self._first[1]
        if sum(self._block_sizes) > 2 and seconds > 0:
            self._spacing = seconds / (number - self._first[0])

    def _fit_line(self) -> None:
        hull: list[_Point] = []
        for block in self._blocks:
            for point in block:
                _push_to_hull(hull, point)
        (first, start), (last, end) = hull[0], hull[-1]
        if sum(self._block_sizes) < _MIN_ARRIVALS or end - start < _MIN_SECONDS:
            return
        # The edge above the mean number: at either end, a single arrival could turn the line.
        middle = (first + last) / 2
        i = next(i for i in range(1, len(hull)) if hull[i][0] >= middle)
        (left_number, left_arrival), (right_number, right_arrival) = hull[i - 1], hull[i]
        if right_arrival > left_arrival:
            self._period = self._spacing = (right_arrival - left_arrival) / (
                right_number - left_number
            )
            self._line = right_number, right_arrival
            self._is_fitted = True

    def __repr__(self) -> str:
        return f"{type(self).__name__}(rate={self.rate}, window={self.window})"


def _spread_times(numbers: list[int], number: int, time: float, end: float) -> list[float]:
    # Times in proportion to the frame numbers, from `time` at `number` to `end` at the last number.
    end = end if end > time else time + _MIN_STEP * (numbers[-1] - number)
    if len(numbers) == 1:  # the usual case
        return [end]
    step = (end - time) / (numbers[-1] - number)
    return [*[time + step * (frame_number - number) for frame_number in numbers[:-1]], end]


def _push_to_hull(hull: list[_Point], point: _Point) -> None:
    # Adds a point to the right of a lower convex hull, and removes the points that it covers.
    number, arrival = point
    while len(hull) > 1:
        (first_number, first_arrival), (second_number, second_arrival) = hull[-2], hull[-1]
        # Compares the slopes of both edges, without a division.
        if (second_arrival - first_arrival) * (number - second_number) < (
            arrival - second_arrival
        ) * (second_number - first_number):
            break
        hull.pop()
    hull.append(point)
