r"""A source, and all that is done with its frames."""

import math
import statistics
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Literal, Self

import numpy as np

from torch_geometric_tactile._checks import need
from torch_geometric_tactile._typing import PathLike, Policy
from torch_geometric_tactile.data.live_frame import LiveFrame
from torch_geometric_tactile.live._recorder_parts import LATE_SECONDS, load_recorder
from torch_geometric_tactile.live.callback import Callback
from torch_geometric_tactile.live.judge import Judge, Judgement
from torch_geometric_tactile.live.recorder import Recorder
from torch_geometric_tactile.live.rest import Rest
from torch_geometric_tactile.live.source import Source
from torch_geometric_tactile.live.status import Status
from torch_geometric_tactile.live.stream import Stream
from torch_geometric_tactile.live.subscription import Subscription
from torch_geometric_tactile.live.taxel_map import TaxelMap, TaxelOrder

if TYPE_CHECKING:
    from torch_geometric_tactile.live.viewer import Viewer
    from torch_geometric_tactile.sensors import TaxelLayout

_STATUS_SECONDS = 0.5
_DRIFT_SECONDS = 0.25  # between two frames whose distance from the rest is measured
_LATENCIES = 500
_POLL_SECONDS = 0.02


class LiveSession:
    r"""Runs a model on the frames of a source, records and shows them, independently: the recorder
    gets every frame, the model and the viewer get the newest.

    A model that measures each session needs the sensor at rest first, and so does :obj:`tare`: see
    :class:`Rest`. Until the rest is there, nothing is judged.

    Args:
        source (Source): Where frames come from.
        judge (Judge, optional): What tells their labels.
        rest (Rest, optional): What measures the sensor at rest; that of the judge if left out.
        tare (bool): Whether to subtract the rest from what is judged, for a model of readings that
            were tared before it was trained (such as with :obj:`AllegroUSkin(tare="hover")`).
        taxel_map (TaxelMap or str, optional): From the taxels of the source to those of the layout.
            By default that which comes with the package for the sensor and the layout, or the
            layout of the model (see :class:`Stream`). :obj:`"none"` keeps the order of the source.
        layout (TaxelLayout, str or PathLike, optional): The taxels, for recorder and viewer.
        policy (str, optional): Which frames are judged: :obj:`"newest"`, :obj:`"drop_oldest"` or
            :obj:`"all"`, see :meth:`Judge.follow`. By default the newest; a model of windows sees
            those between.
        callbacks (sequence of Callback): Your own code.

    Attributes:
        stream (Stream): The frames, for further subscribers.
        judged (int): Number of judgements.
        judgement (Judgement, optional): The last one.
        recorder (Recorder, optional): The recorder, if one runs.
        viewer (Viewer, optional): The viewer, if there is one.

    Raises:
        ValueError: If there is no rest for :obj:`tare`.

    Examples:
        >>> from torch_geometric_tactile.live import Judge, LiveSession, open_source
        >>> source = open_source("ws://127.0.0.1:5000")
        >>> session = LiveSession(source, judge=Judge("slip.onnx"))  # doctest: +SKIP
        >>> with session:  # doctest: +SKIP
        ...     session.record("grasp.mcap")
        ...     session.run(seconds=10)
    """

    def __init__(
        self,
        source: Source,
        *,
        judge: Judge | None = None,
        rest: Rest | None = None,
        tare: bool = False,
        taxel_map: TaxelMap | Literal["none"] | None = None,
        layout: "TaxelLayout | PathLike | None" = None,
        policy: Policy | None = None,
        callbacks: Sequence[Callback] = (),
    ) -> None:
        rest = judge.rest if rest is None and judge is not None else rest
        if tare and rest is None:
            raise ValueError("'rest' must be given: 'tare' subtracts what it measures (got None)")
        measures = judge is not None and judge.info["rest"] is not None
        need(not tare or not measures, "'tare' must be false: the model itself measures the rest")
        if judge is not None:
            judge.relative = tare
        if layout is not None:
            from torch_geometric_tactile.sensors import as_layout

            layout = as_layout(layout)
        order: TaxelLayout | TaxelOrder | None = layout
        if order is None and judge is not None:
            order = TaxelOrder(judge.info["layout"], judge.info["num_taxels"])
        if isinstance(taxel_map, str):
            need(taxel_map == "none", "'taxel_map' must be a TaxelMap or 'none'", taxel_map)
            taxel_map, order = None, None
        self.stream = Stream(source, taxel_map=taxel_map, layout=order)
        self.callbacks = list(callbacks)
        self.judged = 0
        self.judgement: Judgement | None = None
        self.recorder: Recorder | None = None
        self.viewer: Viewer | None = None
        self._judge, self._layout, self._tares = judge, layout, tare
        self._rest = rest if tare or (judge is not None and judge.measures_rest) else None
        self._next_drift = 0.0
        sees_all = judge is not None and judge.length > 1
        self._policy: Policy = policy or ("drop_oldest" if sees_all else "newest")
        self._latencies: deque[float] = deque(maxlen=_LATENCIES)
        self._note = ""
        self._worker: threading.Thread | None = None
        self._error: BaseException | None = None
        self._ended = threading.Event()
        self._lock = threading.RLock()  # of the recorder
        if self._rest is not None:
            self._rest.listeners.append(self._rest_event)

    def view(self, host: str = "127.0.0.1", port: int = 0) -> str:
        r"""Starts the viewer, and returns the address of its page. Call it before :meth:`open`, to
        see the first frame.

        Args:
            host (str): Address to serve at.
            port (int): Its port; any free one if zero.
        """
        from torch_geometric_tactile.live.viewer import Viewer

        viewer = Viewer(self.stream, self._layout, host=host, port=port)
        viewer.on_tare, viewer.on_record = self.tare, self.toggle_recording
        viewer.start()
        self.viewer = viewer
        return viewer.url

    def record(
        self,
        path: PathLike,
        label: str | int | None = None,
        overwrite: bool = False,
        max_seconds: float | None = None,
    ) -> None:
        r"""Records from now on, that is, from its return. Call it before :meth:`open`, to have the
        first frame.

        Args:
            path (str or PathLike): The file; its suffix says the format.
            label (str or int, optional): What the recording is an example of.
            overwrite (bool): Whether it may replace a file.
            max_seconds (float, optional): How long, from the first recorded frame on.

        Raises:
            FileExistsError: If there is such a file.
            ValueError: If a recorder runs.
        """
        # Loading takes long, and what is judged meanwhile must not wait for it.
        recorder = Recorder(
            path,
            self.stream,
            layout=self._layout,
            label=label,
            overwrite=overwrite,
            max_seconds=max_seconds,
        )
        with self._lock:
            if self.recorder is not None:
                raise ValueError(f"a recorder runs: stop that of '{self.recorder.path}' first")
            recorder.rest = _value(self._rest)
            recorder.start()
            self.recorder = recorder
            if self.viewer is not None:
                self.viewer.recording = True

    def stop_recording(self) -> Path | None:
        r"""Ends the recording, and returns its file, if there was one.

        Raises:
            OSError: If something could not be written; what could is kept.
            StreamOverflow: If frames came faster than they could be written.
        """
        with self._lock:
            recorder, self.recorder = self.recorder, None
            if self.viewer is not None:
                self.viewer.recording = False
        if recorder is None:
            return None
        recorder.close()
        return recorder.path

    def toggle_recording(self) -> Path | None:
        r"""Ends the recording, or begins one in the current folder with the time as its name, and
        returns its file.

        Raises:
            OSError: As :meth:`stop_recording`.
        """
        with self._lock:
            if self.recorder is not None:
                return self.stop_recording()
        path = Path(f"{datetime.now():%Y-%m-%d_%H-%M-%S}.mcap")
        self.record(path)
        return path

    def tare(self) -> None:
        r"""Measures the rest anew, of the frames that come now, for the model and the viewer."""
        if self._rest is not None:
            self._rest.retare()
        else:
            self._rest_event(math.nan, "retare", "the rest is shown anew")

    def open(self) -> None:
        r"""Opens the source, and begins.

        Raises:
            OSError: If the source is not there.
            ValueError: If the order of its taxels is not known to be that of the layout.
        """
        self._load()
        frames = self.stream.subscribe(self._policy)
        self.stream.open()
        self._worker = threading.Thread(target=self._work, args=(frames,), daemon=True)
        self._worker.start()

    def _load(self) -> None:
        # What a recording that is begun later needs, so that its frames do not wait for it.
        with suppress(ImportError):  # told when a recording is begun
            load_recorder(self._layout)

    def run(
        self, seconds: float | None = None, on_status: Callable[[Status], None] | None = None
    ) -> None:
        r"""Runs until the source ends, the time is over, or :meth:`stop` is called.

        Args:
            seconds (float, optional): How long: from the first frame on if it comes meanwhile, else
                from this call.
            on_status (callable, optional): Called with a :class:`Status` about twice a second.

        Raises:
            Exception: What a callback, the model or the source raised.
        """
        start, limit = time.perf_counter(), math.inf if seconds is None else seconds
        while not self._ended.is_set():
            left = limit - min(time.perf_counter() - start, self.stream.seconds)
            if left <= 0 and not self._waits_for_recorder(left):
                break
            if self._ended.wait(min(max(left, _POLL_SECONDS), _STATUS_SECONDS)):
                break
            self._tell_status(on_status)
        self._tell_status(on_status)
        if self._error is not None:
            raise self._error

    def _waits_for_recorder(self, left: float) -> bool:
        # Frames that are on the way belong to a recording of so many seconds.
        recorder = self.recorder
        return (
            recorder is not None
            and recorder.max_seconds is not None
            and recorder.frames > 0
            and not recorder.is_over
            and recorder.error is None
            and left > -LATE_SECONDS
            and self.stream.state not in ("ended", "closed")
        )

    def stop(self) -> None:
        r"""Ends :meth:`run`; from any thread or callback."""
        self._ended.set()

    def close(self) -> None:
        r"""Ends everything; the recorder writes what is left. May be called again.

        Raises:
            OSError: As :meth:`stop_recording`.
        """
        self.stop()
        try:
            self.stream.close()
            if self._worker is not None and self._worker is not threading.current_thread():
                self._worker.join()
        finally:
            try:
                self.stop_recording()
            finally:
                if self.viewer is not None:
                    self.viewer.close()

    def __enter__(self) -> Self:
        try:
            self.open()
        except BaseException:
            self.close()
            raise
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.stream.source!r}, judge={self._judge!r})"

    def _work(self, frames: Subscription) -> None:
        try:
            for callback in self.callbacks:
                callback.on_start(self)
            for frame in frames:
                self._take(self._newest(frame, frames))
        except BaseException as error:
            self._error = error
        finally:
            try:
                for callback in self.callbacks:
                    callback.on_end(self)
            except BaseException as error:
                self._error = self._error or error
            self._ended.set()

    def _newest(self, frame: LiveFrame, frames: Subscription) -> LiveFrame:
        # A model of windows sees the frames between as well.
        while self._policy == "drop_oldest" and not self._ended.is_set():
            newer = frames.poll()
            if newer is None:
                break
            self._judged(frame, wanted=False)
            frame = newer
        return frame

    def _take(self, frame: LiveFrame) -> None:
        for callback in self.callbacks:
            callback.on_frame(self, frame)
        if self._rest is not None and frame.time >= self._next_drift:
            self._next_drift = frame.time + _DRIFT_SECONDS
            self._rest.drift(frame)
        judgement = self._judged(frame)
        if judgement is None:
            return
        self.judged += 1
        self.judgement = judgement
        self._latencies.append(judgement.latency["total"])
        with self._lock:
            if self.recorder is not None:
                self.recorder.judgement(judgement)
        if self.viewer is not None:
            self.viewer.judgement(judgement)
        for callback in self.callbacks:
            callback.on_judgement(self, judgement)

    def _judged(self, frame: LiveFrame, wanted: bool = True) -> Judgement | None:
        if self._tares and self._rest is not None:
            if not self._rest.add(frame):
                return None
            frame = replace(frame, tactile=self._rest.relative(frame))
        return None if self._judge is None else self._judge(frame, wanted=wanted)

    def _rest_event(self, when: float, kind: str, text: str) -> None:
        self._note = "" if kind == "rest" else text
        with self._lock:
            if self.recorder is not None:
                self.recorder.rest = _value(self._rest)
                self.recorder.event(kind, text)
        if self.viewer is not None:
            self.viewer.rest = _value(self._rest)
            self.viewer.note(text)

    def _tell_status(self, on_status: Callable[[Status], None] | None) -> None:
        health = self.stream.health()
        for callback in self.callbacks:
            callback.on_health(self, health)
        recorder, rest = self.recorder, self._rest
        if recorder is not None and recorder.error is not None:
            self.stop_recording()  # raises it
        if on_status is None:
            return
        recorded = None if recorder is None else recorder.frames
        opened = None if recorder is None else recorder.annotation
        if self.viewer is not None:
            self.viewer.annotation = opened
        if rest is not None and not rest.ready:
            on_status(Status(health, None, None, recorded, rest.status(), opened))
        else:
            kept = list(self._latencies)
            latency = statistics.median(kept) if kept else None
            notes = [self._note, "" if self._judge is None else self._judge.note]
            note = "; ".join(filter(None, notes))
            on_status(Status(health, self.judgement, latency, recorded, note, opened))


def _value(rest: Rest | None) -> np.ndarray | None:
    return rest.value if rest is not None and rest.ready else None
