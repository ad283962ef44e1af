r"""Where live frames come from."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any, Self

from torch_geometric_tactile.data.live_frame import LiveFrame
from torch_geometric_tactile.io import DecoderCounts


class SourceEnded(EOFError):  # noqa: N818 - an end, not an error
    r"""Raised when a source has no more frames, and will have none.

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
        name (str): The URL of the source, as users write it.
        checksum (str): What guards a frame; :obj:`"none"` if a damaged reading may pass.
        clock_period (float, optional): After how many seconds the clock of the device starts over.
        counts (DecoderCounts): What was good, corrupt, skipped and lost, over all openings.
        device_order (bool): Whether the taxels come in the order of the device's wiring, which is
            that of no layout.
        meta (Mapping): What is known about the readings, with the keys of
            :class:`~torch_geometric_tactile.data.Recording`: :obj:`"sensor"` (name of the layout),
            :obj:`"unit"`, :obj:`"rate"`, :obj:`"joint_names"`; complete once it is open.
        reopens (bool): Whether it is worth opening again after it was lost.
        clock_rate (float): Seconds on the clock of the device for each second, such as 2 for a
            recording at double speed; infinite if the two have nothing to do with each other.
        exact_clock (bool): Whether the times of the device are those of its measurements. If false,
            as where a program stamps its messages, frames get regular times by their numbers.
        repeats (int): Messages that came again, and were left out.
        waits (bool): Whether it may be kept waiting, as a file that is read as fast as possible:
            then a slow subscriber of policy :obj:`"all"` holds it up, and never overflows.

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
        r"""Opens it; does nothing if it is open.

        Raises:
            OSError: If it is not there; the message says what is there.
        """

    @abstractmethod
    def read(self, timeout: float) -> list[LiveFrame]:
        r"""Returns the frames that came, at least one, or none if none came in time.

        Args:
            timeout (float): How long to wait for the first one, in seconds.

        Raises:
            SourceEnded: If there are no more frames.
            OSError: If the port or socket is lost.
            EOFError: If the other side has closed it.
        """

    def why_no_frame(self) -> str:
        r"""Returns why there is no frame: what came instead, and what to check."""
        return self.counts.reason or "nothing came"

    @abstractmethod
    def close(self) -> None:
        r"""Closes it; does nothing if it is closed."""

    def is_there(self) -> bool:
        r"""Returns whether a lost source seems to be back, if there is a cheap way to know; it is
        then opened without waiting longer."""
        return False

    def __enter__(self) -> Self:
        self.open()
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.name!r})"
