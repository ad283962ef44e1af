r"""Live sessions: a source with a model, a recorder and a viewer."""

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
from torch_geometric_tactile.live.callback import Callback
from torch_geometric_tactile.live.judge import Judge, Judgement
from torch_geometric_tactile.live.recorder import LATE_SECONDS, Recorder, preload_recorder
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
_DRIFT_SECONDS = 0.25  # time between two frames whose distance from the rest is measured
_NUM_LATENCIES = 500
_POLL_SECONDS = 0.02


class LiveSession:
    r"""Runs a model on the frames of a source, records the frames and shows them. These tasks are
    independent: the recorder gets every frame, while the model and the viewer get the newest frame.

    A model that measures each session, or the option :obj:`tare`, needs the sensor at rest first
    (see :class:`Rest`). Predictions start when the rest is ready.

    Args:
        source (Source): The source of the frames.
        judge (Judge, optional): The model that predicts labels.
        rest (Rest, optional): The object that measures the sensor at rest. By default the rest of
            the judge.
        tare (bool): Whether to subtract the rest from the readings, for a model whose training data
            were tared (such as with :obj:`AllegroUSkin(tare="hover")`).
        taxel_map (TaxelMap or str, optional): Map from the taxels of the source to the taxels of
            the layout. By default the map of this package for the sensor and the layout, or for the
            layout of the model (see :class:`Stream`). :obj:`"none"` keeps the order of the source.
        layout (TaxelLayout, str or PathLike, optional): The layout, for recorder and viewer.
        policy (str, optional): The frames that the model judges: :obj:`"newest"`,
            :obj:`"drop_oldest"` or :obj:`"all"` (see :meth:`Judge.follow`). By default only the
            newest frame is judged. For a windowed model, the frames in between still enter the
            window.
        callbacks (sequence of Callback): Callbacks of the session.

    Attributes:
        stream (Stream): The stream, for further subscribers.
        judged (int): Number of judgements.
        judgement (Judgement, optional): The last judgement.
        recorder (Recorder, optional): The recorder, while a recording runs.
        viewer (Viewer, optional): The viewer, if :meth:`view` was called.

    Raises:
        ValueError: If :obj:`tare` is set without a rest, or with a model that measures the rest.

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
            raise ValueError("'rest' must be given, since 'tare' subtracts it (got None)")
        model_measures_rest = judge is not None and judge.info["rest"] is not None
        need(
            not tare or not model_measures_rest,
            "'tare' must be false: the model itself measures the rest",
        )
        if judge is not None:
            judge.relative = tare
        if layout is not None:
            from torch_geometric_tactile.sensors import as_layout

            layout = as_layout(layout)
        target_order: TaxelLayout | TaxelOrder | None = layout
        if target_order is None and judge is not None:
            target_order = TaxelOrder(judge.info["layout"], judge.info["num_taxels"])
        if isinstance(taxel_map, str):
            need(taxel_map == "none", "'taxel_map' must be a TaxelMap or 'none'", taxel_map)
            taxel_map, target_order = None, None
        self.stream = Stream(source, taxel_map=taxel_map, layout=target_order)
        self.callbacks = list(callbacks)
        self.judged = 0
        self.judgement: Judgement | None = None
        self.recorder: Recorder | None = None
        self.viewer: Viewer | None = None
        self._judge, self._layout, self._subtracts_rest = judge, layout, tare
        self._rest = rest if tare or (judge is not None and judge.measures_rest) else None
        self._next_drift = 0.0
        takes_windows = judge is not None and judge.length > 1
        self._policy: Policy = policy or ("drop_oldest" if takes_windows else "newest")
        self._latencies: deque[float] = deque(maxlen=_NUM_LATENCIES)
        self._note = ""
        self._worker: threading.Thread | None = None
        self._error: BaseException | None = None
        self._ended = threading.Event()
        self._lock = threading.RLock()  # guards `recorder`
        if self._rest is not None:
            self._rest.listeners.append(self._handle_rest_event)

    def view(self, host: str = "127.0.0.1", port: int = 0) -> str:
        r"""Starts the viewer, and returns the address of its page. Call it before :meth:`open` to
        see the first frame.

        Args:
            host (str): Address to listen on.
            port (int): Port to listen on; any free port if 0.
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
        r"""Starts a recording, which contains the frames after this call. Call it before
        :meth:`open` to record the first frame.

        Args:
            path (str or PathLike): The file. Its suffix selects the format.
            label (str or int, optional): Label of the recording.
            overwrite (bool): Whether to replace an existing file.
            max_seconds (float, optional): Seconds from the first frame to the end of the recording.

        Raises:
            FileExistsError: If the file exists.
            ValueError: If a recording is running.
        """
        # Before the lock is taken, since importing is slow and predictions must not wait for it.
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
                raise ValueError(f"a recording to '{self.recorder.path}' is running: stop it first")
            recorder.rest = _rest_value(self._rest)
            recorder.start()
            self.recorder = recorder
            if self.viewer is not None:
                self.viewer.recording = True

    def stop_recording(self) -> Path | None:
        r"""Ends the recording, and returns its path, or :obj:`None` without a recording.

        Raises:
            OSError: If a frame could not be written; earlier frames are kept.
            StreamOverflow: If frames arrived faster than they could be written.
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
        r"""Ends the recording, or starts one in the current folder, named by the present time.
        Returns the path of the recording.

        Raises:
            OSError: As for :meth:`stop_recording`.
        """
        with self._lock:
            if self.recorder is not None:
                return self.stop_recording()
        path = Path(f"{datetime.now():%Y-%m-%d_%H-%M-%S}.mcap")
        self.record(path)
        return path

    def tare(self) -> None:
        r"""Measures the rest again from the next frames, for the model and the viewer."""
        if self._rest is not None:
            self._rest.retare()
        else:
            self._handle_rest_event(math.nan, "retare", "the viewer measures the rest again")

    def open(self) -> None:
        r"""Opens the source and starts the session.

        Raises:
            OSError: If the source is not available.
            ValueError: If its taxel order may differ from the order of the layout.
        """
        self._preload()
        frames = self.stream.subscribe(self._policy)
        self.stream.open()
        self._worker = threading.Thread(target=self._run_worker, args=(frames,), daemon=True)
        self._worker.start()

    def _preload(self) -> None:
        # For recordings that start later, so that their first frames do not wait for imports.
        with suppress(ImportError):  # raised when a recording starts
            preload_recorder(self._layout)

    def run(
        self, seconds: float | None = None, on_status: Callable[[Status], None] | None = None
    ) -> None:
        r"""Runs until the source ends, the time limit is reached, or :meth:`stop` is called.

        Args:
            seconds (float, optional): Time limit. It counts from the first frame if the frame
                arrives during the call, else from the call.
            on_status (callable, optional): Called with a :class:`Status` about twice a second.

        Raises:
            Exception: The first error of a callback, the model or the source.
        """
        start, limit = time.perf_counter(), math.inf if seconds is None else seconds
        while not self._ended.is_set():
            remaining = limit - min(time.perf_counter() - start, self.stream.seconds)
            if remaining <= 0 and not self._waits_for_recorder(remaining):
                break
            if self._ended.wait(min(max(remaining, _POLL_SECONDS), _STATUS_SECONDS)):
                break
            self._report_status(on_status)
        self._report_status(on_status)
        if self._error is not None:
            raise self._error

    def _waits_for_recorder(self, remaining: float) -> bool:
        # Frames that are still on their way belong to a recording with a time limit.
        recorder = self.recorder
        return (
            recorder is not None
            and recorder.max_seconds is not None
            and recorder.frames > 0
            and not recorder.is_over
            and recorder.error is None
            and remaining > -LATE_SECONDS
            and self.stream.state not in ("ended", "closed")
        )

    def stop(self) -> None:
        r"""Ends :meth:`run`. May be called from any thread or callback."""
        self._ended.set()

    def close(self) -> None:
        r"""Closes the source, the recorder and the viewer. The recorder writes its remaining frames
        first. It is safe to call this twice.

        Raises:
            OSError: As for :meth:`stop_recording`.
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

    def _run_worker(self, frames: Subscription) -> None:
        try:
            for callback in self.callbacks:
                callback.on_start(self)
            for frame in frames:
                self._process_frame(self._skip_to_newest(frame, frames))
        except BaseException as error:
            self._error = error
        finally:
            try:
                for callback in self.callbacks:
                    callback.on_end(self)
            except BaseException as error:
                self._error = self._error or error
            self._ended.set()

    def _skip_to_newest(self, frame: LiveFrame, frames: Subscription) -> LiveFrame:
        # The frames in between enter the window of a windowed model.
        while self._policy == "drop_oldest" and not self._ended.is_set():
            newer = frames.poll()
            if newer is None:
                break
            self._judge_frame(frame, predict=False)
            frame = newer
        return frame

    def _process_frame(self, frame: LiveFrame) -> None:
        for callback in self.callbacks:
            callback.on_frame(self, frame)
        if self._rest is not None and frame.time >= self._next_drift:
            self._next_drift = frame.time + _DRIFT_SECONDS
            self._rest.drift(frame)
        judgement = self._judge_frame(frame)
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

    def _judge_frame(self, frame: LiveFrame, predict: bool = True) -> Judgement | None:
        if self._subtracts_rest and self._rest is not None:
            if not self._rest.add(frame):
                return None
            frame = replace(frame, tactile=self._rest.relative(frame))
        return None if self._judge is None else self._judge(frame, predict=predict)

    def _handle_rest_event(self, time: float, kind: str, text: str) -> None:
        self._note = "" if kind == "rest" else text
        with self._lock:
            if self.recorder is not None:
                self.recorder.rest = _rest_value(self._rest)
                self.recorder.event(kind, text)
        if self.viewer is not None:
            self.viewer.rest = _rest_value(self._rest)
            self.viewer.note(text)

    def _report_status(self, on_status: Callable[[Status], None] | None) -> None:
        health = self.stream.health()
        for callback in self.callbacks:
            callback.on_health(self, health)
        recorder, rest = self.recorder, self._rest
        if recorder is not None and recorder.error is not None:
            self.stop_recording()  # raises the error
        if on_status is None:
            return
        num_recorded = None if recorder is None else recorder.frames
        annotation = None if recorder is None else recorder.annotation
        if self.viewer is not None:
            self.viewer.annotation = annotation
        if rest is not None and not rest.ready:
            on_status(Status(health, None, None, num_recorded, rest.status(), annotation))
        else:
            latencies = list(self._latencies)
            latency = statistics.median(latencies) if latencies else None
            notes = [self._note, "" if self._judge is None else self._judge.note]
            note = "; ".join(filter(None, notes))
            on_status(Status(health, self.judgement, latency, num_recorded, note, annotation))


def _rest_value(rest: Rest | None) -> np.ndarray | None:
    return rest.value if rest is not None and rest.ready else None
