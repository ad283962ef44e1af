r"""State, frame rate and losses of a stream."""

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from torch_geometric_tactile.data.live_frame import LiveFrame
from torch_geometric_tactile.live._outage import Outage
from torch_geometric_tactile.live.source import Source

_STATES = ("closed", "open", "silent", "lost", "ended")
_NS = 1_000_000_000
_RATE_NS = 2 * _NS  # time over which rate and jitter are measured
_MAX_ARRIVALS = 4096  # 2 s at 2 kHz
_CHECK_NS = _NS // 20  # time between two checks for stale taxels
_STALE_NS = _NS


@dataclass(frozen=True, slots=True)
class Health:
    r"""The state, frame rate and error counts of a stream at one moment.

    Args:
        state (str): :obj:`"closed"`, :obj:`"open"`, :obj:`"silent"` (open, but no frames arrive),
            :obj:`"lost"` (waiting for the port or server to come back) or :obj:`"ended"`.
        frames (int): Number of frames since the stream was opened.
        rate (float): Frames per second over the last 2 seconds, by frame numbers, so lost frames do
            not lower it.
        jitter (float): Standard deviation of the time between arrivals in seconds, over the last
            2 seconds.
        lost (int): Number of missing frames, from the numbers or times of the frames around them.
        corrupt (int): Number of packets with a failed check.
        skipped (int): Number of bytes that belong to no frame.
        dropped (int): Number of frames that slow subscribers missed, over all subscribers.
        repeated (int): Number of frames whose readings all equal those of the previous frame, plus
            repeated messages.
        reconnects (int): Number of times that the source was opened again.
        stale_taxels (int): Number of taxels that did not change for a second while other taxels
            did, plus taxels without a reading. On a sensor without noise, this includes untouched
            taxels.
        age (float): Time since the last frame in seconds; NaN before the first frame.
        checksum (str): Name of the check of each frame; :obj:`"none"` if damaged readings are not
            detected.
        reason (str): The first reason why received data gave no frame; empty if there is none.
        outages (int): Number of outages (:attr:`Stream.outages`), including a current outage.
        outage_seconds (float): Total duration of the outages in seconds.
        lost_in_outages (int): Number of the :obj:`lost` frames that are missing in outages.

    Examples:
        >>> Health("open", frames=500, rate=498.7, jitter=4e-4, corrupt=2, age=0.001).line()
        '498.7 Hz  jitter 0.4 ms  lost 0  corrupt 2  age 1 ms'
    """

    state: str = "closed"
    frames: int = 0
    rate: float = 0.0
    jitter: float = 0.0
    lost: int = 0
    corrupt: int = 0
    skipped: int = 0
    dropped: int = 0
    repeated: int = 0
    reconnects: int = 0
    stale_taxels: int = 0
    age: float = math.nan
    checksum: str = "none"
    reason: str = ""
    outages: int = 0
    outage_seconds: float = 0.0
    lost_in_outages: int = 0

    def losses(self) -> str:
        r"""Returns a sentence with the numbers of outages and of lost and corrupt frames.

        Examples:
            >>> Health(lost=3).losses()
            '3 lost and 0 corrupt in transmission'
            >>> Health(lost=320, outages=1, outage_seconds=3.2, lost_in_outages=320).losses()
            '1 outage, 3.2 s; 0 frames lost otherwise and 0 corrupt in transmission'
        """
        if not self.outages:
            return f"{self.lost} lost and {self.corrupt} corrupt in transmission"
        plural = "" if self.outages == 1 else "s"
        num_isolated_losses = max(0, self.lost - self.lost_in_outages)
        return (
            f"{self.outages} outage{plural}, {self.outage_seconds:.1f} s; {num_isolated_losses} "
            f"frames lost otherwise and {self.corrupt} corrupt in transmission"
        )

    def line(self) -> str:
        r"""Returns the health as one line: the state unless it is open, the rate and the counts.
        Rare counts are left out if they are zero. Dropped frames are left out, since they are
        normal with most policies. Before the first frame, the line gives the reason why there is no
        frame."""
        parts = [] if self.state == "open" else [self.state]
        if self.reason and not self.frames:
            return ", ".join([*parts, f"no frame: {self.reason}"])
        parts += [f"{self.rate:.1f} Hz", f"jitter {self.jitter * 1e3:.1f} ms"]
        parts += [f"lost {self.lost}", f"corrupt {self.corrupt}"]
        rare_counts = {
            "outages": self.outages,
            "reconnects": self.reconnects,
            "stale": self.stale_taxels,
        }
        parts += [f"{name} {count}" for name, count in rare_counts.items() if count]
        if not math.isnan(self.age):
            parts.append(
                f"age {self.age:.1f} s" if self.age >= 1 else f"age {self.age * 1e3:.0f} ms"
            )
        return "  ".join(parts)


