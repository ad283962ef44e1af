r"""How frames were made: their rate, gaps, thinning, unit and order of columns."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from typing import Any, NamedTuple, Self

import numpy as np

#: The largest gap in a continuous part, in arrivals, unless it is given.
GAP_ARRIVALS = 5
#: The relative deviation of a rate that is always accepted.
RATE_TOLERANCE = 0.05
_SAME_READ = 1e-4  # seconds: frames that are closer were read together
_MAX_FRAMES_A_READ = 64
_BURST_SHARE = 0.2  # of long distances, from which on these are arrivals and not gaps
_ROUNDING = 1e-3  # of a gap or of a tick, by which clocks in float64 and nanoseconds differ
_MIN_REGULAR = 0.9  # of distances that are whole numbers of periods, where frames were lost
_MAX_STRIDE = 10**7


class Rate(NamedTuple):
    r"""The rate of frames, as :func:`measure_rate` measures it.

    Args:
        rate (float): Frames per second in the parts without gaps; NaN with fewer than two frames.
        arrival (float): Usual seconds from one arrival to the next; frames that were read together
            are one arrival.
    """

    rate: float
    arrival: float

    @property
    def max_gap(self) -> float:
        r"""The largest distance of two frames, in seconds, that is no gap."""
        return GAP_ARRIVALS * self.arrival


def measure_rate(time: np.ndarray, max_gap: float | None = None) -> Rate:
    r"""Measures the frames per second of a recording. Gaps count for nothing, frames that were
    read together count as one arrival, and lost frames do not lower the rate of a regular clock.

    Args:
        time (numpy.ndarray): Increasing times in seconds :math:`(T,)`.
        max_gap (float, optional): The largest distance of two frames, in seconds, that is no gap;
            five arrivals if left out.

    Examples:
        >>> time = np.arange(100) / 50.0
        >>> time[50:] += 7.0  # the cable was out
        >>> round(measure_rate(time).rate, 6)
        50.0
    """
    step = np.diff(time)
    if not len(step):
        return Rate(math.nan, math.nan)
    arrival = _arrival(step)
    limit = GAP_ARRIVALS * arrival if max_gap is None else max_gap
    within = step <= limit * (1 + _ROUNDING)
    if not within.any():  # a recording of gaps only
        return Rate(1 / arrival, arrival)
    duration = float(step[within].sum())
    periods = step[within] / arrival
    whole = np.rint(periods)
    is_regular = (np.abs(periods - whole) <= 0.25) & (whole >= 1)
    if is_regular.mean() >= _MIN_REGULAR:  # what is missing between was lost
        return Rate(float(whole.sum()) / duration, arrival)
    # Frames that came with the first arrival of a part took no time.
    count = float(within.sum())
    is_burst = arrival > 1.5 * duration / count
    if is_burst:
        starts = np.flatnonzero(np.concatenate([[True], ~within]))
        together = step < 0.1 * arrival
        for start in starts[starts < len(step)]:
            following = np.flatnonzero(~together[start:])
            count -= int(following[0]) if len(following) else len(step) - start
    return Rate(max(count, 1.0) / duration, arrival)


def _arrival(step: np.ndarray) -> float:
    # The usual distance of two arrivals: a median, since gaps are few, of the distances between
    # reads, since frames of one read are almost at one time.
    between = step[step > _SAME_READ]
    if len(between) * _MAX_FRAMES_A_READ < len(step):  # faster than any host reads: no bursts
        between = step
    while True:
        arrival = float(np.sort(between)[(len(between) - 1) // 2])  # of two, the one without a gap
        longer = between[between > GAP_ARRIVALS * arrival]
        if len(longer) < 3 or len(longer) < _BURST_SHARE * len(between):
            return arrival
        between = longer


def part_numbers(time: np.ndarray, max_gap: float) -> np.ndarray:
    r"""Returns the number of the continuous part of each frame, from zero on.

    Args:
        time (numpy.ndarray): Increasing times in seconds :math:`(T,)`.
        max_gap (float): The largest distance of two frames, in seconds, that is no gap; infinite
            if there are none.

    Returns:
        numpy.ndarray: Integers :math:`(T,)`.

    Examples:
        >>> part_numbers(np.array([0.0, 0.1, 5.0, 5.1]), max_gap=0.5)
        array([0, 0, 1, 1])
    """
    first = np.zeros(min(len(time), 1), np.int64)
    return np.concatenate([first, np.cumsum(gaps_in(time, max_gap))])


def gaps_in(time: np.ndarray, max_gap: float) -> np.ndarray:
    r"""Returns whether there is a gap between each frame and the next :math:`(T - 1,)`."""
    return np.asarray(np.diff(time) > max_gap * (1 + _ROUNDING))


def gaps_of(time: np.ndarray, max_gap: float | None = None) -> np.ndarray:
    r"""Returns the last frame before each gap.

    Args:
        time (numpy.ndarray): Increasing times in seconds :math:`(T,)`.
        max_gap (float, optional): As of :func:`measure_rate`.

    Returns:
        numpy.ndarray: Integers :math:`(G,)`.

    Examples:
        >>> gaps_of(np.array([0.0, 0.1, 0.2, 5.0, 5.1]))
        array([2])
    """
    limit = measure_rate(time).max_gap if max_gap is None else max_gap
    return np.flatnonzero(gaps_in(time, limit))


@dataclass(frozen=True)
class FrameInfo:
    r"""How frames were made: what a recording, a data set, a predictor and a live stream must
    agree on, as MNE's :class:`mne.Info`. A value that is not known is :obj:`None`, and is not
    compared.

    Args:
        rate (float, optional): Frames per second of the recordings, before :obj:`stride` and
            :obj:`selected_rate`.
        tolerance (float): Relative deviation from :obj:`rate` that is accepted: 0.05, or the spread
            over the trials if that is larger.
        max_gap (float, optional): The largest distance of two frames of a recording, in seconds,
            that is no gap; infinite for data of events.
        selected_rate (float, optional): Frames per second that were selected: those next to the
            ticks of a clock that starts with each recording.
        stride (int): Only every :obj:`stride`-th of these frames was used.
        unit (str, optional): Unit of the readings, such as :obj:`"count"`.
        columns (Mapping of str to sequence of str): Names of the columns of :obj:`"tactile"`,
            taxel by taxel each with its channels, and of :obj:`"joint"`.
        rest (float, optional): How long each recording is at rest before anything is touched, in
            seconds, where a transform measures it.

    Raises:
        ValueError: If a number is not positive, or a value is of another type.

    Examples:
        >>> info = FrameInfo(rate=100.0, stride=2, unit="count")
        >>> info.frame_rate
        50.0
        >>> info.require(FrameInfo(rate=100.4, unit="count"), "grasp.h5")
    """

    rate: float | None = None
    tolerance: float = RATE_TOLERANCE
    max_gap: float | None = None
    selected_rate: float | None = None
    stride: int = 1
    unit: str | None = None
    columns: Mapping[str, Sequence[str]] = field(default_factory=dict)
    rest: float | None = None

    def __post_init__(self) -> None:
        for name in ("rate", "tolerance", "max_gap", "selected_rate", "rest"):
            value = getattr(self, name)
            is_number = isinstance(value, int | float) and not isinstance(value, bool)
            if value is None and name != "tolerance":
                continue
            if not is_number or not value > 0 or (math.isinf(value) and name != "max_gap"):
                raise ValueError(f"'{name}' must be a positive number (got {str(value)[:80]})")
        if type(self.stride) is not int or not 1 <= self.stride <= _MAX_STRIDE:
            raise ValueError(f"'stride' must be at least 1 (got {str(self.stride)[:80]})")
        if self.unit is not None and not isinstance(self.unit, str):
            raise ValueError(f"'unit' must be a text or None (got {str(self.unit)[:80]})")
        if not isinstance(self.columns, Mapping) or not all(
            key in ("tactile", "joint")
            and isinstance(names, list | tuple)
            and all(isinstance(name, str) for name in names)
            for key, names in self.columns.items()
        ):
            raise ValueError(
                f"'columns' must be names of 'tactile' and 'joint' (got {str(self.columns)[:80]})"
            )

    @property
    def frame_rate(self) -> float | None:
        r"""Frames per second that are used, after :obj:`selected_rate` and :obj:`stride`."""
        rate = self.rate if self.selected_rate is None else self.selected_rate
        return None if rate is None else rate / self.stride

    def changed(self, **changes: Any) -> Self:
        r"""Returns a copy with other values.

        Args:
            **changes: The values by name.
        """
        return replace(self, **changes)

    def rate_differs(self, rate: float | None, tolerance: float = 0.0) -> bool:
        r"""Returns whether frames at another rate cannot be used: it is not :obj:`rate`, or it is
        below :obj:`selected_rate`, at which frames of any faster recording are selected.

        Args:
            rate (float, optional): Frames per second; :obj:`None` if it is not known.
            tolerance (float): Relative deviation that is accepted, if it is above the own one.
        """
        if rate is None or self.rate is None or not math.isfinite(rate):
            return False
        tolerance = max(tolerance, self.tolerance)
        if self.selected_rate is not None:
            return rate < (1 - tolerance) * self.selected_rate
        return not abs(rate - self.rate) <= tolerance * self.rate

    def require(self, other: Self, where: str, *, with_rate: bool = True) -> None:
        r"""Checks that other frames were made as these were. Their columns may be in another order,
        which can be mended (:func:`in_column_order`).

        Args:
            other (FrameInfo): How the other frames were made.
            where (str): What to call them in a message, such as the name of a file.
            with_rate (bool): Whether the rate matters, as it does for windows.

        Raises:
            ValueError: If they were not; the message has both values, and what to do.
        """
        if None not in (self.unit, other.unit) and self.unit != other.unit:
            raise ValueError(
                f"{where} must have readings in {self.unit}, as the model was trained on (got "
                f"{other.unit}): convert them, or train on recordings in {other.unit}"
            )
        if with_rate and self.rate_differs(other.rate, other.tolerance):
            least = "" if self.selected_rate is None else "at least "
            rate = self.rate if self.selected_rate is None else self.selected_rate
            raise ValueError(
                f"{where} must have {least}{rate:.4g} frames per second, as the model was trained "
                f"on (got {other.rate:.4g}): resample it, with --resample, resample=True or "
                f"Recording.resample({rate:.4g})"
            )

    def selected_frames(self, time: np.ndarray | None, count: int) -> np.ndarray:
        r"""Returns the frames of a recording that are used, after :obj:`selected_rate` and
        :obj:`stride`.

        Args:
            time (numpy.ndarray, optional): Times of the frames in seconds :math:`(T,)`.
            count (int): Number of frames :math:`T`.

        Returns:
            numpy.ndarray: Their indices, increasing :math:`(K,)`.

        Examples:
            >>> FrameInfo(stride=3).selected_frames(None, 8)
            array([0, 3, 6])
        """
        index = np.arange(count)
        if self.selected_rate is not None and time is not None and count:
            tick = self.ticks(time - time[0])
            index = index[np.concatenate([[True], np.diff(tick) > 0])]
        return index[:: self.stride]

    def ticks(self, elapsed: Any) -> Any:
        r"""Returns the number of the last tick of a clock of :obj:`selected_rate` that a frame is
        not earlier than, half a frame apart. The first frame of each tick is the one selected: with
        a regular clock the nearest one, and known as soon as it comes.

        Args:
            elapsed (numpy.ndarray or float): Seconds since the first frame.
        """
        rate = self.selected_rate or 0.0
        half = 0.5 if self.rate is None else min(0.5, 0.5 * rate / self.rate)
        return np.floor(elapsed * rate + half + _ROUNDING)

    def part_numbers(self, time: np.ndarray | None, count: int) -> np.ndarray:
        r"""Returns the number of the continuous part of each frame of a recording.

        Args:
            time (numpy.ndarray, optional): Times of the frames in seconds :math:`(T,)`.
            count (int): Number of frames :math:`T`.

        Returns:
            numpy.ndarray: Integers :math:`(T,)`.
        """
        if time is None or self.max_gap is None:
            return np.zeros(count, np.int64)
        return part_numbers(time, self.max_gap)

    @classmethod
    def joined(cls, infos: Sequence[Self], names: Sequence[str]) -> Self:
        r"""Returns how the frames of several recordings were made.

        Args:
            infos (sequence of FrameInfo): Those of the recordings.
            names (sequence of str): What to call each in a message.

        Raises:
            ValueError: If two have other rates or units; the message names both.
        """
        first = infos[0]
        rates = {i: info.rate for i, info in enumerate(infos) if info.rate is not None}
        rate, tolerance = joined_rate(rates, names)
        for info, name in zip(infos, names, strict=True):
            if info.unit != first.unit:
                raise ValueError(
                    f"all recordings must have one unit (got {first.unit!r} in {names[0]} and "
                    f"{info.unit!r} in {name})"
                )
        gaps = [info.max_gap for info in infos if info.max_gap is not None]
        max_gap = float(np.median(gaps)) if gaps else None
        return first.changed(rate=rate, tolerance=tolerance, max_gap=max_gap)

    def to_dict(self) -> dict[str, Any]:
        r"""Returns the arguments as JSON values; an infinite :obj:`max_gap` as :obj:`"inf"`."""
        content = asdict(self)
        content["columns"] = {key: list(names) for key, names in self.columns.items()}
        if self.max_gap is not None and math.isinf(self.max_gap):
            content["max_gap"] = "inf"
        return content

    @classmethod
    def from_dict(cls, content: Any) -> Self:
        r"""Builds it from what :meth:`to_dict` returns.

        Args:
            content (Mapping): The arguments.
        """
        names = {each.name for each in fields(cls)}
        if not isinstance(content, Mapping) or not names.issuperset(content):
            raise ValueError(f"'frames' must be some of {sorted(names)} (got {str(content)[:80]})")
        arguments = dict(content)
        if arguments.get("max_gap") == "inf":
            arguments["max_gap"] = math.inf
        return cls(**arguments)


#: The ratio of the largest and the smallest rate of one data set, above which it has two rates.
MAX_RATE_RATIO = 1.25


def joined_rate(rates: Mapping[int, float], names: Sequence[str]) -> tuple[float | None, float]:
    r"""Returns the median of some rates and the relative tolerance, 0.05 or their spread if that is
    larger.

    Args:
        rates (Mapping of int to float): Frames per second, by the place of the name.
        names (sequence of str): What to call the recordings in a message.

    Raises:
        ValueError: If the rates are further apart than the spread of one device; the message names
            two recordings.
    """
    if not rates:
        return None, RATE_TOLERANCE
    slow, fast = min(rates, key=rates.__getitem__), max(rates, key=rates.__getitem__)
    if rates[fast] > MAX_RATE_RATIO * rates[slow]:
        raise ValueError(
            f"windows must be cut from recordings of one rate (got {rates[slow]:.4g} frames per "
            f"second in {names[slow]} and {rates[fast]:.4g} in {names[fast]}): resample them with "
            f"RecordingFrames(resample={rates[slow]:.4g}) or --resample {rates[slow]:.4g}"
        )
    rate = float(np.median(list(rates.values())))
    spread = max(abs(value - rate) for value in rates.values()) / rate
    return rate, max(RATE_TOLERANCE, 1.01 * spread)
