r"""Frames of a recording, as if they came now."""

import math
import time
from collections.abc import Iterator
from itertools import count

import numpy as np

from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile.data.live_frame import LiveFrame
from torch_geometric_tactile.data.recording import Recording
from torch_geometric_tactile.live.source import Source, SourceEnded

_CHUNK = 64  # frames of one read, if there are no times to keep


class ReplaySource(Source):
    r"""Replays the frames of a recording at their recorded times. The recording is read once, and
    the frames are views of its arrays; :obj:`device_time` is the time in the recording.

    Args:
        path (str, PathLike or Recording): A file of any format that
            :func:`~torch_geometric_tactile.io.read_recording` reads, or a recording.
        speed (float): How many times as fast; with 0 or infinity as fast as the slowest subscriber
            takes them.
        loop (bool): Whether to begin again at the end, with times and numbers that go on.

    Raises:
        ValueError: If :obj:`speed` is negative or NaN.

    Examples:
        >>> recording = Recording(time=np.arange(5) / 100, tactile=np.ones((5, 4, 3)))
        >>> with ReplaySource(recording, speed=0) as source:
        ...     frames = source.read(timeout=1.0)
        >>> len(frames), frames[1].device_time
        (5, 0.01)
    """

    reopens = False

    def __init__(self, path: PathLike | Recording, speed: float = 1.0, loop: bool = False) -> None:
        if isinstance(speed, bool) or not isinstance(speed, int | float) or not speed >= 0:
            raise ValueError(f"'speed' must be 0 or more (got {speed!r})")
        self._recording = path if isinstance(path, Recording) else None
        self.path = None if isinstance(path, Recording) else path
        super().__init__("file:" if self.path is None else f"file:{path}")
        self.speed = float(speed)
        self.loop = bool(loop)
        self.waits = self.speed in (0.0, math.inf)
        self.clock_rate = math.inf if self.waits else self.speed
        self._frames: Iterator[tuple[float, LiveFrame]] | None = None
        self._next: tuple[float, LiveFrame] | None = None
        self._start = 0.0

    @property
    def recording(self) -> Recording | None:
        r"""The recording, once it was read."""
        return self._recording

    def open(self) -> None:
        r"""Reads the file; does nothing if it is open. The clock starts with the first frame.

        Raises:
            FileNotFoundError: If there is no such file.
            ValueError: If it holds no recording, or one without frames.
        """
        if self._frames is not None:
            return
        if self._recording is None:
            from torch_geometric_tactile.io import read_recording

            assert self.path is not None
            self._recording = read_recording(self.path)
        recording = self._recording
        if recording.num_frames == 0:
            raise ValueError(f"a recording to replay must hold frames (got none in {self.name})")
        self.meta = dict(recording.meta)
        if recording.num_frames > 1:
            self.meta.setdefault("rate", recording.rate)
        self._start = 0.0
        self._frames = self._play(recording)
        self._next = next(self._frames)

    def _play(self, recording: Recording) -> Iterator[tuple[float, LiveFrame]]:
        # Seconds since the first frame, and the frame, which was not received yet.
        times = np.asarray(recording.time, dtype=np.float64)
        first = float(times[0])
        step = 1 / recording.rate if recording.num_frames > 1 else 1.0
        length = float(times[-1]) - first + step
        info = recording.info
        for turn in count() if self.loop else (0,):
            for i in range(recording.num_frames):
                since = float(times[i]) - first + turn * length
                frame = LiveFrame(
                    sequence=turn * recording.num_frames + i,
                    time=0.0,
                    received=0,
                    device_time=first + since,
                    tactile=recording.tactile[i],
                    joint=None if recording.joint is None else recording.joint[i],
                    extra={name: rows[i, ...] for name, rows in recording.extra.items()},
                    info=info,
                )
                yield since, frame

    def read(self, timeout: float) -> list[LiveFrame]:
        r"""Returns the frames whose time has come, or none if it comes for none in time.

        Args:
            timeout (float): How long to wait in seconds.

        Raises:
            SourceEnded: If there are no more frames.
        """
        if self._frames is None:
            raise OSError(f"{self.name} is not open")
        if self._next is None:
            raise SourceEnded(f"{self.name} has ended")
        now = time.perf_counter()
        if not self._start:
            self._start = now
        wait = self._due(self._next) - now
        if wait > 0:
            time.sleep(min(wait, max(0.0, timeout)))
        received = time.perf_counter_ns()
        frames: list[LiveFrame] = []
        while self._next is not None and len(frames) < _CHUNK:
            if self._due(self._next) * 1e9 > received:
                break
            frames.append(_received(self._next[1], received))
            self._next = next(self._frames, None)
        self.counts.good += len(frames)
        return frames

    def _due(self, entry: tuple[float, LiveFrame]) -> float:
        # From the start, not from the frame before, so that nothing adds up.
        return self._start if self.waits else self._start + entry[0] / self.speed

    def close(self) -> None:
        r"""Lets the recording go, if it was read from a file; does nothing if it is closed."""
        self._frames = self._next = None
        if self.path is not None:
            self._recording = None


def _received(frame: LiveFrame, received: int) -> LiveFrame:
    return LiveFrame(
        frame.sequence,
        received * 1e-9,
        received,
        frame.device_time,
        frame.tactile,
        frame.joint,
        frame.extra,
        frame.info,
    )
