r"""The viewer's page, and what each open one is sent."""

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

_RATE = 30.0  # frames per second
_LOOK = 1 / 120  # seconds between two looks for a new frame
_QUIET = 0.25  # seconds after which a page is told that there is none
_FACTS = 0.2  # seconds between two messages with the health of the stream
_LEAD = 0.004  # seconds that a sleep may be late
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
    r"""The mean of the first second, whatever it holds: what is shown is only shown. Frames of
    another shape begin it anew.
    """

    def __init__(self) -> None:
        super().__init__(1.0)
        self.min_frames, self.max_movement = 1, math.inf

    def add(self, frame: LiveFrame) -> bool:
        r"""As of :class:`Rest`."""
        if self.shape not in (None, frame.tactile.shape):
            self.retare()
        return super().add(frame)


class ViewerClient:
    r"""Sends one page the newest frame, and the next one only after the page has shown it: however
    slow the page is, nothing waits in between, and what it shows is new.
    """

    def __init__(self, socket: Any, viewer: "Viewer", turn: asyncio.Lock) -> None:
        self._socket, self._viewer, self._turn = socket, viewer, turn
        self._subscription = viewer.stream.subscribe("newest")
        self._ended = False
        self._gone = False
        self._shown = asyncio.Event()
        self._shown.set()
        self._scene: Scene | None = None
        self._channels = 0
        self._pose: np.ndarray | None = None
        self._sent: LiveFrame | None = None  # under way
        self._seen: LiveFrame | None = None  # on the screen
        self._kept: LiveFrame | None = None  # until the page has the layout
        self._age = self._oldest = float("nan")
        self._last_note = 0
        self._facts_due = 0.0
        self._calls: set[asyncio.Task[None]] = set()
        self._waiting: dict[str, tuple[Any, ...]] = {}  # what each button asks for, not yet begun

    async def run(self) -> None:
        r"""Serves the page until it is closed."""
        listener = asyncio.create_task(self._listen())
        try:
            due = 0.0
            while True:
                await self._shown.wait()
                if self._gone:
                    return
                self._shown.clear()
                await asyncio.sleep(max(0.0, due - time.perf_counter()))
                message = await self._next()
                due = time.perf_counter() + 1 / _RATE - _LEAD
                await self._socket.send(message)
        finally:
            self._subscription.close()
            listener.cancel()

    async def _listen(self) -> None:
        try:
            async for text in self._socket:
                self._take(_parsed(text))
        finally:
            self._gone = True
            self._shown.set()

    def _take(self, message: dict[str, Any]) -> None:
        kind = message.get("kind")
        if kind == "shown":
            self._note_age()
            self._shown.set()
        elif kind == "tare":
            self._call(kind, self._viewer._press_tare)
        elif kind == "record":
            self._call(kind, self._viewer._press_record, bool(message.get("on")))

    def _call(self, kind: str, *call: Any) -> None:
        # Of many presses of a button, one waits: the last.
        waits, self._waiting[kind] = kind in self._waiting, call
        if not waits:
            task = asyncio.create_task(self._called(kind))
            self._calls.add(task)
            task.add_done_callback(self._calls.discard)

    async def _called(self, kind: str) -> None:
        # In a thread, as what the caller does for a button must not stop the picture; in order.
        async with self._turn:
            await asyncio.to_thread(*self._waiting.pop(kind))

    def _note_age(self) -> None:
        if self._sent is None:
            return
        now = time.perf_counter_ns()
        self._age = (now - self._sent.received) / 1e6
        if self._seen is not None:
            self._oldest = (now - self._seen.received) / 1e6
        self._seen, self._sent = self._sent, None

    async def _next(self) -> bytes:
        quiet = time.perf_counter() + _QUIET
        while True:
            frame = self._newest() or self._kept
            if frame is not None:
                return await self._picture(frame)
            if time.perf_counter() >= quiet or self._gone:
                return pack_message({"kind": "facts", **self._facts()})
            await asyncio.sleep(_LOOK)

    def _newest(self) -> LiveFrame | None:
        if self._ended:
            return None
        try:
            frame: LiveFrame = self._subscription.get(timeout=0)
        except TimeoutError:
            return None
        except Exception:  # the end, or what ended the stream: `health` and `error` tell it
            self._ended = True
            return None
        return frame

    async def _picture(self, frame: LiveFrame) -> bytes:
        num_taxels, channels = frame.tactile.shape
        scene = self._scene
        if scene is None or scene.num_taxels != num_taxels:  # the first one may take seconds
            scene = await asyncio.to_thread(self._viewer.scenes.scene, num_taxels)
        if scene is not self._scene or channels != self._channels:
            self._scene, self._channels, self._pose = scene, channels, None
            self._kept = frame
            return self._viewer._layout_message(scene, channels)
        arrays = {"tactile": self._viewer._relative(frame)}
        pose = self._viewer.scenes.pose(scene, frame.joint)
        if pose is not self._pose:
            self._pose = arrays["pose"] = pose
        self._sent, self._kept = frame, None
        head: dict[str, Any] = {"kind": "frame", "sequence": frame.sequence}
        head |= {"age": self._age, "oldest": self._oldest, "place": self._viewer._place(frame)}
        if time.perf_counter() >= self._facts_due:
            head |= self._facts()
        return pack_message(head, arrays)

    def _facts(self) -> dict[str, Any]:
        self._facts_due = time.perf_counter() + _FACTS
        facts = self._viewer._facts(self._last_note)
        if facts["notes"]:
            self._last_note = facts["notes"][-1][0]
        return facts


