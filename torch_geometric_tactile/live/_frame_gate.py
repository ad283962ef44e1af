r"""Selection of the frames in a stream that a model uses."""

import logging
import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from torch_geometric_tactile.data._column_order import column_places
from torch_geometric_tactile.data._gaps import is_gap
from torch_geometric_tactile.data.frame_info import FrameInfo
from torch_geometric_tactile.data.live_frame import LiveFrame

_RATE_SECONDS = 1.0  # length of the intervals in which the rate of a stream is measured
_logger = logging.getLogger(__name__)


def frame_info(metadata: Mapping[str, Any]) -> FrameInfo:
    r"""Returns unit, columns, rate and thinning of a model's training frames. In files of older
    versions they are unknown.
    """
    return FrameInfo.from_dict(metadata.get("frames") or {})


class FrameGate:
    r"""Compares the frames of a stream with the training frames of a model, reorders their columns,
    and selects frames as in training. The selection restarts after a gap.

    Args:
        info (FrameInfo): Unit, columns, rate and thinning of the training frames.
        with_rate (bool): Whether to compare the rate.
        max_lost (int, optional): Number of consecutive frames that may be lost. By default, gaps
            are detected from the times.

    Attributes:
        rate (float or None): Frames per second of the stream by its frame numbers, so lost frames
            do not lower it; :obj:`None` in the first second.
        note (str): Message about a wrong rate; empty if the rate is right.
    """

    def __init__(self, info: FrameInfo, with_rate: bool, max_lost: int | None) -> None:
        self.info = info
        self.with_rate = with_rate
        self.max_lost = max_lost
        self.rate: float | None = None
        self.note = ""
        self._checked_info: FrameInfo | None = None
        self._column_orders: dict[str, list[int]] = {}
        self.reset()

    def reset(self) -> None:
        r"""Forgets earlier frames. Called at the start of a trial."""
        self._last: LiveFrame | None = None
        self._elapsed = 0.0
        self._last_tick = -math.inf
        self._num_sampled = 0
        self._rate_start: tuple[int, float] | None = None

    def reorder(self, frame: LiveFrame) -> tuple[np.ndarray, np.ndarray | None]:
        r"""Returns the readings and joint angles of a frame in the column order of training.

        Shapes:
            - **output:** readings :math:`(N, C)` and angles :math:`(J,)`
        """
        if frame.info is not self._checked_info:
            self._compare(frame.info)
        tactile, joint = frame.tactile, frame.joint
        if self._column_orders:
            tactile = self.reorder_readings(tactile)
            if "joint" in self._column_orders and joint is not None:
                joint = np.asarray(joint)[self._column_orders["joint"]]
        return tactile, joint

    def reorder_readings(self, tactile: np.ndarray) -> np.ndarray:
        r"""Returns readings with the columns of the last frame in the column order of training.

        Shapes:
            - **tactile:** :math:`(\ldots, N, C)`
            - **output:** :math:`(\ldots, N, C)`
        """
        if "tactile" not in self._column_orders:
            return tactile
        flat = np.ascontiguousarray(tactile).reshape(*tactile.shape[:-2], -1)
        return flat[..., self._column_orders["tactile"]].reshape(tactile.shape)

    def _compare(self, info: FrameInfo | None) -> None:
        self._checked_info = info
        if info is None:
            self._column_orders = {}
            return
        self.info.require(info, "a frame", with_rate=False)
        self._column_orders = column_places(info.columns, self.info.columns)
        if info.rate is not None:
            self._check_rate(info.rate, info.tolerance)

    def admit(self, frame: LiveFrame) -> tuple[bool, bool]:
        r"""Adds the next frame. Returns whether the model uses it, and whether there is a gap
        before it.
        """
        last, self._last = self._last, frame
        if last is None:
            self._rate_start = (frame.sequence, 0.0)
            return self._is_selected(0.0), False
        step = _seconds_between(last, frame)
        self._elapsed += max(step, 0.0)
        is_break = self._is_break(last.sequence, frame.sequence, step)
        self._measure_rate(frame, is_break)
        return self._is_selected(self._elapsed), is_break

    def _is_selected(self, elapsed: float) -> bool:
        if self.info.selected_rate is not None:
            tick = float(self.info.ticks(elapsed))
            if tick <= self._last_tick:
                return False
            self._last_tick = tick
        self._num_sampled += 1
        return (self._num_sampled - 1) % self.info.stride == 0

    def _is_break(self, last: int, sequence: int, step: float) -> bool:
        num_lost, max_gap = sequence - last - 1, self.info.max_gap
        if num_lost < 0:  # the device has started again
            return True
        if max_gap is None:
            return num_lost > (self.max_lost or 0)
        return is_gap(step, max_gap) or (self.max_lost is not None and num_lost > self.max_lost)

    def _measure_rate(self, frame: LiveFrame, is_break: bool) -> None:
        if self._rate_start is None or is_break:
            self._rate_start = (frame.sequence, self._elapsed)
            return
        seconds = self._elapsed - self._rate_start[1]
        if seconds < _RATE_SECONDS:
            return
        self.rate = (frame.sequence - self._rate_start[0]) / seconds
        self._rate_start = (frame.sequence, self._elapsed)
        if frame.info is None or frame.info.rate is None:
            self._check_rate(self.rate, 0.0)

    def _check_rate(self, rate: float, tolerance: float) -> None:
        if not self.with_rate:
            return
        previous_note, self.note = self.note, ""
        if self.info.rate_differs(rate, tolerance):
            expected = self.info.selected_rate or self.info.rate
            self.note = f"wrong rate: {rate:.3g} instead of {expected:.3g} Hz"
            if not previous_note:
                _logger.warning("%s: windows are not as long as in training", self.note)


def _seconds_between(last: LiveFrame, frame: LiveFrame) -> float:
    # Device times, because a recording may be replayed faster than it was recorded.
    is_replayed = frame.info is not None and frame.info.rate is not None
    if is_replayed and frame.device_time is not None and last.device_time is not None:
        return frame.device_time - last.device_time
    return frame.time - last.time
