r"""The page of the viewer, and the messages to each open page."""

import asyncio
import base64
import hashlib
import json
import math
import re
import struct
import time
from collections.abc import Mapping
from functools import cache
from importlib.resources import files
from typing import TYPE_CHECKING, Any

import numpy as np

from torch_geometric_tactile.data.live_frame import LiveFrame
from torch_geometric_tactile.live._viewer.scene import Scene
from torch_geometric_tactile.live.rest import Rest

if TYPE_CHECKING:
    from torch_geometric_tactile.live.viewer import Viewer

_MAX_RATE = 30.0  # frames per second
_POLL_SECONDS = 1 / 120
_QUIET_SECONDS = 0.25  # if no frame arrives for this time, the state is sent alone
_STATE_SECONDS = 0.2  # time between two messages with the state of the stream
_SLEEP_MARGIN = 0.004  # a sleep may end late by this time
_HEADERS = {
    "Content-Type": "text/html; charset=utf-8",
    "Cache-Control": "no-store",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
}


class FirstSecond(Rest):
    r"""The mean of the first second of a stream, for display only. It is computed even if the
    sensor is touched, and starts again if the shape of the frames changes.
    """

    def __init__(self) -> None:
        super().__init__(1.0)
        self.min_frames, self.max_movement = 1, math.inf

    def add(self, frame: LiveFrame) -> bool:
        r"""Adds the next frame, as :meth:`Rest.add` does."""
        if self.shape not in (None, frame.tactile.shape):
            self.retare()
        return super().add(frame)


class ViewerClient:
    r"""Sends the newest frame to one page, and the next frame only after the page has shown it. No
    frames queue up, so a slow page still shows recent frames.

    Args:
        socket (websockets.asyncio.server.ServerConnection): The connection to the page.
        viewer (Viewer): The viewer.
        call_lock (asyncio.Lock): Lock that runs the callbacks of buttons one after another.
    """

    def __init__(self, socket: Any, viewer: "Viewer", call_lock: asyncio.Lock) -> None:
        self._socket, self._viewer, self._call_lock = socket, viewer, call_lock
        self._subscription = viewer.stream.subscribe("newest")
        self._has_ended = False
        self._is_closed = False
        self._frame_shown = asyncio.Event()
        self._frame_shown.set()
        self._scene: Scene | None = None
        self._num_channels = 0
        self._pose: np.ndarray | None = None
        self._sent_frame: LiveFrame | None = None  # sent, not confirmed yet
        self._shown_frame: LiveFrame | None = None  # confirmed by the page
        self._next_frame: LiveFrame | None = None  # waits until the page has the layout
        self._frame_age = self._replaced_age = float("nan")
        self._last_note = 0
        self._state_due = 0.0
        self._tasks: set[asyncio.Task[None]] = set()
        self._pending_calls: dict[str, tuple[Any, ...]] = {}  # one for each button

    async def run(self) -> None:
        r"""Serves the page until it is closed."""
        listener = asyncio.create_task(self._listen())
        try:
            due = 0.0
            while True:
                await self._frame_shown.wait()
                if self._is_closed:
                    return
                self._frame_shown.clear()
                await asyncio.sleep(max(0.0, due - time.perf_counter()))
                message = await self._next_message()
                due = time.perf_counter() + 1 / _MAX_RATE - _SLEEP_MARGIN
                await self._socket.send(message)
        finally:
            self._subscription.close()
            listener.cancel()

    async def _listen(self) -> None:
        try:
            async for text in self._socket:
                self._handle_message(_parse_message(text))
        finally:
            self._is_closed = True
            self._frame_shown.set()

    def _handle_message(self, message: dict[str, Any]) -> None:
        kind = message.get("kind")
        if kind == "shown":
            self._measure_age()
            self._frame_shown.set()
        elif kind == "tare":
            self._queue_call(kind, self._viewer._press_tare)
        elif kind == "record":
            self._queue_call(kind, self._viewer._press_record, bool(message.get("on")))

    def _queue_call(self, kind: str, *call: Any) -> None:
        # If a button is pressed repeatedly, only the last call is queued.
        is_queued, self._pending_calls[kind] = kind in self._pending_calls, call
        if not is_queued:
            task = asyncio.create_task(self._run_call(kind))
            self._tasks.add(task)
            task.add_done_callback(self._tasks.discard)

    async def _run_call(self, kind: str) -> None:
        # In a thread, since a slow callback must not stop the page; the lock keeps the order.
        async with self._call_lock:
            await asyncio.to_thread(*self._pending_calls.pop(kind))

    def _measure_age(self) -> None:
        if self._sent_frame is None:
            return
        now = time.perf_counter_ns()
        self._frame_age = (now - self._sent_frame.received) / 1e6
        if self._shown_frame is not None:
            self._replaced_age = (now - self._shown_frame.received) / 1e6
        self._shown_frame, self._sent_frame = self._sent_frame, None

    async def _next_message(self) -> bytes:
        deadline = time.perf_counter() + _QUIET_SECONDS
        while True:
            frame = self._newest_frame() or self._next_frame
            if frame is not None:
                return await self._frame_message(frame)
            if time.perf_counter() >= deadline or self._is_closed:
                return pack_message({"kind": "facts", **self._state_message()})
            await asyncio.sleep(_POLL_SECONDS)

    def _newest_frame(self) -> LiveFrame | None:
        if self._has_ended:
            return None
        try:
            frame: LiveFrame = self._subscription.get(timeout=0)
        except TimeoutError:
            return None
        except Exception:  # the state message contains the end or the error of the stream
            self._has_ended = True
            return None
        return frame

    async def _frame_message(self, frame: LiveFrame) -> bytes:
        num_taxels, num_channels = frame.tactile.shape
        scene = self._scene
        if scene is None or scene.num_taxels != num_taxels:  # the first scene may take seconds
            scene = await asyncio.to_thread(self._viewer.scenes.scene, num_taxels)
        if scene is not self._scene or num_channels != self._num_channels:
            self._scene, self._num_channels, self._pose = scene, num_channels, None
            self._next_frame = frame
            return self._viewer._layout_message(scene, num_channels)
        arrays = {"tactile": self._viewer._relative(frame)}
        pose = self._viewer.scenes.pose(scene, frame.joint)
        if pose is not self._pose:
            self._pose = arrays["pose"] = pose
        self._sent_frame, self._next_frame = frame, None
        head: dict[str, Any] = {"kind": "frame", "sequence": frame.sequence}
        head |= {
            "age": self._frame_age,
            "oldest": self._replaced_age,
            "place": self._viewer._replay_position(frame),
        }
        if time.perf_counter() >= self._state_due:
            head |= self._state_message()
        return pack_message(head, arrays)

    def _state_message(self) -> dict[str, Any]:
        self._state_due = time.perf_counter() + _STATE_SECONDS
        state = self._viewer._state_message(self._last_note)
        if state["notes"]:
            self._last_note = state["notes"][-1][0]
        return state