def _parsed(text: str | bytes) -> dict[str, Any]:
    try:
        message = json.loads(text)
    except (ValueError, RecursionError):
        return {}
    return message if isinstance(message, dict) else {}


def pack_message(head: Mapping[str, Any], arrays: Mapping[str, np.ndarray] | None = None) -> bytes:
    r"""Returns a message to the page: the number of bytes of the head (32 bits, little-endian), the
    head as JSON, and the arrays as float32, little-endian. The head names the arrays and their
    shapes in order, under :obj:`"arrays"`; they begin at a multiple of four bytes.
    """
    arrays = arrays or {}
    shapes = [[name, list(array.shape)] for name, array in arrays.items()]
    text = json.dumps(_finite({**head, "arrays": shapes}), separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    parts = [np.ascontiguousarray(array, dtype="<f4").tobytes() for array in arrays.values()]
    return b"".join([struct.pack("<I", len(text)), text, *parts])


def _finite(value: Any) -> Any:
    if isinstance(value, float | np.floating):
        return float(value) if math.isfinite(value) else None
    if isinstance(value, np.integer):
        return int(value)
    if isinstance(value, Mapping):
        return {str(key): _finite(one) for key, one in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(one) for one in value]
    return value


def answer(connection: Any, request: Any, full: bool) -> Any:
    r"""Returns the answer to who may ask for the page: the page, with a policy by which the browser
    runs and loads nothing else; :obj:`None` if the request may go on as a web socket.
    """
    path = request.path.partition("?")[0]
    if path == "/live":
        return connection.respond(503, "Too many pages are open.\n") if full else None
    if path != "/":
        return connection.respond(404, "There is only one page: /\n")
    page, policy = _page()
    response = connection.respond(200, page)
    del response.headers["Content-Type"]
    # Some browsers do not count a web socket of the same host as 'self'.
    policy += f"; connect-src 'self' ws://{request.headers['Host']}"
    response.headers.update(_HEADERS | {"Content-Security-Policy": policy})
    return response


@cache
def _page() -> tuple[str, str]:
    # The page, and a policy under which nothing runs and nothing is loaded but what is in it.
    page = files(__package__).joinpath("viewer.html").read_text(encoding="utf-8")
    script, style = (
        " ".join(_digest(text) for text in re.findall(rf"<{tag}>(.*?)</{tag}>", page, re.DOTALL))
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
    return page, "; ".join(f"{name} {value}" for name, value in rules.items())


def _digest(text: str) -> str:
    return f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'"
