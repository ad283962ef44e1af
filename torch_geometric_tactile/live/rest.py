r"""The readings of a sensor at rest."""

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

_MOST = 20_000  # frames that are kept
_logger = logging.getLogger(__name__)

_Event = tuple[float, str, str]  # time on the host's monotonic clock, kind, text


class RestFrames(NamedTuple):
    r"""The frames that were collected while nothing touched the sensor.

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
        amount (float): The largest distance, in units of the noise at rest; NaN as long as readings
            move or there are too few.
        taxels (numpy.ndarray): The taxels that are further away than :obj:`max_drift`.

    Examples:
        >>> drift = Drift(amount=7.5, taxels=np.array([3]))
        >>> drift.taxels.tolist()
        [3]
    """

    amount: float
    taxels: np.ndarray


class Rest:
    r"""Collects still frames while nothing touches the sensor, for models that need the readings at
    rest of each session.

    The frames are cut in five parts. If the means of a taxel's parts differ by more than
    :obj:`max_movement` times its noise within them, it moves: the frames are refused, the reason is
    an event, and collecting starts anew. A swing that is faster than a part passes as noise.

    Args:
        seconds (float): How long to collect.
        min_frames (int): Least number of frames.
        max_movement (float): Largest difference between parts, in units of the noise.
        max_drift (float): Distance from the rest, in units of its noise, from which :meth:`drift`
            warns.
        on_event (callable, optional): Called with each event: its time, kind and text.

    Attributes:
        events (list): What happened: time on the host's monotonic clock in seconds, kind
            (:obj:`"rest"`, :obj:`"moved"`, :obj:`"retare"` or :obj:`"drift"`) and text.
        number (int): How many rests there were.
        listeners (list of callable): Called as :obj:`on_event` is, before it.

    Raises:
        ValueError: If a number is not positive; on a call, if a frame has another shape than those
            before.

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
        self._so_far = _Sum(self._pending)
        self._frames: RestFrames | None = None
        self._value: np.ndarray | None = None
        self._noise: np.ndarray | None = None
        self._recent: deque[np.ndarray] = deque(maxlen=self.min_frames)
        self._warned = False

    @property
    def ready(self) -> bool:
        r"""Whether there is a rest."""
        return self._frames is not None

    @property
    def frames(self) -> RestFrames | None:
        r"""The frames of the rest, :obj:`None` as long as it is collected."""
        return self._frames

    @property
    def value(self) -> np.ndarray:
        r"""The mean reading at rest :math:`(N, C)`, double. A taxel that had no reading in any
        frame is NaN.

        Raises:
            RuntimeError: If there is no rest yet.
        """
        return self._ready(self._value)

    @property
    def noise(self) -> np.ndarray:
        r"""The standard deviation at rest :math:`(N, C)`, without slow movement.

        Raises:
            RuntimeError: If there is no rest yet.
        """
        return self._ready(self._noise)

    @property
    def shape(self) -> tuple[int, ...] | None:
        r"""The shape of a frame :math:`(N, C)`, :obj:`None` as long as there was none."""
        with self._lock:
            if self._frames is not None:
                return self._frames.tactile.shape[1:]
            return self._pending[-1].tactile.shape if self._pending else None

    def _ready(self, value: np.ndarray | None) -> np.ndarray:
        if value is None:
            raise RuntimeError(f"there must be a rest (got none): {self.status()}")
        return value

    def status(self) -> str:
        r"""Returns in words how far it is."""
        if self.ready:
            return "the rest is there"
        reason = f" ({self.reason})" if self.reason else ""
        return f"keep the sensor untouched: {len(self._pending)} still frames so far{reason}"

    def need(self, min_frames: int) -> None:
        r"""Raises the least number of frames, as to fill a window.

        Args:
            min_frames (int): The number.
        """
        self.min_frames = max(self.min_frames, min_frames)

    def add(self, frame: LiveFrame) -> bool:
        r"""Takes the next frame, unless there is a rest, and returns whether there is one. A frame
        that was given before is ignored.

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
                        f"a frame must have shape {pending[-1].tactile.shape}, as those before "
                        f"(got {frame.tactile.shape})"
                    )
            pending.append(frame)
            long_enough = frame.time - pending[0].time >= self.seconds * (1 - 1e-6)
            if len(pending) < self.min_frames or not (long_enough or len(pending) >= _MOST):
                return False
            return self._finish(frame.time)

    def relative(self, frame: LiveFrame) -> np.ndarray:
        r"""Takes the next frame, unless there is a rest, and returns its readings relative to the
        rest :math:`(N, C)`, float32; as long as it is collected, to the mean of its frames so far.

        Args:
            frame (LiveFrame): The frame.

        Raises:
            RuntimeError: If the frames so far were refused with this one.
        """
        with self._lock:
            self.add(frame)
            value = self._value
            if value is None and self._pending:
                if self._so_far.frames is not self._pending:
                    self._so_far = _Sum(self._pending)
                value = self._so_far.mean()
            out: np.ndarray = (frame.tactile - self._ready(value)).astype(np.float32)
            return out

    def _finish(self, time: float) -> bool:
        pending, self._pending = self._pending, []
        tactile = np.stack([frame.tactile for frame in pending]).astype(np.float32)
        movement, noise = movement_and_noise(tactile)
        worst = float(np.nanmax(movement, initial=0.0))
        if worst > self.max_movement:
            moved = np.flatnonzero((movement > self.max_movement).any(axis=1))
            self.reason = (
                f"{len(moved)} of {len(movement)} taxels move, taxel {_worst(movement)} by "
                f"{worst:.3g} times its noise (at most {self.max_movement:g})"
            )
            self._tell(time, "moved", f"no rest: {self.reason}")
            return False
        joint = None
        if all(frame.joint is not None for frame in pending):
            joint = np.stack([np.asarray(frame.joint, np.float32) for frame in pending])
        # Copied by `stack`; a source may use its arrays again.
        self._frames = RestFrames(tactile, np.array([frame.time for frame in pending]), joint)
        self._value, self._noise = mean_reading(tactile.astype(np.float64)), noise
        self._recent.clear()
        self._warned = False
        self.reason = ""
        self.number += 1
        dead = int(np.isnan(self._value).any(axis=1).sum())
        told = f", {dead} taxels without a reading" if dead else ""
        self._tell(time, "rest", f"rest of {len(pending)} frames{told}")
        return True

    def retare(self) -> None:
        r"""Forgets the rest and collects another one from the next frame on."""
        with self._lock:
            last = self._frames.time[-1] if self._frames is not None else None
            last = self._pending[-1].time if self._pending else last
            self._frames = self._value = self._noise = None
            self._pending = []
            self._recent.clear()
            self._tell(
                math.nan if last is None else float(last), "retare", "the rest is taken anew"
            )

    def drift(self, frame: LiveFrame) -> Drift:
        r"""Compares the sensor with its rest: takes the next frame, and as soon as there are
        :obj:`min_frames` that are still, tells how far their mean is from the rest. Whether nothing
        is touched is for the caller to know: a contact that is held looks like a drift.

        Args:
            frame (LiveFrame): The frame.
        """
        none = Drift(math.nan, np.zeros(0, dtype=np.int64))
        with self._lock:
            if self._value is None or self._noise is None:
                return none
            self._recent.append(np.array(frame.tactile, dtype=np.float32))
            if len(self._recent) < (self._recent.maxlen or 0):
                return none
            recent = np.stack(self._recent)
            movement, _ = movement_and_noise(recent)
            if np.nanmax(movement, initial=0.0) > self.max_movement:
                return none
            away = np.abs(mean_reading(recent.astype(np.float64)) - self._value)
            distance = distance_ratio(away, trusted_noise(self._noise))
            taxels = np.flatnonzero((distance > self.max_drift).any(axis=1))
            amount = float(np.nanmax(distance, initial=0.0))
            if len(taxels) and not self._warned:
                text = (
                    f"{len(taxels)} taxels are away from their rest, taxel {_worst(distance)} by "
                    f"{amount:.3g} times its noise: take the rest anew if nothing is touched"
                )
                _logger.warning("%s", text)
                self._tell(frame.time, "drift", text)
            self._warned = len(taxels) > 0
            return Drift(amount, taxels)

    def _tell(self, time: float, kind: str, text: str) -> None:
        self.events.append((time, kind, text))
        for listener in (*self.listeners, self.on_event):
            if listener is not None:
                listener(time, kind, text)

    def __repr__(self) -> str:
        return (
            f"{type(self).__name__}(seconds={self.seconds:g}, min_frames={self.min_frames}, "
            f"max_movement={self.max_movement:g}, ready={self.ready})"
        )


class _Sum:
    # Of frames that become more, each of which is added once.

    def __init__(self, frames: list[LiveFrame]) -> None:
        self.frames = frames
        self._number = 0
        self._total = self._count = np.zeros(1)

    def mean(self) -> np.ndarray:
        for frame in self.frames[self._number :]:
            present = ~np.isnan(frame.tactile)
            self._total = self._total + np.where(present, frame.tactile, 0.0)
            self._count = self._count + present
        self._number = len(self.frames)
        with np.errstate(invalid="ignore"):  # a taxel without any reading is NaN
            return self._total / self._count


def _worst(ratio: np.ndarray) -> int:
    return int(np.nanargmax(np.nanmax(np.where(np.isnan(ratio), -1.0, ratio), axis=1)))
