r"""A recording sent as XELA's server sends its frames."""

import asyncio
import json
import threading
import time
from typing import Any

import numpy as np

from torch_geometric_tactile._checks import need
from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile.data.recording import Recording
from torch_geometric_tactile.io.xela_message import XELA_VERSION
from torch_geometric_tactile.live._web_server import WebServer

_HIGHEST = 0xFFFF
_MOST_LATE = 2.0  # seconds after which a client that is too slow goes on with the present
_WAIT = 0.1
_CLOSE = 0.5  # of a client that does not read
_MOST_CLIENTS = 32


class ReplayServer(WebServer):
    r"""Replays a recording to any number of WebSocket clients in the message format of XELA's
    server, for tests without a hand.

    It begins with the first client. Each one gets :obj:`{"message": "Welcome"}` and then the
    frames, in the time of the recording; one that reads so slowly that it is 2 seconds late misses
    the frames between, as their numbers show. At the end of the recording the connections are
    closed. As with the viewer, a page of another site and more than 32 clients are refused.

    Args:
        recording (Recording, str or PathLike): The recording or its file: counts of 3 channels,
            without missing ones.
        port (int): The port; 0 takes a free one.
        speed (float): How many times as fast as it was recorded.
        loop (bool): Whether to begin again at the end; the numbers go on.
        host (str): The address to listen at.

    Attributes:
        port (int): The port that it listens at; the one that was asked for before it is started.
        clients (int): The number of clients that are connected.
        sent (int): Messages sent, to all clients together.

    Raises:
        ImportError: If the extra :obj:`live` is missing.
        OSError: If the port is taken, when it is started.
        ValueError: If the readings are no counts from 0 to 65535, or the speed is not positive.

    Examples:
        >>> import numpy as np
        >>> from torch_geometric_tactile.live import XelaSource
        >>> recording = Recording(time=np.arange(5) / 100, tactile=np.full((5, 4, 3), 30000))
        >>> with ReplayServer(recording, port=0) as server, XelaSource(server.url) as source:
        ...     source.read(timeout=1.0)[0].tactile.shape
        (4, 3)
    """

    def __init__(
        self,
        recording: Recording | PathLike,
        port: int = 5000,
        speed: float = 1.0,
        loop: bool = False,
        *,
        host: str = "127.0.0.1",
    ) -> None:
        need(speed > 0 and speed != float("inf"), "'speed' must be positive and finite", speed)
        if not isinstance(recording, Recording):
            from torch_geometric_tactile.io import read_recording

            recording = read_recording(recording)
        self._messages = _Messages(recording)
        self.speed, self.loop = speed, loop
        self.sent = 0
        self._began: float | None = None
        self._finished = False
        self._closing_down = threading.Event()
        self._ended = threading.Event()
        super().__init__(host, port, name="the server", most=_MOST_CLIENTS, closing=_CLOSE)

    @property
    def url(self) -> str:
        r"""Its address, such as :obj:`ws://127.0.0.1:5000`."""
        host = f"[{self.host}]" if ":" in self.host else self.host
        return f"ws://{host}:{self.port}"

    def wait(self, timeout: float | None = None) -> bool:
        r"""Waits for the end of the recording, and returns whether it has come.

        Args:
            timeout (float, optional): How long in seconds; without end if left out.
        """
        return self._ended.wait(timeout)

    def close(self) -> None:
        r"""Closes all connections; does nothing if it is closed."""
        self._closing_down.set()
        self._ended.set()
        super().close()

    async def _show(self, client: Any) -> None:
        now = time.perf_counter()
        if self._began is None:
            self._began = now
        first = self._next_after(now)  # before the greeting, which may take longer than a frame
        finished = False
        try:
            await client.send(json.dumps({"message": "Welcome"}))
            finished = await self._send_all(client, first)
        finally:
            self._finished = self._finished or finished
            if self._finished and self.clients == 1:  # the last one
                self._ended.set()

    async def _send_all(self, client: Any, frame: int) -> bool:
        length = self._messages.num_frames
        while self.loop or frame < length:
            late = time.perf_counter() - self._due(frame)
            if self._closing_down.is_set():
                return False
            if late < 0:
                await asyncio.sleep(min(-late, _WAIT))
            elif late > _MOST_LATE:
                frame = self._next_after(time.perf_counter())
                await asyncio.sleep(0)
            else:
                await client.send(self._messages.text(frame, self._stamp(frame)))
                self.sent += 1
                frame += 1
                await asyncio.sleep(0)  # others have their turn, also where sending never waits
        return True

    def _due(self, frame: int) -> float:
        assert self._began is not None
        return self._began + self._messages.seconds(frame) / self.speed

    def _stamp(self, frame: int) -> float:
        return time.time() - time.perf_counter() + self._due(frame)

    def _next_after(self, now: float) -> int:
        assert self._began is not None
        return self._messages.frame_at((now - self._began) * self.speed)

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.url!r}, num_frames={self._messages.num_frames})"


