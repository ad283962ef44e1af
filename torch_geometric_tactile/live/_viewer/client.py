r"""One page of the viewer."""

import asyncio
import json
import time
from typing import Any

import numpy as np

from torch_geometric_tactile.data.live_frame import LiveFrame
from torch_geometric_tactile.live._viewer.message import pack_message
from torch_geometric_tactile.live._viewer.scene import Scene
from torch_geometric_tactile.live._viewer.screen import ViewerScreen

_RATE = 30.0  # frames per second
_LOOK = 1 / 120  # seconds between two looks for a new frame
_QUIET = 0.25  # seconds after which a page is told that there is none
_FACTS = 0.2  # seconds between two messages with the health of the stream
_LEAD = 0.004  # seconds that a sleep may be late


class ViewerClient:
    r"""Sends one page the newest frame, and the next one only after the page has shown it: however
    slow the page is, nothing waits in between, and what it shows is new.
    """

    def __init__(self, socket: Any, screen: ViewerScreen, turn: asyncio.Lock) -> None:
        self._socket, self._screen, self._turn = socket, screen, turn
        self._subscription = screen.stream.subscribe("newest")
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
            self._call(kind, self._screen.tare)
        elif kind == "record":
            self._call(kind, self._screen.record, bool(message.get("on")))

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
            scene = await asyncio.to_thread(self._screen.scene, num_taxels)
        if scene is not self._scene or channels != self._channels:
            self._scene, self._channels, self._pose = scene, channels, None
            self._kept = frame
            return self._screen.layout_message(scene, channels)
        arrays = {"tactile": self._screen.relative(frame)}
        pose = self._screen.pose(scene, frame.joint)
        if pose is not self._pose:
            self._pose = arrays["pose"] = pose
        self._sent, self._kept = frame, None
        head: dict[str, Any] = {"kind": "frame", "sequence": frame.sequence}
        head |= {"age": self._age, "oldest": self._oldest}
        if time.perf_counter() >= self._facts_due:
            head |= self._facts()
        return pack_message(head, arrays)

    def _facts(self) -> dict[str, Any]:
        self._facts_due = time.perf_counter() + _FACTS
        facts = self._screen.facts(self._last_note)
        if facts["notes"]:
            self._last_note = facts["notes"][-1][0]
        return facts


def _parsed(text: str | bytes) -> dict[str, Any]:
    try:
        message = json.loads(text)
    except (ValueError, RecursionError):
        return {}
    return message if isinstance(message, dict) else {}
