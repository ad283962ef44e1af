r"""Readings of a sensor at rest, and its drift from them."""

import logging
import math
import threading
from collections import deque
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from torch_geometric_tactile.data._rest_noise import (
    NUM_BLOCKS,
    distance_ratio,
    mean_reading,
    movement_and_noise,
    trusted_noise,
)
from torch_geometric_tactile.data.live_frame import LiveFrame

_MAX_FRAMES = 20_000  # limit of the memory of a long or fast rest
_logger = logging.getLogger(__name__)

_Event = tuple[float, str, str]  # time on the host's monotonic clock, kind, text


class RestFrames(NamedTuple):
    r"""Frames that were collected while nothing touched the sensor.

    Args:
        tactile (numpy.ndarray): Readings :math:`(T, N, C)`.
        time (numpy.ndarray): Times in seconds :math:`(T,)`.
        joint (numpy.ndarray, optional): Joint angles :math:`(T, J)`.

    Examples:
        >>> frames = RestFrames(np.zeros((30, 4, 3)), np.arange(30) / 30, joint=None)
        >>> frames.tactile.mean(axis=0).shape  # the reading at rest of each taxel and channel
        (4, 3)
    """

    tactile: np.ndarray
    time: np.ndarray
    joint: np.ndarray | None


class Drift(NamedTuple):
    r"""The distance of a sensor's current readings from its readings at rest.

    Args:
        amount (float): The largest distance, in units of the noise at rest; NaN while readings
            move or there are too few frames.
        taxels (numpy.ndarray): Indices of the taxels with a distance above :obj:`max_drift`.

    Examples:
        >>> drift = Drift(amount=7.5, taxels=np.array([3]))
        >>> drift.taxels.tolist()
        [3]
    """

    amount: float
    taxels: np.ndarray


