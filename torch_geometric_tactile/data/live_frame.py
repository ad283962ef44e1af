r"""One frame of a live sensor."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from torch_geometric_tactile.data.frame_info import FrameInfo


@dataclass(frozen=True, eq=False, slots=True)
class LiveFrame:
    r"""One frame of a live sensor.

    Missing readings and the readings of dead taxels are NaN, never made-up numbers. The values are
    checked by the decoders and sources that create frames, not by this class.

    Args:
        sequence (int): Number of the frame as counted by the device, after unwrapping. A skipped
            number is a lost frame.
        time (float): Time of the frame on this host's clock (:func:`time.perf_counter`) in seconds,
            strictly increasing in a stream. Until the stream converts :obj:`device_time`, it is the
            time of :obj:`received`.
        received (int): Time in nanoseconds at which the last byte was read, on the clock of
            :func:`time.perf_counter_ns`.
        device_time (float, optional): Time of the frame on the clock of the device in seconds;
            :obj:`None` if the device sends none.
        tactile (numpy.ndarray): Readings :math:`(N, C)`, float32, in the unit of the source.
        joint (numpy.ndarray, optional): Joint angles in radians :math:`(J,)`.
        extra (Mapping of str to numpy.ndarray): Further signals, such as the temperature of each
            taxel.
        info (FrameInfo, optional): The properties of the frames of the source, one object for all
            frames: the unit, the column names and, for a replayed recording, its rate. For a
            replayed recording, :obj:`device_time` is the time in the recording.

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
