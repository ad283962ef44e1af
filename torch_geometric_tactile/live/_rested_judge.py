r"""A judge, and the rest that it waits for."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from torch_geometric_tactile.data.live_frame import LiveFrame
from torch_geometric_tactile.live.judge import Judge, Judgement
from torch_geometric_tactile.live.rest import Rest

_DRIFT_SECONDS = 0.25  # between two frames whose distance from the rest is measured


class RestedJudge:
    r"""Gives frames to a judge as soon as there is a rest, if something needs one."""

    def __init__(
        self,
        judge: Judge | None,
        rest: Rest | None,
        tare: bool,
        on_event: Callable[[str, str], None],
    ) -> None:
        if rest is None and judge is not None:
            rest = judge.rest
        if tare and rest is None:
            raise ValueError("'rest' must be given: 'tare' subtracts what it measures (got None)")
        measures = judge is not None and judge.info["rest"] is not None
        if tare and measures:
            raise ValueError("'tare' must be false: the model itself measures the rest")
        self.judge = judge
        self._rest = rest if tare or measures else None
        self._tares = tare
        self._next_drift = 0.0
        if self._rest is not None:
            before = self._rest.on_event

            def tell(when: float, kind: str, text: str) -> None:
                on_event(kind, text)
                if before is not None:
                    before(when, kind, text)

            self._rest.on_event = tell

    @property
    def rest_value(self) -> np.ndarray | None:
        r"""The mean reading at rest :math:`(N, C)`, if it is needed and there."""
        rest = self._rest
        return rest.value if rest is not None and rest.ready else None

    @property
    def waiting(self) -> str:
        r"""How far the rest is, in words; empty if nothing waits for one."""
        rest = self._rest
        return "" if rest is None or rest.ready else rest.status()

    def retare(self) -> bool:
        r"""Measures the rest anew, and returns whether something needs one."""
        if self._rest is not None:
            self._rest.retare()
        return self._rest is not None

    def watch_drift(self, frame: LiveFrame) -> None:
        r"""Compares some of the frames with the rest."""
        if self._rest is not None and frame.time >= self._next_drift:
            self._next_drift = frame.time + _DRIFT_SECONDS
            self._rest.drift(frame)

    def __call__(self, frame: LiveFrame, wanted: bool = True) -> Judgement | None:
        r"""As of :class:`Judge`."""
        if self._tares and self._rest is not None:
            if not self._rest.add(frame):
                return None
            tactile = (frame.tactile - self._rest.value).astype(np.float32)
            frame = replace(frame, tactile=tactile)
        return None if self.judge is None else self.judge(frame, wanted=wanted)
