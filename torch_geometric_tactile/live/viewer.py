r"""The viewer of a stream: a page in the browser."""

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
    pack_message,
    page_response,
)
from torch_geometric_tactile.live._viewer.scene import Scene, Scenes
from torch_geometric_tactile.live._web_server import WebServer

if TYPE_CHECKING:
    from torch_geometric_tactile.live.judge import Judgement
    from torch_geometric_tactile.live.stream import Stream
    from torch_geometric_tactile.sensors import HandKinematics, TaxelLayout

_LOG = logging.getLogger(__name__)
_MAX_PAGES = 8
_CLOSE_SECONDS = 1.0
_MAX_NOTES = 20
_MAX_SPANS = 1000
_HEALTH_FIELDS = (
    *("state", "frames", "rate", "jitter", "lost", "corrupt", "skipped", "repeated"),
    *("reconnects", "stale_taxels", "age", "checksum"),
)


class Viewer(WebServer):
    r"""Shows a stream on a page in the browser: the hand in its pose with readings as colours and
    shear as arrows, and the label probabilities, frame rate, frame age and losses.

    The page is a single file that loads nothing from other sites. It is served only on this machine
    unless :obj:`host` is another address. Pages of other sites can neither read it nor press its
    buttons: requests are rejected if their :obj:`Host` is a foreign name or their :obj:`Origin` is
    another page. There is no password. Everyone who can connect to :obj:`host`, such as other users
    of this machine, can see the page and press its buttons.

    Each page subscribes to the newest frame separately. The next frame is sent when the page has
    shown the previous one, so a slow page skips frames, never lags, and does not slow down other
    pages. Without an open page, the viewer does nothing.

    Args:
        stream (Stream): The stream; it may be opened later.
        layout (TaxelLayout, str or PathLike, optional): The layout, its name or its file. By
            default the layout that the source names as :obj:`"sensor"`. Without a layout, taxels
            are shown in a grid by number.
        host (str): Address to listen on.
        port (int): Port to listen on; any free port if 0.
        joint (numpy.ndarray, optional): Joint angles in radians that are shown while frames have
            none. By default the angles of an open hand.
        kinematics (HandKinematics, optional): The hand that carries the layout. By default the
            Allegro hand, for layouts on its links.

    Attributes:
        on_tare (callable, optional): Called without arguments, in a separate thread, when the tare
            button is pressed. If :obj:`None`, the viewer measures the rest again.
        on_record (callable, optional): Called in the same way when the record button is pressed, to
            start or end a recording. It must set :attr:`recording`. If :obj:`None`, there is no
            record button.
        rest (numpy.ndarray, optional): Readings :math:`(N, C)` that are subtracted from the shown
            readings. If :obj:`None`, the mean of the first second of the page is subtracted.
        annotation (str, optional): The current annotation of a recording, as in
            :attr:`Recorder.annotation`. Annotations of a replayed recording are shown in lanes.

    Raises:
        ImportError: If websockets is missing.
        ValueError: If the layout, the hand and the joint angles do not fit together.

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
        super().__init__(
            host, port, name="the viewer", max_clients=_MAX_PAGES, close_timeout=_CLOSE_SECONDS
        )
        self.stream = stream
        self.on_tare: Callable[[], object] | None = None
        self.on_record: Callable[[], object] | None = None
        self.rest: np.ndarray | None = None
        self.annotation: str | None = None
        self.scenes = Scenes(stream, layout, joint, kinematics, self.note)
        self._call_lock = asyncio.Lock()
        self._first_second = FirstSecond()
        self._judgement: Judgement | None = None
        self._recording_since: float | None = None
        self._notes: deque[tuple[int, float, str]] = deque(maxlen=_MAX_NOTES)
        self._num_notes = 0

    def start(self) -> None:
        r"""Starts to serve in a background thread. Does nothing if the viewer is running.

        Raises:
            OSError: If the port is in use or the address does not belong to this machine.
        """
        self.scenes.prepare()
        self._call_lock = asyncio.Lock()
        super().start()
        if not _is_local(self.host):
            _LOG.warning(
                "the viewer is served on '%s': everyone who can connect to this address can see it "
                "and press its buttons",
                self.host,
            )

    @property
    def url(self) -> str:
        r"""Address of the page. Its port is known once the viewer has started."""
        host = "127.0.0.1" if self.host in ("", "0.0.0.0") else self.host
        host = "[::1]" if host == "::" else f"[{host}]" if ":" in host else host
        return f"http://{host}:{self.port}/"

    def judgement(self, judgement: "Judgement") -> None:
        r"""Shows the prediction of a model until the next prediction.

        Args:
            judgement (Judgement): The judgement.
        """
        self._judgement = judgement

    def note(self, text: str) -> None:
        r"""Shows a line of text, such as an event or a warning.

        Args:
            text (str): The text.
        """
        self._num_notes += 1
        self._notes.append((self._num_notes, time.time(), text))

    @property
    def recording(self) -> bool:
        r"""Whether the page shows that a recording is running."""
        return self._recording_since is not None

    @recording.setter
    def recording(self, recording: bool) -> None:
        if recording != self.recording:
            self._recording_since = time.perf_counter() if recording else None

    async def _serve_client(self, connection: Any) -> None:
        await ViewerClient(connection, self, self._call_lock).run()

    def _respond(self, connection: Any, request: Any, is_full: bool) -> Any:
        return page_response(connection, request, is_full)

    def _layout_message(self, scene: Scene, channels: int) -> bytes:
        head = {
            "kind": "layout",
            "source": self.stream.source.name,
            "unit": self.stream.meta.get("unit"),
            "channels": channels,
            "spans": self._spans(),
            **scene.description(),
        }
        return pack_message(head, scene.arrays())

    def _annotated_recording(self) -> Recording | None:
        recording: Recording | None = getattr(self.stream.source, "recording", None)
        has_annotations = recording is not None and recording.annotations and recording.duration
        return recording if has_annotations else None

    def _spans(self) -> list[list[Any]]:
        # Annotations of a replayed recording: start and end as fractions of it, and label.
        recording = self._annotated_recording()
        if recording is None:
            return []
        start, duration = float(recording.time[0]), recording.duration
        annotations = recording.annotations[:_MAX_SPANS]
        return [
            [(a.start - start) / duration, (a.end - start) / duration, a.label] for a in annotations
        ]

    def _replay_position(self, frame: LiveFrame) -> float | None:
        # Position of a frame in a replayed recording, from 0 to 1.
        recording = self._annotated_recording()
        if recording is None:
            return None
        time = recording.time[frame.sequence % recording.num_frames]
        return float(time - recording.time[0]) / recording.duration

    def _relative(self, frame: LiveFrame) -> np.ndarray:
        if self.rest is not None and np.shape(self.rest) == frame.tactile.shape:
            relative: np.ndarray = (frame.tactile - self.rest).astype(np.float32)
            return relative
        return self._first_second.relative(frame)

    def _state_message(self, since_note: int) -> dict[str, Any]:
        # Everything that changes except for the readings.
        since, health = self._recording_since, self.stream.health()
        error = getattr(self.stream, "error", None)
        error_text = None if error is None else str(error) or type(error).__name__
        rest_state = "measured" if self._first_second.ready else "measuring"
        return {
            "source": self.stream.source.name,
            "health": {
                **{n: getattr(health, n, None) for n in _HEALTH_FIELDS},
                "error": error_text,
            },
            "rest": rest_state if self.rest is None else "given",
            "recording": None if since is None else time.perf_counter() - since,
            "can_record": self.on_record is not None,
            "annotation": self.annotation,
            "judgement": _judgement_message(self._judgement),
            "notes": [note for note in tuple(self._notes) if note[0] > since_note],
        }

    def _press_tare(self) -> None:
        # Calls `on_tare`, or measures the rest of the viewer again.
        if self.on_tare is None:
            self.rest = None
            self._first_second.retare()
            self.note("Measuring the rest again")
        else:
            self._run_callback(self.on_tare, "The tare")

    def _press_record(self, record: bool) -> None:
        # Pages may be late: calls `on_record` only if the state differs from the requested one.
        if self.on_record is not None and record != self.recording:
            self._run_callback(self.on_record, "The recording")

    def _run_callback(self, callback: Callable[[], object], name: str) -> None:
        try:
            callback()
        except Exception as error:  # an error of the caller is shown on the page
            _LOG.warning("%s failed: %s", name, error)
            self.note(f"{name} failed: {error}")

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.url!r})"


def _judgement_message(judgement: "Judgement | None") -> dict[str, Any] | None:
    if judgement is None:
        return None
    return {
        "label": _label_text(judgement),
        "task": judgement.task,
        "names": list(judgement.class_names),
        "probability": np.asarray(judgement.probability, dtype=float).tolist(),
        "latency": (judgement.finished - judgement.received) / 1e6,
        "since": (time.perf_counter_ns() - judgement.finished) / 1e9,
    }


def _label_text(judgement: "Judgement") -> str:
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
