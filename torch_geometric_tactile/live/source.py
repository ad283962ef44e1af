r"""Base class of sources of live frames."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any, Self

from torch_geometric_tactile.data.live_frame import LiveFrame
from torch_geometric_tactile.io import DecoderCounts


class SourceEnded(EOFError):  # noqa: N818 - an end, not an error
    r"""Raised when a source has delivered its last frame.

    Examples:
        >>> import numpy as np
        >>> from torch_geometric_tactile.data import Recording
        >>> from torch_geometric_tactile.live import ReplaySource
        >>> source = ReplaySource(Recording(time=np.zeros(1), tactile=np.ones((1, 4, 3))), speed=0)
        >>> with source:
        ...     print(len(source.read(timeout=1.0)))
        ...     try:
        ...         source.read(timeout=1.0)
        ...     except SourceEnded as end:
        ...         print(end)
        1
        file: has ended
    """


class Source(ABC):
    r"""Base class of sources of live frames. One thread opens, reads and closes a source; the
    source starts no thread.

    Attributes:
        name (str): URL of the source.
        checksum (str): Name of the check of each frame; :obj:`"none"` if damaged readings are not
            detected.
        clock_period (float, optional): Seconds after which the clock of the device wraps around.
        counts (DecoderCounts): Numbers of good, corrupt, skipped and lost frames since the first
            opening.
        device_order (bool): Whether the taxels are in the order of the device's wiring, which
            matches no layout.
        meta (Mapping): Metadata of the readings, with the keys of
            :class:`~torch_geometric_tactile.data.Recording`: :obj:`"sensor"` (name of the layout),
            :obj:`"unit"`, :obj:`"rate"`, :obj:`"joint_names"`. Complete once the source is open.
        reopens (bool): Whether a lost source may come back. The stream then opens it again.
        clock_rate (float): Seconds on the clock of the device for each second, such as 2 for a
            recording at double speed; infinite if the clocks are unrelated.
        exact_clock (bool): Whether the device times are the times of the measurements. If
            :obj:`False`, as for a program that stamps its messages, the stream computes regular
            times from the frame numbers.
        repeats (int): Number of repeated messages, which are dropped.
        waits (bool): Whether the source can wait, such as a file that is read as fast as possible.
            A slow subscriber with policy :obj:`"all"` then slows the source down and never
            overflows.

    Examples:
        >>> import numpy as np
        >>> class Zeros(Source):
        ...     def open(self):
        ...         self.number = 0
        ...     def read(self, timeout):
        ...         self.number += 1
        ...         return [LiveFrame(self.number - 1, 0.0, 0, None, np.zeros((4, 3), np.float32))]
        ...     def close(self):
        ...         pass
        >>> with Zeros("zeros:") as source:
        ...     source.read(timeout=1.0)[0].tactile.shape
        (4, 3)
    """

    checksum: str = "none"
    clock_period: float | None = None
    reopens: bool = True
    clock_rate: float = 1.0
    exact_clock: bool = True
    device_order: bool = False
    repeats: int = 0
    waits: bool = False

    def __init__(self, name: str, meta: Mapping[str, Any] | None = None) -> None:
        self.name = name
        self.counts = DecoderCounts()
        self.meta: dict[str, Any] = dict(meta or {})

    @abstractmethod
    def open(self) -> None:
        r"""Opens the source. Does nothing if it is open.

        Raises:
            OSError: If the source is not available. The message lists the available sources.
        """

    @abstractmethod
    def read(self, timeout: float) -> list[LiveFrame]:
        r"""Returns the received frames, or an empty list if none arrives within the timeout.

        Args:
            timeout (float): Limit of the wait for the first frame in seconds.

        Raises:
            SourceEnded: If there are no more frames.
            OSError: If the port or socket is lost.
            EOFError: If the other side has closed the connection.
        """

    def why_no_frame(self) -> str:
        r"""Returns the reason why there is no frame, and the settings to check."""
        return self.counts.reason or "no data arrived"

    @abstractmethod
    def close(self) -> None:
        r"""Closes the source. Does nothing if it is closed."""

    def is_there(self) -> bool:
        r"""Returns whether a lost source is available again, if this is cheap to test. The stream
        then opens it at once."""
        return False

    def __enter__(self) -> Self:
        self.open()
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.name!r})"
