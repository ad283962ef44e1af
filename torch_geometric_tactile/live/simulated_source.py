r"""A simulated hand as a source."""

from collections.abc import Iterator
from dataclasses import replace

from torch_geometric_tactile.data.live_frame import LiveFrame
from torch_geometric_tactile.data.recording import Recording
from torch_geometric_tactile.live.replay_source import ReplaySource
from torch_geometric_tactile.live.source import Source, SourceEnded


class SimulatedSource(Source):
    r"""Simulates an Allegro hand of 384 taxels that grasps one object after another, without end.
    Needs the extra :obj:`sim`.

    Each grasp of 5 s is simulated as a whole when it is due. The simulation takes seconds, during
    which no frame arrives. The frames of the grasp are then returned at their times. They have no
    device time.

    Args:
        object (str, optional): Name of the object that is grasped. By default all objects of the
            set in turn.
        rate (float, optional): Frames per second, 50 (default) or an integer fraction of it.
        seed (int): Seed of the grasps, not negative.
        objects (str): Name of the set of objects, as in
            :func:`~torch_geometric_tactile.sim.simulate`.
        motion (str): :obj:`"lift"` or :obj:`"squeeze"`.

    Attributes:
        label (str, int or None): The object in the hand.

    Raises:
        ImportError: If the extra is missing.
        ValueError: If an argument is unknown or out of range.

    Examples:
        >>> source = SimulatedSource("sponge", rate=25.0)  # simulates nothing before it is opened
        >>> source.name
        'sim:?object=sponge'
    """

    reopens = False

    def __init__(
        self,
        object: str | None = None,
        rate: float | None = None,
        seed: int = 0,
        *,
        objects: str = "paper8",
        motion: str = "lift",
    ) -> None:
        from torch_geometric_tactile.sim.simulate import grasp_recordings

        if not isinstance(seed, int) or isinstance(seed, bool):
            raise ValueError(f"'seed' must be an integer (got {seed!r})")
        # Checks the arguments, but simulates nothing yet.
        self._grasps: Iterator[Recording] = grasp_recordings(
            objects, seed, rate=rate, only=object or None, motion=motion
        )
        super().__init__(f"sim:?object={object}" if object else "sim:")
        self.label: str | int | None = None
        self._replay: ReplaySource | None = None
        self._sequence = 0

    def open(self) -> None:
        r"""Simulates the first grasp. Does nothing if the source is open."""
        if self._replay is None:
            self._start_grasp()

    def _start_grasp(self) -> None:
        recording = next(self._grasps)
        self._replay = ReplaySource(recording)
        self._replay.open()
        self.label = recording.label
        if not self.meta:
            keys = ("unit", "rate", "sensor", "synthetic", "object_set", "seed", "motion")
            self.meta.update((key, recording.meta[key]) for key in keys)

    def read(self, timeout: float) -> list[LiveFrame]:
        r"""Returns the frames that are due, or an empty list if none is due within the timeout.
        At the end of a grasp, simulates the next grasp.

        Args:
            timeout (float): Limit of the wait in seconds.
        """
        if self._replay is None:
            raise OSError(f"{self.name} is not open")
        try:
            frames = self._replay.read(timeout)
        except SourceEnded:
            self._start_grasp()
            return []
        start, self._sequence = self._sequence, self._sequence + len(frames)
        self.counts.good += len(frames)
        return [
            replace(frame, sequence=start + i, device_time=None) for i, frame in enumerate(frames)
        ]

    def close(self) -> None:
        r"""Drops the current grasp. Does nothing if the source is closed."""
        self._replay = None
