r"""One frame of a live sensor."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from torch_geometric_tactile.data.frame_info import FrameInfo


@dataclass(frozen=True, eq=False, slots=True)
class LiveFrame:
    r"""One frame of a live sensor, as it was received.

    Missing and dead taxels are NaN, never invented numbers. Nothing is checked here: decoders and
    sources are the border.

    Args:
        sequence (int): Number of the frame, as its device counts, without wraps; a gap is a loss.
        time (float): Its time on this host's clock (:func:`time.perf_counter`) in seconds, strictly
            increasing in a stream. Until the stream has mapped it, the time of :obj:`received`.
        received (int): When its last byte was read, on the clock of :func:`time.perf_counter_ns`.
        device_time (float, optional): Its time on the clock of the device in seconds, or
            :obj:`None` if the device sends none.
        tactile (numpy.ndarray): Readings :math:`(N, C)`, float32, in the unit of the source.
        joint (numpy.ndarray, optional): Joint angles in radians :math:`(J,)`.
        extra (Mapping of str to numpy.ndarray): Further signals, such as the temperature of each
            taxel.
        info (FrameInfo, optional): How the frames of the source are made, the same object for all
            of them: unit and names of columns, and of a replayed recording its rate, in which case
            :obj:`device_time` is the time of the recording.

    Examples:
        >>> frame = LiveFrame(7, 0.07, 70_000_000, None, np.ones((4, 3), np.float32))
        >>> frame.sequence, frame.tactile.shape
        (7, (4, 3))
    """

    sequence: int
    time: float
    received: int
    device_time: float | None
    tactile: np.ndarray
    joint: np.ndarray | None = None
    extra: Mapping[str, np.ndarray] = field(default_factory=dict)
    info: FrameInfo | None = None
