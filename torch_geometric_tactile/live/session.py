r"""A source, and all that is done with its frames."""

import threading
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple, Self

from torch_geometric_tactile.live.callback import Callback
from torch_geometric_tactile.live.health import Health
from torch_geometric_tactile.live.judge import Judge, Judgement
from torch_geometric_tactile.live.latencies import Latencies
from torch_geometric_tactile.live.recorder import Recorder
from torch_geometric_tactile.live.rest import Rest
from torch_geometric_tactile.live.source import Source
from torch_geometric_tactile.live.stream import Policy, Stream
from torch_geometric_tactile.live.subscription import StreamEnded, Subscription
from torch_geometric_tactile.live.taxel_map import TaxelMap
from torch_geometric_tactile.typing import PathLike

if TYPE_CHECKING:
    from torch_geometric_tactile.live.viewer import Viewer
    from torch_geometric_tactile.sensors import TaxelLayout

_HEALTH_SECONDS = 0.5


class Status(NamedTuple):
    r"""What a session tells about twice a second: the state of its stream, what the model said
    last, the median latency of the last judgements in seconds, how many frames the recorder has
    (:obj:`None` if none runs), and what has to be known, such as why the rest is refused.
    """

    health: Health
    judgement: Judgement | None
    latency: float | None
    recorded: int | None
    note: str

    def line(self) -> str:
        r"""Returns it on one line."""
        parts = [self.health.line()]
        if self.judgement is not None:
            parts.append(self.judgement.describe())
        if self.latency is not None:
            parts.append(f"latency {1000 * self.latency:.1f} ms")
        if self.recorded is not None:
            parts.append(f"recorded {self.recorded}")
        if self.note:
            parts.append(self.note)
        return "  ".join(parts)


