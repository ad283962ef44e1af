r"""The viewer: a page in the browser that shows a stream."""

import asyncio
import ipaddress
import logging
import time
from collections import deque
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile.data.live_frame import LiveFrame
from torch_geometric_tactile.data.recording import Recording
from torch_geometric_tactile.live._viewer.page import (
    FirstSecond,
    ViewerClient,
    answer,
    pack_message,
)
from torch_geometric_tactile.live._viewer.scene import Scene, Scenes
from torch_geometric_tactile.live._web_server import WebServer

if TYPE_CHECKING:
    from torch_geometric_tactile.live.judge import Judgement
    from torch_geometric_tactile.live.stream import Stream
    from torch_geometric_tactile.sensors import HandKinematics, TaxelLayout

_LOG = logging.getLogger(__name__)
_MOST_PAGES = 8
_CLOSING = 1.0  # seconds that a page is waited for
_NOTES = 20
_MOST_SPANS = 1000
_SHOWN_HEALTH = (
    *("state", "frames", "rate", "jitter", "lost", "corrupt", "skipped", "repeated"),
    *("reconnects", "stale_taxels", "age", "checksum"),
)


class Viewer(WebServer):
    r"""Shows a stream on a page in the browser: the hand in its pose, readings as colour and shear
    as arrows, label probabilities, rate, age and loss.

    The page is one file that asks nobody else for anything. It is served on this machine only,
    unless :obj:`host` says otherwise, and a page of another site cannot read it or press its
    buttons: requests whose :obj:`Host` is a foreign name, or whose :obj:`Origin` is another page's,
    are refused. There is no password: whoever may open connections to :obj:`host`, as other users
    of this machine, sees what is shown and may press the buttons.

    Each page has a subscription of its own that keeps the newest frame only, and gets it when the
    one before is on the screen: a slow page skips frames, never lags, and holds nobody up. Without
    a page open nothing is done.

    Args:
        stream (Stream): The stream; it may be opened later.
        layout (TaxelLayout, str or PathLike, optional): Where the taxels are: a layout, its name or
            its file. If left out, the one that the source names as :obj:`"sensor"`; without one,
            taxels are a grid by number.
        host (str): Address to serve on.
        port (int): Port to serve on; any free one if 0.
        joint (numpy.ndarray, optional): Joint angles in radians to show while frames carry none;
            those of an open hand if left out.
        kinematics (HandKinematics, optional): The hand that carries the layout; the Allegro hand if
            left out, for layouts of its links.

    Attributes:
        on_tare (callable, optional): Called without arguments, in a thread of its own, when the
            tare button is pressed. If :obj:`None`, the rest that is shown is measured anew.
        on_record (callable, optional): Called likewise by the record button, to begin or end a
            recording; set :attr:`recording` in it. Without it there is no such button.
        rest (numpy.ndarray, optional): What readings are shown relative to :math:`(N, C)`. While it
            is :obj:`None`, the page's first second.
        annotation (str, optional): The label that is being recorded, as of
            :attr:`Recorder.annotation`. Those of a recording that is replayed have lanes.

    Raises:
        ImportError: If websockets is missing.
        ValueError: If the layout, its hand and the joint angles do not fit.

    Examples:
        >>> from torch_geometric_tactile.live import ReplaySource, Stream, Viewer
        >>> stream = Stream(ReplaySource("grasp.h5", loop=True))
        >>> viewer = Viewer(stream, port=8000)
        >>> viewer.url
        'http://127.0.0.1:8000/'
        >>> with stream, viewer:  # doctest: +SKIP
        ...     input("Enter ends ")
    """

    def __init__(
        self,
        stream: "Stream",
        layout: "TaxelLayout | PathLike | None" = None,
        *,
        host: str = "127.0.0.1",
        port: int = 0,
        joint: np.ndarray | None = None,
        kinematics: "HandKinematics | None" = None,
    ) -> None:
        super().__init__(host, port, name="the viewer", most=_MOST_PAGES, closing=_CLOSING)
        self.stream = stream
        self.on_tare: Callable[[], object] | None = None
        self.on_record: Callable[[], object] | None = None
        self.rest: np.ndarray | None = None
        self.annotation: str | None = None
        self.scenes = Scenes(stream, layout, joint, kinematics, self.note)
        self._turn = asyncio.Lock()
        self._first = FirstSecond()
        self._judgement: Judgement | None = None
        self._recording_since: float | None = None
        self._notes: deque[tuple[int, float, str]] = deque(maxlen=_NOTES)
        self._numbers = 0

    def start(self) -> None:
        r"""Begins to serve, in a thread of its own; does nothing if it does already.

        Raises:
            OSError: If the port is taken or the address is not one of this machine.
        """
        self.scenes.prepare()
        self._turn = asyncio.Lock()
        super().start()
        if not _is_local(self.host):
            _LOG.warning(
                "the viewer is served on '%s': who reaches this address sees it and may press its "
                "buttons",
                self.host,
            )

    @property
    def url(self) -> str:
        r"""Address of the page; its port is known once it is served."""
        host = "127.0.0.1" if self.host in ("", "0.0.0.0") else self.host
        host = "[::1]" if host == "::" else f"[{host}]" if ":" in host else host
        return f"http://{host}:{self.port}/"

    def judgement(self, judgement: "Judgement") -> None:
        r"""Shows what a model says; the last one stays until the next.

        Args:
            judgement (Judgement): The judgement.
        """
        self._judgement = judgement

    def note(self, text: str) -> None:
        r"""Shows a line, such as an event or a warning.

        Args:
            text (str): The line.
        """
        self._numbers += 1
        self._notes.append((self._numbers, time.time(), text))

    @property
    def recording(self) -> bool:
        r"""Whether a recording is shown as running."""
        return self._recording_since is not None

    @recording.setter
    def recording(self, recording: bool) -> None:
        if recording != self.recording:
            self._recording_since = time.perf_counter() if recording else None

    async def _show(self, connection: Any) -> None:
        await ViewerClient(connection, self, self._turn).run()

    def _page(self, connection: Any, request: Any, full: bool) -> Any:
        return answer(connection, request, full)

    def _layout_message(self, scene: Scene, channels: int) -> bytes:
        head = {
            "kind": "layout",
            "source": self.stream.source.name,
            "unit": self.stream.meta.get("unit"),
            "channels": channels,
            "spans": self._spans(),
            **scene.head(),
        }
        return pack_message(head, scene.arrays())

    def _annotated(self) -> Recording | None:
        recording: Recording | None = getattr(self.stream.source, "recording", None)
        shows = recording is not None and recording.annotations and recording.duration
        return recording if shows else None

    def _spans(self) -> list[list[Any]]:
        # The annotations of a recording that is replayed: start and end as parts of it, and label.
        recording = self._annotated()
        if recording is None:
            return []
        first, length = float(recording.time[0]), recording.duration
        shown = recording.annotations[:_MOST_SPANS]
        return [[(a.start - first) / length, (a.end - first) / length, a.label] for a in shown]

    def _place(self, frame: LiveFrame) -> float | None:
        # Where a frame is in the recording that is replayed, from 0 to 1.
        recording = self._annotated()
        if recording is None:
            return None
        time = recording.time[frame.sequence % recording.num_frames]
        return float(time - recording.time[0]) / recording.duration

    def _relative(self, frame: LiveFrame) -> np.ndarray:
        if self.rest is not None and np.shape(self.rest) == frame.tactile.shape:
            relative: np.ndarray = (frame.tactile - self.rest).astype(np.float32)
            return relative
        return self._first.relative(frame)

    def _facts(self, since_note: int) -> dict[str, Any]:
        # What changes beside the readings.
        since, health = self._recording_since, self.stream.health()
        error = getattr(self.stream, "error", None)
        told = None if error is None else str(error) or type(error).__name__
        measured = "measured" if self._first.ready else "measuring"
        return {
            "source": self.stream.source.name,
            "health": {**{n: getattr(health, n, None) for n in _SHOWN_HEALTH}, "error": told},
            "rest": measured if self.rest is None else "given",
            "recording": None if since is None else time.perf_counter() - since,
            "can_record": self.on_record is not None,
            "annotation": self.annotation,
            "judgement": _described(self._judgement),
            "notes": [note for note in tuple(self._notes) if note[0] > since_note],
        }

    def _press_tare(self) -> None:
        # Calls `on_tare`, or measures the rest that is shown anew.
        if self.on_tare is None:
            self.rest = None
            self._first.retare()
            self.note("Rest measured anew")
        else:
            self._call(self.on_tare, "The tare")

    def _press_record(self, wanted: bool) -> None:
        # Calls `on_record`, if this would change what is recorded.
        if self.on_record is not None and wanted != self.recording:
            self._call(self.on_record, "The recording")

    def _call(self, callback: Callable[[], object], what: str) -> None:
        try:
            callback()
        except Exception as error:  # of the caller: told where the button is
            _LOG.warning("%s failed: %s", what, error)
            self.note(f"{what} failed: {error}")

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.url!r})"


def _described(judgement: "Judgement | None") -> dict[str, Any] | None:
    if judgement is None:
        return None
    return {
        "label": _shown_label(judgement),
        "task": judgement.task,
        "names": list(judgement.class_names),
        "probability": np.asarray(judgement.probability, dtype=float).tolist(),
        "latency": (judgement.finished - judgement.received) / 1e6,
        "since": (time.perf_counter_ns() - judgement.finished) / 1e9,
    }


def _shown_label(judgement: "Judgement") -> str:
    if judgement.lacks_contact:
        return judgement.label
    if np.isnan(judgement.probability).any():
        return "no answer"
    if judgement.task == "regression":
        return ""
    label: str = judgement.label
    return (label.replace(";", ", ") or "none") if judgement.task == "multilabel" else label


def _is_local(host: str) -> bool:
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"
