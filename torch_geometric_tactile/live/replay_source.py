r"""Replay of a recording as a source."""

import math
import time
from collections.abc import Iterator
from itertools import count
from typing import Any

import numpy as np

from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile.data.live_frame import LiveFrame
from torch_geometric_tactile.data.recording import Recording
from torch_geometric_tactile.live.source import Source, SourceEnded

_MAX_READ_FRAMES = 64  # limit of one read, reached if frames are replayed as fast as possible


class ReplaySource(Source):
    r"""Replays the frames of a recording at their recorded times. The recording is read once; the
    frames are views of its arrays. The :obj:`device_time` of a frame is its time in the recording.

    Args:
        path (str, PathLike or Recording): A recording, or a file of any format that
            :func:`~torch_geometric_tactile.io.read_recording` reads.
        speed (float): Playback speed relative to the recording. With 0 or infinity, frames are
            replayed as fast as the slowest subscriber reads them.
        loop (bool): Whether to start again at the end. Times and frame numbers continue.
        **read_options (optional): Options of
            :func:`~torch_geometric_tactile.io.read_recording` for the file.

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

    def __init__(
        self,
        path: PathLike | Recording,
        speed: float = 1.0,
        loop: bool = False,
        **read_options: Any,
    ) -> None:
        if isinstance(speed, bool) or not isinstance(speed, int | float) or not speed >= 0:
            raise ValueError(f"'speed' must be 0 or more (got {speed!r})")
        self._recording = path if isinstance(path, Recording) else None
        self.path = None if isinstance(path, Recording) else path
        super().__init__("file:" if self.path is None else f"file:{path}")
        self.read_options = read_options
        self.speed = float(speed)
        self.loop = bool(loop)
        self.waits = self.speed in (0.0, math.inf)
        self.clock_rate = math.inf if self.waits else self.speed
        self._frames: Iterator[tuple[float, LiveFrame]] | None = None
        self._next: tuple[float, LiveFrame] | None = None
        self._start = 0.0

    @property
    def recording(self) -> Recording | None:
        r"""The recording; :obj:`None` before it is read."""
        return self._recording

    def open(self) -> None:
        r"""Reads the file. Does nothing if the source is open. Times count from the first call of
        :meth:`read`.

        Raises:
            FileNotFoundError: If there is no such file.
            ValueError: If the file is not a recording, or the recording has no frames.
        """
        if self._frames is not None:
            return
        if self._recording is None:
            from torch_geometric_tactile.io import read_recording

            assert self.path is not None
            self._recording = read_recording(self.path, **self.read_options)
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
        # Yields seconds since the first frame, and the frame without its arrival.
        times = np.asarray(recording.time, dtype=np.float64)
        first_time = float(times[0])
        step = 1 / recording.rate if recording.num_frames > 1 else 1.0
        length = float(times[-1]) - first_time + step
        info = recording.info
        for turn in count() if self.loop else (0,):
            for i in range(recording.num_frames):
                elapsed = float(times[i]) - first_time + turn * length
                frame = LiveFrame(
                    sequence=turn * recording.num_frames + i,
                    time=0.0,
                    received=0,
                    device_time=first_time + elapsed,
                    tactile=recording.tactile[i],
                    joint=None if recording.joint is None else recording.joint[i],
                    extra={name: rows[i, ...] for name, rows in recording.extra.items()},
                    info=info,
                )
                yield elapsed, frame

    def read(self, timeout: float) -> list[LiveFrame]:
        r"""Returns the frames that are due, or an empty list if none is due within the timeout.

        Args:
            timeout (float): Limit of the wait in seconds.

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
        wait_seconds = self._due_time(self._next) - now
        if wait_seconds > 0:
            time.sleep(min(wait_seconds, max(0.0, timeout)))
        received = time.perf_counter_ns()
        frames: list[LiveFrame] = []
        while self._next is not None and len(frames) < _MAX_READ_FRAMES:
            if self._due_time(self._next) * 1e9 > received:
                break
            frames.append(_with_arrival(self._next[1], received))
            self._next = next(self._frames, None)
        self.counts.good += len(frames)
        return frames

    def _due_time(self, entry: tuple[float, LiveFrame]) -> float:
        # From the start, not from the previous frame, so that delays do not add up.
        return self._start if self.waits else self._start + entry[0] / self.speed

    def close(self) -> None:
        r"""Releases a recording that was read from a file. Does nothing if the source is closed."""
        self._frames = self._next = None
        if self.path is not None:
            self._recording = None


def _with_arrival(frame: LiveFrame, received: int) -> LiveFrame:
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
