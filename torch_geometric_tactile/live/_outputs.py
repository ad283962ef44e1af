r"""Where frames, judgements and events of a session go."""

import threading
from collections.abc import Callable
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile.live.judge import Judgement
from torch_geometric_tactile.live.recorder import Recorder
from torch_geometric_tactile.live.stream import Stream

if TYPE_CHECKING:
    from torch_geometric_tactile.live.viewer import Viewer
    from torch_geometric_tactile.sensors import TaxelLayout


class Outputs:
    r"""The recorder and the viewer of a session, as far as there are some; called by any thread."""

    def __init__(self, stream: Stream, layout: "TaxelLayout | PathLike | None") -> None:
        self.recorder: Recorder | None = None
        self.viewer: Viewer | None = None
        self._stream = stream
        self._layout = layout
        self._rest: np.ndarray | None = None
        self._lock = threading.RLock()

    def view(self, host: str, port: int, on_tare: Callable[[], None]) -> str:
        r"""Starts the viewer, and returns the address of its page."""
        from torch_geometric_tactile.live.viewer import Viewer

        viewer = Viewer(self._stream, self._layout, host=host, port=port)
        viewer.on_tare, viewer.on_record = on_tare, self.toggle_recording
        viewer.start()
        self.viewer = viewer
        return viewer.url

    def record(self, path: PathLike, label: str | int | None, overwrite: bool) -> None:
        r"""As of :meth:`LiveSession.record`."""
        with self._lock:
            if self.recorder is not None:
                raise ValueError(f"a recorder runs: stop that of '{self.recorder.path}' first")
            recorder = Recorder(
                path, self._stream, layout=self._layout, label=label, overwrite=overwrite
            )
            recorder.rest = self._rest
            recorder.start()
            self.recorder = recorder
            if self.viewer is not None:
                self.viewer.recording = True

    def stop_recording(self) -> Path | None:
        r"""As of :meth:`LiveSession.stop_recording`."""
        with self._lock:
            recorder, self.recorder = self.recorder, None
            if self.viewer is not None:
                self.viewer.recording = False
        if recorder is None:
            return None
        recorder.close()
        return recorder.path

    def toggle_recording(self) -> Path | None:
        r"""As of :meth:`LiveSession.toggle_recording`."""
        with self._lock:
            if self.recorder is not None:
                return self.stop_recording()
            path = Path(f"{datetime.now():%Y-%m-%d_%H-%M-%S}.mcap")
            self.record(path, None, False)
            return path

    def judgement(self, judgement: Judgement) -> None:
        r"""Writes and shows a judgement."""
        with self._lock:
            if self.recorder is not None:
                self.recorder.judgement(judgement)
        if self.viewer is not None:
            self.viewer.judgement(judgement)

    def event(self, kind: str, text: str) -> None:
        r"""Writes and shows an event."""
        with self._lock:
            if self.recorder is not None:
                self.recorder.event(kind, text)
        if self.viewer is not None:
            self.viewer.note(text)

    def rest(self, rest: np.ndarray | None) -> None:
        r"""Shows readings relative to another rest.

        Shapes:
            - **rest:** Readings at rest :math:`(N, C)`.
        """
        with self._lock:
            self._rest = rest
            if self.recorder is not None:
                self.recorder.rest = rest
        if self.viewer is not None:
            self.viewer.rest = rest

    def close(self) -> None:
        r"""Ends the recording and the viewer."""
        try:
            self.stop_recording()
        finally:
            if self.viewer is not None:
                self.viewer.close()