class Rest:
    r"""Collects still frames while nothing touches the sensor, for models that need the readings at
    rest in each session.

    The frames are divided into five parts. A taxel is moving if the means of its parts differ by
    more than :obj:`max_movement` times its noise within the parts. In this case the frames are
    rejected, an event gives the reason, and the collection starts again. Oscillations that are
    faster than the duration of a part count as noise.

    Args:
        seconds (float): Duration of the collection.
        min_frames (int): Minimum number of frames.
        max_movement (float): Largest difference between parts, in units of the noise.
        max_drift (float): Distance from the rest, in units of its noise, above which :meth:`drift`
            warns.
        on_event (callable, optional): Called with the time, kind and text of each event.

    Attributes:
        events (list): The events: time on the host's monotonic clock in seconds, kind
            (:obj:`"rest"`, :obj:`"moved"`, :obj:`"retare"` or :obj:`"drift"`) and text.
        number (int): Number of completed collections.
        listeners (list of callable): Called with each event, before :obj:`on_event`.

    Raises:
        ValueError: If a number is not positive. :meth:`add` raises it if the shape of a frame
            differs from the previous frames.

    Examples:
        >>> rest, noise = Rest(seconds=0.5, min_frames=30), np.random.default_rng(0)
        >>> for i in range(60):
        ...     tactile = noise.normal(100.0, 1.0, (4, 3)).astype(np.float32)
        ...     is_ready = rest.add(LiveFrame(i, i / 60, int(i / 60 * 1e9), None, tactile))
        >>> rest.ready, rest.value.shape
        (True, (4, 3))
    """

    def __init__(
        self,
        seconds: float = 1.0,
        min_frames: int = 30,
        max_movement: float = 5.0,
        *,
        max_drift: float = 5.0,
        on_event: Callable[[float, str, str], None] | None = None,
    ) -> None:
        numbers = {
            "seconds": seconds,
            "min_frames": min_frames,
            "max_movement": max_movement,
            "max_drift": max_drift,
        }
        for name, number in numbers.items():
            if not 0 < number < math.inf:
                raise ValueError(f"'{name}' must be positive and finite (got {number})")
        self.seconds = seconds
        self.min_frames = max(int(min_frames), 2 * NUM_BLOCKS)
        self.max_movement = max_movement
        self.max_drift = max_drift
        self.on_event = on_event
        self.listeners: list[Callable[[float, str, str], None]] = []
        self.events: list[_Event] = []
        self.number = 0
        self.reason = ""
        self._lock = threading.RLock()
        self._pending: list[LiveFrame] = []
        self._running_mean = _RunningMean(self._pending)
        self._frames: RestFrames | None = None
        self._value: np.ndarray | None = None
        self._noise: np.ndarray | None = None
        self._recent: deque[np.ndarray] = deque(maxlen=self.min_frames)
        self._has_warned = False

    @property
    def ready(self) -> bool:
        r"""Whether a rest has been measured."""
        return self._frames is not None

    @property
    def frames(self) -> RestFrames | None:
        r"""The frames of the rest; :obj:`None` while they are collected."""
        return self._frames

    @property
    def value(self) -> np.ndarray:
        r"""The mean reading at rest :math:`(N, C)` in double precision; NaN for taxels without a
        reading in any frame.

        Raises:
            RuntimeError: If there is no rest yet.
        """
        return self._require(self._value)

    @property
    def noise(self) -> np.ndarray:
        r"""The standard deviation at rest :math:`(N, C)`, without slow movement.

        Raises:
            RuntimeError: If there is no rest yet.
        """
        return self._require(self._noise)

    @property
    def shape(self) -> tuple[int, ...] | None:
        r"""The shape of a frame :math:`(N, C)`; :obj:`None` before the first frame."""
        with self._lock:
            if self._frames is not None:
                return self._frames.tactile.shape[1:]
            return self._pending[-1].tactile.shape if self._pending else None

    def _require(self, value: np.ndarray | None) -> np.ndarray:
        if value is None:
            raise RuntimeError(f"the rest must be measured first: {self.status()}")
        return value

    def status(self) -> str:
        r"""Returns a sentence about the progress of the collection."""
        if self.ready:
            return "the rest is measured"
        reason = f" ({self.reason})" if self.reason else ""
        return f"keep the sensor untouched: {len(self._pending)} still frames so far{reason}"

    def need(self, min_frames: int) -> None:
        r"""Increases the minimum number of frames, for example to fill a window.

        Args:
            min_frames (int): The required number of frames.
        """
        self.min_frames = max(self.min_frames, min_frames)

    def add(self, frame: LiveFrame) -> bool:
        r"""Adds the next frame unless the rest is ready, and returns whether it is ready. The same
        frame is not added twice.

        Args:
            frame (LiveFrame): The frame.
        """
        with self._lock:
            if self._frames is not None:
                return True
            pending = self._pending
            if pending:
                if frame.received == pending[-1].received and frame.time == pending[-1].time:
                    return False
                if frame.tactile.shape != pending[-1].tactile.shape:
                    raise ValueError(
                        f"a frame must have shape {pending[-1].tactile.shape}, as the previous "
                        f"frames (got {frame.tactile.shape})"
                    )
            pending.append(frame)
            # Times are rounded: frames over one second may be a little closer.
            is_long_enough = frame.time - pending[0].time >= self.seconds * (1 - 1e-6)
            if len(pending) < self.min_frames or not (
                is_long_enough or len(pending) >= _MAX_FRAMES
            ):
                return False
            return self._evaluate(frame.time)

    def relative(self, frame: LiveFrame) -> np.ndarray:
        r"""Adds the next frame unless the rest is ready. Returns its readings relative to the rest
        :math:`(N, C)`, float32. While the rest is being collected, the readings are relative to the
        mean of the frames so far.

        Args:
            frame (LiveFrame): The frame.

        Raises:
            RuntimeError: If the frames so far, including this frame, are rejected.
        """
        with self._lock:
            self.add(frame)
            value = self._value
            if value is None and self._pending:
                if self._running_mean.frames is not self._pending:
                    self._running_mean = _RunningMean(self._pending)
                value = self._running_mean.mean()
            out: np.ndarray = (frame.tactile - self._require(value)).astype(np.float32)
            return out

    def _evaluate(self, time: float) -> bool:
        pending, self._pending = self._pending, []
        tactile = np.stack([frame.tactile for frame in pending]).astype(np.float32)
        movement, noise = movement_and_noise(tactile)
        largest = float(np.nanmax(movement, initial=0.0))
        if largest > self.max_movement:
            moving_taxels = np.flatnonzero((movement > self.max_movement).any(axis=1))
            self.reason = (
                f"{len(moving_taxels)} of {len(movement)} taxels move, taxel "
                f"{_worst_taxel(movement)} by {largest:.3g} times its noise (at most "
                f"{self.max_movement:g})"
            )
            self._emit(time, "moved", f"no rest: {self.reason}")
            return False
        joint = None
        if all(frame.joint is not None for frame in pending):
            joint = np.stack([np.asarray(frame.joint, np.float32) for frame in pending])
        # `stack` copies, which is necessary: a source may reuse its arrays.
        self._frames = RestFrames(tactile, np.array([frame.time for frame in pending]), joint)
        self._value, self._noise = mean_reading(tactile.astype(np.float64)), noise
        self._recent.clear()
        self._has_warned = False
        self.reason = ""
        self.number += 1
        num_dead = int(np.isnan(self._value).any(axis=1).sum())
        dead_text = f", {num_dead} taxels without a reading" if num_dead else ""
        self._emit(time, "rest", f"rest of {len(pending)} frames{dead_text}")
        return True

    def retare(self) -> None:
        r"""Discards the rest, and collects a new one from the next frame on."""
        with self._lock:
            last_time = self._frames.time[-1] if self._frames is not None else None
            last_time = self._pending[-1].time if self._pending else last_time
            self._frames = self._value = self._noise = None
            self._pending = []
            self._recent.clear()
            self._emit(
                math.nan if last_time is None else float(last_time),
                "retare",
                "measuring the rest again",
            )

    def drift(self, frame: LiveFrame) -> Drift:
        r"""Adds the next frame, and returns the distance between the mean of the last
        :obj:`min_frames` frames and the rest, if these frames are still. A steady contact looks
        like drift: only the caller can know whether nothing touches the sensor.

        Args:
            frame (LiveFrame): The frame.
        """
        no_drift = Drift(math.nan, np.zeros(0, dtype=np.int64))
        with self._lock:
            if self._value is None or self._noise is None:
                return no_drift
            self._recent.append(np.array(frame.tactile, dtype=np.float32))
            if len(self._recent) < (self._recent.maxlen or 0):
                return no_drift
            recent = np.stack(self._recent)
            movement, _ = movement_and_noise(recent)
            if np.nanmax(movement, initial=0.0) > self.max_movement:
                return no_drift
            deviation = np.abs(mean_reading(recent.astype(np.float64)) - self._value)
            distance = distance_ratio(deviation, trusted_noise(self._noise))
            taxels = np.flatnonzero((distance > self.max_drift).any(axis=1))
            amount = float(np.nanmax(distance, initial=0.0))
            if len(taxels) and not self._has_warned:
                text = (
                    f"{len(taxels)} taxels have drifted from their rest, taxel "
                    f"{_worst_taxel(distance)} by {amount:.3g} times its noise: if nothing touches "
                    "the sensor, measure the rest again"
                )
                _logger.warning("%s", text)
                self._emit(frame.time, "drift", text)
            self._has_warned = len(taxels) > 0
            return Drift(amount, taxels)

    def _emit(self, time: float, kind: str, text: str) -> None:
        self.events.append((time, kind, text))
        for listener in (*self.listeners, self.on_event):
            if listener is not None:
                listener(time, kind, text)

    def __repr__(self) -> str:
        return (
            f"{type(self).__name__}(seconds={self.seconds:g}, min_frames={self.min_frames}, "
            f"max_movement={self.max_movement:g}, ready={self.ready})"
        )


class _RunningMean:
    # The mean of a growing list of frames; each call adds the new frames only.

    def __init__(self, frames: list[LiveFrame]) -> None:
        self.frames = frames
        self._num_added = 0
        self._total = self._count = np.zeros(1)

    def mean(self) -> np.ndarray:
        for frame in self.frames[self._num_added :]:
            is_present = ~np.isnan(frame.tactile)
            self._total = self._total + np.where(is_present, frame.tactile, 0.0)
            self._count = self._count + is_present
        self._num_added = len(self.frames)
        with np.errstate(invalid="ignore"):  # a taxel without any reading is NaN
            return self._total / self._count


def _worst_taxel(ratio: np.ndarray) -> int:
    return int(np.nanargmax(np.nanmax(np.where(np.isnan(ratio), -1.0, ratio), axis=1)))