class LiveSession:
    r"""A source whose frames are judged, recorded and shown, each without harm to the others: the
    recorder has every frame, and the model and the viewer have the newest.

    A model whose readings are tared needs the sensor at rest first: see :class:`Rest`.

    Args:
        source (Source): Where frames come from.
        judge (Judge, optional): What tells their labels.
        rest (Rest, optional): What measures the sensor at rest; that of the judge if left out.
        viewer (Viewer, optional): What shows them, of the stream :obj:`session.stream`; see
            :meth:`view`.
        taxel_map (TaxelMap, optional): From the taxels of the source to those of the layout.
        layout (TaxelLayout, optional): The taxels, for recorder and viewer.
        policy (str, optional): Which frames are judged: :obj:`"newest"`, or :obj:`"all"`, which
            ends with an error if they come faster than they are judged. By default the newest, and
            all for a model that needs the frames before.
        callbacks (sequence of Callback): Your own code.

    Examples:
        >>> session = LiveSession(open_source("ws://127.0.0.1:5000"), judge=Judge("slip.onnx"))
        ... # doctest: +SKIP
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
        taxel_map: TaxelMap | None = None,
        layout: "TaxelLayout | None" = None,
        policy: Policy | None = None,
        callbacks: Sequence[Callback] = (),
    ) -> None:
        self.stream = Stream(source, taxel_map=taxel_map)
        self.judge = judge
        self.rest = rest if rest is not None or judge is None else judge.rest
        self.layout = layout
        self.callbacks = list(callbacks)
        self.judged = 0
        self.judgement: Judgement | None = None
        self.recorder: Recorder | None = None
        self.viewer: Viewer | None = None
        self.note = ""
        self._latencies = Latencies()
        needs_all = judge is not None and judge.needs_all
        self._policy: Policy = policy or ("all" if needs_all else "newest")
        self._worker: threading.Thread | None = None
        self._subscription: Subscription | None = None
        self._error: BaseException | None = None
        self._ended = threading.Event()
        self._lock = threading.RLock()

    def view(self, host: str = "127.0.0.1", port: int = 0) -> str:
        r"""Starts the viewer, and returns the address of its page. Call it before :meth:`open`, to
        see the first frame.

        Args:
            host (str): Address to serve at.
            port (int): Its port; any free one if zero.
        """
        from torch_geometric_tactile.live.viewer import Viewer

        self.viewer = Viewer(self.stream, self.layout, host=host, port=port)
        self.viewer.on_tare = self.tare
        self.viewer.on_record = self._toggle_recording
        self.viewer.start()
        return self.viewer.url

    def record(self, path: PathLike, label: str | None = None, overwrite: bool = False) -> None:
        r"""Records from now on.

        Args:
            path (str or PathLike): The file; its suffix says the format.
            label (str, optional): What the recording is an example of.
            overwrite (bool): Whether it may replace a file.

        Raises:
            FileExistsError: If there is such a file.
            ValueError: If a recorder runs.
        """
        with self._lock:
            if self.recorder is not None:
                raise ValueError(f"a recorder runs: stop that of '{self.recorder.path}' first")
            recorder = Recorder(
                path, self.stream, layout=self.layout, label=label, overwrite=overwrite
            )
            recorder.start()
            self.recorder = recorder
            self._show_recording()

    def stop_recording(self) -> Path | None:
        r"""Ends the recording, and returns its file, if there was one.

        Raises:
            OSError: If something could not be written; what could is kept.
            StreamOverflow: If frames came faster than they could be written.
        """
        with self._lock:
            recorder, self.recorder = self.recorder, None
            self._show_recording()
        if recorder is None:
            return None
        recorder.close()
        return Path(recorder.path)

    def tare(self) -> None:
        r"""Measures the rest anew, of the frames that come now."""
        if self.rest is None:
            self._tell("nothing here needs a rest")
            return
        self.rest.retare()
        self._event("tare", "asked for")

    def open(self) -> None:
        r"""Opens the source, and begins.

        Raises:
            OSError: If the source is not there.
        """
        self._subscription = self.stream.subscribe(self._policy)
        self.stream.open()
        self._worker = threading.Thread(target=self._work, name="tactile-session", daemon=True)
        self._worker.start()

    def run(
        self, seconds: float | None = None, on_status: Callable[[Status], None] | None = None
    ) -> None:
        r"""Runs until the source ends, the time is over, or :meth:`stop` is called.

        Args:
            seconds (float, optional): How long.
            on_status (callable, optional): Called with a :class:`Status` about twice a second.

        Raises:
            Exception: What a callback, the model or the source raised.
        """
        stop = None if seconds is None else time.monotonic() + seconds
        while not self._ended.is_set():
            left = (
                _HEALTH_SECONDS if stop is None else min(_HEALTH_SECONDS, stop - time.monotonic())
            )
            if left <= 0 or self._ended.wait(left):
                break
            self._tell_status(on_status)
        self._tell_status(on_status)
        if self._error is not None:
            raise self._error

    def stop(self) -> None:
        r"""Ends :meth:`run`; from any thread or callback."""
        self._ended.set()

    def close(self) -> None:
        r"""Ends everything: the recorder writes what is left. Does nothing if it was called before.

        Raises:
            OSError: As :meth:`stop_recording`.
        """
        self._ended.set()
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
        return f"{type(self).__name__}({self.stream.source!r}, judge={self.judge!r})"

    def _work(self) -> None:
        assert self._subscription is not None
        try:
            for callback in self.callbacks:
                callback.on_start(self)
            for frame in self._subscription:
                self._take(frame)
        except BaseException as error:
            self._error = error
        finally:
            try:
                for callback in self.callbacks:
                    callback.on_end(self)
            except BaseException as error:
                self._error = self._error or error
            self._ended.set()

    def _take(self, frame: LiveFrame) -> None:
        for callback in self.callbacks:
            callback.on_frame(self, frame)
        if self.rest is not None and not self.rest.ready:
            self._rest(frame)
            return
        judgement = None if self.judge is None else self.judge(frame)
        if judgement is None:
            return
        self.judged += 1
        self.judgement = judgement
        self._latencies.add(judgement.latency)
        with self._lock:
            if self.recorder is not None:
                self.recorder.judgement(judgement)
        if self.viewer is not None:
            self.viewer.judgement(judgement)
        for callback in self.callbacks:
            callback.on_judgement(self, judgement)
