r"""How well a stream runs."""

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from torch_geometric_tactile.data.live_frame import LiveFrame
from torch_geometric_tactile.live.outage import Outage
from torch_geometric_tactile.live.source import Source

_STATES = ("closed", "open", "silent", "lost", "ended")
_NS = 1_000_000_000
_SPAN = 2 * _NS  # over which rate and jitter are measured
_KEPT = 4096  # times of frames: 2 s at 2 kHz
_LOOK = _NS // 20  # between two looks at which taxels change
_STALE = _NS


@dataclass(frozen=True, slots=True)
class Health:
    r"""The state, frame rate and error counts of a stream at one moment.

    Args:
        state (str): :obj:`"closed"`, :obj:`"open"`, :obj:`"silent"` (open, but nothing comes),
            :obj:`"lost"` (waits for its port or server to come back) or :obj:`"ended"`.
        frames (int): Frames since it was opened.
        rate (float): Frames per second over the last 2 seconds, by their numbers: lost frames do
            not lower it.
        jitter (float): Standard deviation of the time from one arrival to the next in seconds, over
            the last 2 seconds.
        lost (int): Frames that the numbers or times of the others say are missing.
        corrupt (int): Packets that failed their check.
        skipped (int): Bytes that belong to no frame.
        dropped (int): Frames that slow subscribers did not get, over all subscribers.
        repeated (int): Frames with the readings of the frame before, bit for bit, and messages that
            came again.
        reconnects (int): How often it was opened again.
        stale_taxels (int): Taxels that did not change for a second while others did, and those
            without any reading. Taxels that no touch reaches are stale as well, if their sensor has
            no noise.
        age (float): Time since the last frame in seconds; NaN before the first.
        checksum (str): What guards a frame; :obj:`"none"` if a damaged reading may pass.
        reason (str): The first reason why what came made no frame; empty if there is none.
        outages (int): Times without a frame (:attr:`Stream.outages`), with one that lasts.
        outage_seconds (float): How long they were together.
        lost_in_outages (int): Those of :obj:`lost` that are missing in outages.

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
        r"""Returns what is missing, in words.

        Examples:
            >>> Health(lost=3).losses()
            '3 lost and 0 corrupt in transmission'
            >>> Health(lost=320, outages=1, outage_seconds=3.2, lost_in_outages=320).losses()
            '1 outage, 3.2 s; 0 frames lost otherwise and 0 corrupt in transmission'
        """
        if not self.outages:
            return f"{self.lost} lost and {self.corrupt} corrupt in transmission"
        plural = "" if self.outages == 1 else "s"
        otherwise = max(0, self.lost - self.lost_in_outages)
        return (
            f"{self.outages} outage{plural}, {self.outage_seconds:.1f} s; {otherwise} frames lost "
            f"otherwise and {self.corrupt} corrupt in transmission"
        )

    def line(self) -> str:
        r"""Returns it as one quiet line: the state unless it is open, and of the rarer counts only
        those that are not zero; without dropped frames, which are usual for all but policy
        :obj:`"all"`. Before the first frame, the reason why there is none."""
        parts = [] if self.state == "open" else [self.state]
        if self.reason and not self.frames:
            return ", ".join([*parts, f"no frame: {self.reason}"])  # as one part
        parts += [f"{self.rate:.1f} Hz", f"jitter {self.jitter * 1e3:.1f} ms"]
        parts += [f"lost {self.lost}", f"corrupt {self.corrupt}"]
        rare = {
            "outages": self.outages,
            "reconnects": self.reconnects,
            "stale": self.stale_taxels,
        }
        parts += [f"{name} {count}" for name, count in rare.items() if count]
        if not math.isnan(self.age):
            parts.append(
                f"age {self.age:.1f} s" if self.age >= 1 else f"age {self.age * 1e3:.0f} ms"
            )
        return "  ".join(parts)


class HealthMeter:
    r"""Measures the frame rate, losses and stale taxels of a stream. One thread reports frames, any
    thread may read the result.

    Attributes:
        dropped (int): Frames that slow subscribers did not get.
        frames (int): Frames that were reported.
        reconnects (int): How often the source was opened again.

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
        self._repeated = 0
        self._received = np.zeros(_KEPT, dtype=np.int64)
        self._numbers = np.zeros(_KEPT, dtype=np.int64)
        self._last = b""
        self._looked = 0
        self._stale = 0
        self._seen: np.ndarray | None = None
        self._changed = np.zeros(0, dtype=np.int64)

    def observe(self, frame: LiveFrame) -> None:
        r"""Takes note of a frame as the source gave it.

        Args:
            frame (LiveFrame): The frame.
        """
        self._received[self.frames % _KEPT] = frame.received
        self._numbers[self.frames % _KEPT] = frame.sequence
        self.frames += 1
        readings = frame.tactile.tobytes()
        self._repeated += readings == self._last
        self._last = readings
        if frame.received - self._looked >= _LOOK or self._seen is None:
            self._look(frame)

    def _look(self, frame: LiveFrame) -> None:
        now, tactile = frame.received, frame.tactile
        self._looked = now
        if self._seen is None or self._seen.shape != tactile.shape:
            self._changed = np.full(len(tactile), now, dtype=np.int64)
            self._seen = tactile.copy()
        missing = np.isnan(tactile).all(axis=1)
        same = (tactile == self._seen) | (np.isnan(tactile) & np.isnan(self._seen))
        self._changed[~same.all(axis=1)] = now
        self._seen = tactile.copy()
        still = now - self._changed > _STALE
        self._stale = int((missing | still).sum() if not still.all() else missing.sum())

    def snapshot(
        self,
        state: str,
        source: Source,
        now: int | None = None,
        outages: Sequence[Outage] = (),
    ) -> Health:
        r"""Returns the health of this moment.

        Args:
            state (str): The state of the stream.
            source (Source): Its source, which counts what it lost.
            now (int, optional): The time on the monotonic clock in nanoseconds; the present if left
                out.
            outages (sequence of Outage): Its outages.
        """
        now = time.perf_counter_ns() if now is None else now
        frames, counts = self.frames, source.counts
        received = self._received[: min(frames, _KEPT)]
        order = np.argsort(received, kind="stable")
        received, numbers = received[order], self._numbers[order]
        last = int(received[-1]) if frames else 0
        recent = received > now - _SPAN
        gaps = np.diff(received[recent]) / _NS
        return Health(
            state=state,
            frames=frames,
            rate=_rate(received[recent], numbers[recent], now),
            jitter=float(gaps.std()) if len(gaps) else 0.0,
            lost=counts.lost,
            corrupt=counts.corrupt,
            skipped=counts.skipped,
            dropped=self.dropped,
            repeated=self._repeated + source.repeats,
            reconnects=self.reconnects,
            stale_taxels=self._stale,
            age=max(0.0, (now - last) / _NS) if frames else math.nan,
            checksum=source.checksum,
            reason=counts.reason,
            outages=len(outages),
            outage_seconds=float(sum(outage.seconds for outage in outages)),
            lost_in_outages=sum(outage.lost for outage in outages),
        )


def _rate(received: np.ndarray, numbers: np.ndarray, now: int) -> float:
    # From the last frame of the first read to that of the last one: what is read together came
    # since the read before. A stream that stopped slows down, from twice its usual distance of
    # reads on.
    arrivals = np.unique(received)
    if len(arrivals) < 2:
        return 0.0
    first = int(np.searchsorted(received, arrivals[0], side="right")) - 1
    seconds = float(arrivals[-1] - arrivals[0]) / _NS
    late = max(0.0, (now - int(arrivals[-1])) / _NS - 2 * seconds / (len(arrivals) - 1))
    count = max(int(numbers[-1] - numbers[first]), 0)
    return count / (seconds + late)