def _parse_message(text: str | bytes) -> dict[str, Any]:
    try:
        message = json.loads(text)
    except (ValueError, RecursionError):
        return {}
    return message if isinstance(message, dict) else {}


def pack_message(head: Mapping[str, Any], arrays: Mapping[str, np.ndarray] | None = None) -> bytes:
    r"""Returns a message to the page: the length of the head in bytes (32 bits, little-endian), the
    head as JSON, and the arrays as little-endian float32. The head lists the names and shapes of
    the arrays under :obj:`"arrays"`. The arrays begin at a multiple of four bytes.
    """
    arrays = arrays or {}
    shapes = [[name, list(array.shape)] for name, array in arrays.items()]
    text = json.dumps(_to_json_value({**head, "arrays": shapes}), separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    parts = [np.ascontiguousarray(array, dtype="<f4").tobytes() for array in arrays.values()]
    return b"".join([struct.pack("<I", len(text)), text, *parts])


def _to_json_value(value: Any) -> Any:
    if isinstance(value, float | np.floating):
        return float(value) if math.isfinite(value) else None
    if isinstance(value, np.integer):
        return int(value)
    if isinstance(value, Mapping):
        return {str(key): _to_json_value(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [_to_json_value(entry) for entry in value]
    return value


def page_response(connection: Any, request: Any, is_full: bool) -> Any:
    r"""Returns the response to a request that was not rejected: the page, with a security policy
    under which the browser runs and loads nothing else, or :obj:`None` if the request may continue
    as a WebSocket.
    """
    path = request.path.partition("?")[0]
    if path == "/live":
        return connection.respond(503, "Too many pages are open.\n") if is_full else None
    if path != "/":
        return connection.respond(404, "There is only one page: /\n")
    html, policy = _load_page()
    response = connection.respond(200, html)
    del response.headers["Content-Type"]
    # In some browsers, 'self' does not include a WebSocket of the same host.
    policy += f"; connect-src 'self' ws://{request.headers['Host']}"
    response.headers.update(_HEADERS | {"Content-Security-Policy": policy})
    return response


@cache
def _load_page() -> tuple[str, str]:
    # The page, and a policy that allows only the scripts and styles in it, by their hashes.
    html = files(__package__).joinpath("viewer.html").read_text(encoding="utf-8")
    script, style = (
        " ".join(_csp_hash(text) for text in re.findall(rf"<{tag}>(.*?)</{tag}>", html, re.DOTALL))
        for tag in ("script", "style")
    )
    rules = {
        "default-src": "'none'",
        "script-src": script,
        "style-src": style,
        "img-src": "data:",
        "base-uri": "'none'",
        "form-action": "'none'",
        "frame-ancestors": "'none'",
    }
    return html, "; ".join(f"{name} {value}" for name, value in rules.items())


def _csp_hash(text: str) -> str:
    return f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'"