class HealthMeter:
    r"""Measures the frame rate, losses and stale taxels of a stream. One thread calls
    :meth:`observe`; any thread may call :meth:`snapshot`.

    Attributes:
        dropped (int): Number of frames that slow subscribers missed.
        frames (int): Number of observed frames.
        reconnects (int): Number of times that the source was opened again.

    Examples:
        >>> from torch_geometric_tactile.data import Recording
        >>> from torch_geometric_tactile.live import ReplaySource
        >>> recording = Recording(time=np.arange(3) / 100, tactile=np.zeros((3, 4, 3)))
        >>> meter, source = HealthMeter(), ReplaySource(recording, speed=0)
        >>> with source:
        ...     for frame in source.read(timeout=1.0):
        ...         meter.observe(frame)
        >>> meter.snapshot("open", source).frames
        3
    """

    def __init__(self) -> None:
        self.dropped = 0
        self.reconnects = 0
        self.frames = 0
        self._num_repeated = 0
        self._arrivals = np.zeros(_MAX_ARRIVALS, dtype=np.int64)
        self._numbers = np.zeros(_MAX_ARRIVALS, dtype=np.int64)
        self._last_readings = b""
        self._last_check = 0
        self._num_stale = 0
        self._checked_readings: np.ndarray | None = None
        self._last_changes = np.zeros(0, dtype=np.int64)

    def observe(self, frame: LiveFrame) -> None:
        r"""Adds a frame of the source to the measurements.

        Args:
            frame (LiveFrame): The frame.
        """
        self._arrivals[self.frames % _MAX_ARRIVALS] = frame.received
        self._numbers[self.frames % _MAX_ARRIVALS] = frame.sequence
        self.frames += 1
        readings = frame.tactile.tobytes()
        self._num_repeated += readings == self._last_readings
        self._last_readings = readings
        if frame.received - self._last_check >= _CHECK_NS or self._checked_readings is None:
            self._count_stale_taxels(frame)

    def _count_stale_taxels(self, frame: LiveFrame) -> None:
        now, tactile = frame.received, frame.tactile
        self._last_check = now
        if self._checked_readings is None or self._checked_readings.shape != tactile.shape:
            self._last_changes = np.full(len(tactile), now, dtype=np.int64)
            self._checked_readings = tactile.copy()
        is_missing = np.isnan(tactile).all(axis=1)
        is_unchanged = (tactile == self._checked_readings) | (
            np.isnan(tactile) & np.isnan(self._checked_readings)
        )
        self._last_changes[~is_unchanged.all(axis=1)] = now
        self._checked_readings = tactile.copy()
        # If no taxel changes, the source has stopped, and the taxels are not stale.
        is_still = now - self._last_changes > _STALE_NS
        self._num_stale = int(
            (is_missing | is_still).sum() if not is_still.all() else is_missing.sum()
        )

    def snapshot(
        self,
        state: str,
        source: Source,
        now: int | None = None,
        outages: Sequence[Outage] = (),
    ) -> Health:
        r"""Returns the health at one moment.

        Args:
            state (str): The state of the stream.
            source (Source): The source of the stream, which counts losses.
            now (int, optional): The time on the monotonic clock in nanoseconds. By default the
                present.
            outages (sequence of Outage): The outages of the stream.
        """
        now = time.perf_counter_ns() if now is None else now
        frames, counts = self.frames, source.counts
        received = self._arrivals[: min(frames, _MAX_ARRIVALS)]
        order = np.argsort(received, kind="stable")
        received, numbers = received[order], self._numbers[order]
        last = int(received[-1]) if frames else 0
        is_recent = received > now - _RATE_NS
        gaps = np.diff(received[is_recent]) / _NS
        return Health(
            state=state,
            frames=frames,
            rate=_frame_rate(received[is_recent], numbers[is_recent], now),
            jitter=float(gaps.std()) if len(gaps) else 0.0,
            lost=counts.lost,
            corrupt=counts.corrupt,
            skipped=counts.skipped,
            dropped=self.dropped,
            repeated=self._num_repeated + source.repeats,
            reconnects=self.reconnects,
            stale_taxels=self._num_stale,
            age=max(0.0, (now - last) / _NS) if frames else math.nan,
            checksum=source.checksum,
            reason=counts.reason,
            outages=len(outages),
            outage_seconds=float(sum(outage.seconds for outage in outages)),
            lost_in_outages=sum(outage.lost for outage in outages),
        )


def _frame_rate(received: np.ndarray, numbers: np.ndarray, now: int) -> float:
    # From the last frame of the first read to the last frame of the last read, since frames that
    # are read together arrived after the previous read. Once the time since the last read exceeds
    # twice the usual time, the rate decreases, and goes to zero when a stream stops.
    arrivals = np.unique(received)
    if len(arrivals) < 2:
        return 0.0
    first = int(np.searchsorted(received, arrivals[0], side="right")) - 1
    seconds = float(arrivals[-1] - arrivals[0]) / _NS
    late_seconds = max(0.0, (now - int(arrivals[-1])) / _NS - 2 * seconds / (len(arrivals) - 1))
    num_frames = max(int(numbers[-1] - numbers[first]), 0)
    return num_frames / (seconds + late_seconds)