class _Messages:
    # The frames of a recording as texts, over and over.

    def __init__(self, recording: Recording) -> None:
        meta, tactile = recording.meta, recording.tactile
        if recording.num_frames == 0:
            raise ValueError("'recording' must hold at least one frame to be sent (got none)")
        if recording.num_channels != 3 or meta.get("unit", "count") != "count":
            raise ValueError(
                "'recording' must hold counts of 3 channels to be sent as XELA's server does (got "
                f"{recording.num_channels} channels, unit '{meta.get('unit')}')"
            )
        wrong = ~((tactile >= 0) & (tactile <= _HIGHEST) & (tactile == np.floor(tactile)))
        if wrong.any():
            frame, taxel, channel = np.argwhere(wrong)[0].tolist()
            raise ValueError(
                f"'recording' must hold whole numbers from 0 to {_HIGHEST} to be sent as XELA's "
                f"server does (got {tactile[frame, taxel, channel]} in frame {frame}, taxel "
                f"{taxel}, axis {'xyz'[channel]})"
            )
        self._counts = tactile
        self._time = recording.time - recording.time[0]
        numbers = np.asarray(recording.extra.get("sequence", np.arange(recording.num_frames)))
        ordered = numbers.ndim == 1 and numbers.dtype.kind in "iu" and (np.diff(numbers) > 0).all()
        self._numbers = numbers - numbers[0] if ordered else np.arange(recording.num_frames)
        step = self._time[-1] / max(1, len(self._time) - 1)
        self._span = float(self._time[-1] + (step or 0.01))
        self._heads, self._bounds = _heads(recording)
        self._version = str(meta.get("server_version", XELA_VERSION))

    @property
    def num_frames(self) -> int:
        return len(self._time)

    def seconds(self, frame: int) -> float:
        turn, place = divmod(frame, self.num_frames)
        return turn * self._span + float(self._time[place])

    def frame_at(self, seconds: float) -> int:
        turn, rest = divmod(max(0.0, seconds), self._span)
        return int(turn) * self.num_frames + max(
            0, int(np.searchsorted(self._time, rest, side="right")) - 1
        )

    def text(self, frame: int, stamp: float) -> str:
        # By hand, since hundreds of thousands of numbers a second take a core as JSON.
        turn, place = divmod(frame, self.num_frames)
        number = 1 + turn * (int(self._numbers[-1]) + 1) + int(self._numbers[place])
        parts = [
            f'{{"message": {number}, "time": {stamp!r}, "sensors": {len(self._heads)}, '
            f'"type": "routine", "version": {json.dumps(self._version)}'
        ]
        for i, (head, start, stop) in enumerate(
            zip(self._heads, self._bounds, self._bounds[1:], strict=False), start=1
        ):
            counts = self._counts[place, start:stop].astype(">u2")
            words = counts.tobytes().hex(",", 2).upper()
            parts.append(
                f', "{i}": {{"time": {stamp!r}, "sensor": "{i}", "data": "{words}", '
                f'"model": {head[0]}, "taxels": {stop - start}, '
                f'"integer": {counts.ravel().tolist()}, "handedness": {head[1]}}}'
            )
        return "".join([*parts, f', "sendtime": {time.time()!r}}}'])


def _heads(recording: Recording) -> tuple[list[tuple[str, str]], list[int]]:
    meta, total = recording.meta, recording.num_taxels
    taxels = meta.get("taxels")
    known = isinstance(taxels, list) and all(isinstance(n, int) and n > 0 for n in taxels)
    if not known or sum(taxels or ()) != total:
        taxels = [total]
    assert taxels is not None
    heads = []
    for i in range(len(taxels)):
        model, side = _entry(meta.get("models"), i), _entry(meta.get("handedness"), i)
        heads.append((json.dumps(model), json.dumps(side or "right")))
    return heads, [0, *np.cumsum(taxels).tolist()]


def _entry(values: Any, i: int) -> str:
    return str(values[i]) if isinstance(values, list) and i < len(values) else ""
