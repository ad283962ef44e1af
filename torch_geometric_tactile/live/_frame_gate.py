r"""Which frames of a stream a model sees."""

import logging
import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from torch_geometric_tactile.data._column_order import column_places
from torch_geometric_tactile.data._gaps import is_gap
from torch_geometric_tactile.data.frame_info import FrameInfo
from torch_geometric_tactile.data.live_frame import LiveFrame

_RATE_SECONDS = 1.0  # over which the rate of a stream is measured, again and again
_logger = logging.getLogger(__name__)


def frame_info(facts: Mapping[str, Any]) -> FrameInfo:
    r"""Returns how the frames of a model's training were made; files of older versions tell
    nothing.
    """
    return FrameInfo.from_dict(facts.get("frames") or {})


class FrameGate:
    r"""Compares the frames of a stream with those of a model's training, puts their columns in
    order, and tells which of them the model sees: thinned as in training, and anew after a gap.

    Attributes:
        rate (float or None): Frames per second of the stream, by the numbers of its frames, so that
            lost ones do not lower it; :obj:`None` until a second has passed.
        note (str): What is wrong with the rate, in words; empty if nothing is.
    """

    def __init__(self, info: FrameInfo, with_rate: bool, max_lost: int | None) -> None:
        self.info = info
        self.with_rate = with_rate
        self.max_lost = max_lost
        self.rate: float | None = None
        self.note = ""
        self._compared: FrameInfo | None = None
        self._places: dict[str, list[int]] = {}
        self.reset()

    def reset(self) -> None:
        r"""Forgets the frames before, as at the start of another trial."""
        self._last: LiveFrame | None = None
        self._elapsed = 0.0
        self._tick = -math.inf
        self._selected = 0
        self._mark: tuple[int, float] | None = None

    def ordered(self, frame: LiveFrame) -> tuple[np.ndarray, np.ndarray | None]:
        r"""Returns the readings and angles of a frame in the order of the training.

        Shapes:
            - **output:** readings :math:`(N, C)` and angles :math:`(J,)`
        """
        if frame.info is not self._compared:
            self._compare(frame.info)
        tactile, joint = frame.tactile, frame.joint
        if self._places:
            tactile = self.ordered_readings(tactile)
            if "joint" in self._places and joint is not None:
                joint = np.asarray(joint)[self._places["joint"]]
        return tactile, joint

    def ordered_readings(self, tactile: np.ndarray) -> np.ndarray:
        r"""Returns readings of frames like the last one in the order of the training.

        Shapes:
            - **tactile:** :math:`(\ldots, N, C)`
            - **output:** the same
        """
        if "tactile" not in self._places:
            return tactile
        flat = np.ascontiguousarray(tactile).reshape(*tactile.shape[:-2], -1)
        return flat[..., self._places["tactile"]].reshape(tactile.shape)

    def _compare(self, info: FrameInfo | None) -> None:
        self._compared = info
        if info is None:
            self._places = {}
            return
        self.info.require(info, "a frame", with_rate=False)
        self._places = column_places(info.columns, self.info.columns)
        if info.rate is not None:
            self._check_rate(info.rate, info.tolerance)

    def admit(self, frame: LiveFrame) -> tuple[bool, bool]:
        r"""Takes note of the next frame, and returns whether the model sees it, and whether frames
        or time are missing before it.
        """
        last, self._last = self._last, frame
        if last is None:
            self._mark = (frame.sequence, 0.0)
            return self._is_selected(0.0), False
        step = _seconds_between(last, frame)
        self._elapsed += max(step, 0.0)
        is_break = self._is_break(last.sequence, frame.sequence, step)
        self._measure_rate(frame, is_break)
        return self._is_selected(self._elapsed), is_break

    def _is_selected(self, elapsed: float) -> bool:
        if self.info.selected_rate is not None:
            tick = float(self.info.ticks(elapsed))
            if tick <= self._tick:
                return False
            self._tick = tick
        self._selected += 1
        return (self._selected - 1) % self.info.stride == 0

    def _is_break(self, last: int, sequence: int, step: float) -> bool:
        lost, max_gap = sequence - last - 1, self.info.max_gap
        if lost < 0:  # the device has begun anew
            return True
        if max_gap is None:
            return lost > (self.max_lost or 0)
        return is_gap(step, max_gap) or (self.max_lost is not None and lost > self.max_lost)

    def _measure_rate(self, frame: LiveFrame, is_break: bool) -> None:
        if self._mark is None or is_break:
            self._mark = (frame.sequence, self._elapsed)
            return
        seconds = self._elapsed - self._mark[1]
        if seconds < _RATE_SECONDS:
            return
        self.rate = (frame.sequence - self._mark[0]) / seconds
        self._mark = (frame.sequence, self._elapsed)
        if frame.info is None or frame.info.rate is None:
            self._check_rate(self.rate, 0.0)

    def _check_rate(self, rate: float, tolerance: float) -> None:
        if not self.with_rate:
            return
        before, self.note = self.note, ""
        if self.info.rate_differs(rate, tolerance):
            expected = self.info.selected_rate or self.info.rate
            self.note = f"wrong rate: {rate:.3g} in place of {expected:.3g} Hz"
            if not before:
                _logger.warning(
                    "%s: the answers are those of windows of another duration", self.note
                )


def _seconds_between(last: LiveFrame, frame: LiveFrame) -> float:
    # A recording may be replayed faster, or as fast as it can be read.
    is_replayed = frame.info is not None and frame.info.rate is not None
    if is_replayed and frame.device_time is not None and last.device_time is not None:
        return frame.device_time - last.device_time
    return frame.time - last.time
