r"""A server that replays a recording in the message format of XELA's server."""

import asyncio
import json
import threading
import time
from typing import Any

import numpy as np

from torch_geometric_tactile._checks import need
from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile.data.recording import Recording
from torch_geometric_tactile.io._xela_message import XELA_VERSION
from torch_geometric_tactile.live._web_server import WebServer

_MAX_COUNT = 0xFFFF
_MAX_LATE_SECONDS = 2.0  # a client that is later skips frames
_POLL_SECONDS = 0.1
_CLOSE_SECONDS = 0.5  # a client that does not read would block the close
_MAX_CLIENTS = 32


class ReplayServer(WebServer):
    r"""Replays a recording to any number of WebSocket clients in the message format of XELA's
    server, for tests without a hand.

    The replay starts with the first client. Each client receives :obj:`{"message": "Welcome"}` and
    then the frames at their recorded times. A client that is more than 2 seconds late skips frames,
    as the frame numbers show. At the end of the recording, the server closes the connections. As in
    the viewer, pages of other sites and more than 32 clients are rejected.

    Args:
        recording (Recording, str or PathLike): The recording or its file, with counts of 3 channels
            and no missing readings.
        port (int): Port to listen on; any free port if 0.
        speed (float): Playback speed relative to the recording.
        loop (bool): Whether to start again at the end. The frame numbers continue.
        host (str): Address to listen on.

    Attributes:
        port (int): Port that the server listens on. Before the server has started, the argument.
        clients (int): Number of connected clients.
        sent (int): Number of messages sent to all clients.

    Raises:
        ImportError: If the extra :obj:`live` is missing.
        OSError: If the port is in use; raised by :meth:`start`.
        ValueError: If the readings are not counts from 0 to 65535, or the speed is not positive.

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
        self._start_time: float | None = None
        self._has_finished = False
        self._is_closing = threading.Event()
        self._ended = threading.Event()
        super().__init__(
            host, port, name="the server", max_clients=_MAX_CLIENTS, close_timeout=_CLOSE_SECONDS
        )

    @property
    def url(self) -> str:
        r"""Address of the server, such as :obj:`ws://127.0.0.1:5000`."""
        host = f"[{self.host}]" if ":" in self.host else self.host
        return f"ws://{host}:{self.port}"

    def wait(self, timeout: float | None = None) -> bool:
        r"""Waits for the end of the recording, and returns whether it was reached.

        Args:
            timeout (float, optional): Limit in seconds; no limit if left out.
        """
        return self._ended.wait(timeout)

    def close(self) -> None:
        r"""Closes all connections. Does nothing if the server is closed."""
        self._is_closing.set()
        self._ended.set()
        super().close()

    async def _serve_client(self, client: Any) -> None:
        now = time.perf_counter()
        if self._start_time is None:
            self._start_time = now
        first_frame = self._next_frame(
            now
        )  # before the welcome, which may take longer than a frame
        has_finished = False
        try:
            await client.send(json.dumps({"message": "Welcome"}))
            has_finished = await self._send_all(client, first_frame)
        finally:
            self._has_finished = self._has_finished or has_finished
            if self._has_finished and self.clients == 1:  # this is the last client
                self._ended.set()

    async def _send_all(self, client: Any, frame: int) -> bool:
        length = self._messages.num_frames
        while self.loop or frame < length:
            late_seconds = time.perf_counter() - self._due_time(frame)
            if self._is_closing.is_set():
                return False
            if late_seconds < 0:
                await asyncio.sleep(min(-late_seconds, _POLL_SECONDS))
            elif late_seconds > _MAX_LATE_SECONDS:
                frame = self._next_frame(time.perf_counter())
                await asyncio.sleep(0)
            else:
                await client.send(self._messages.text(frame, self._wall_time(frame)))
                self.sent += 1
                frame += 1
                await asyncio.sleep(0)  # lets other clients run, even if sending never waits
        return True

    def _due_time(self, frame: int) -> float:
        assert self._start_time is not None
        return self._start_time + self._messages.seconds(frame) / self.speed

    def _wall_time(self, frame: int) -> float:
        return time.time() - time.perf_counter() + self._due_time(frame)

    def _next_frame(self, now: float) -> int:
        assert self._start_time is not None
        return self._messages.frame_at((now - self._start_time) * self.speed)

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.url!r}, num_frames={self._messages.num_frames})"


class _Messages:
    # The frames of a recording as messages, in an endless loop.

    def __init__(self, recording: Recording) -> None:
        meta, tactile = recording.meta, recording.tactile
        if recording.num_frames == 0:
            raise ValueError("'recording' must hold at least one frame to be sent (got none)")
        if recording.num_channels != 3 or meta.get("unit", "count") != "count":
            raise ValueError(
                "'recording' must hold counts of 3 channels to be sent as XELA's server does (got "
                f"{recording.num_channels} channels, unit '{meta.get('unit')}')"
            )
        is_invalid = ~((tactile >= 0) & (tactile <= _MAX_COUNT) & (tactile == np.floor(tactile)))
        if is_invalid.any():
            frame, taxel, channel = np.argwhere(is_invalid)[0].tolist()
            raise ValueError(
                f"'recording' must hold whole numbers from 0 to {_MAX_COUNT} to be sent as XELA's "
                f"server does (got {tactile[frame, taxel, channel]} in frame {frame}, taxel "
                f"{taxel}, axis {'xyz'[channel]})"
            )
        self._counts = tactile
        self._time = recording.time - recording.time[0]
        numbers = np.asarray(recording.extra.get("sequence", np.arange(recording.num_frames)))
        is_increasing = (
            numbers.ndim == 1 and numbers.dtype.kind in "iu" and (np.diff(numbers) > 0).all()
        )
        self._numbers = numbers - numbers[0] if is_increasing else np.arange(recording.num_frames)
        step = self._time[-1] / max(1, len(self._time) - 1)
        self._turn_seconds = float(self._time[-1] + (step or 0.01))
        self._sensor_heads, self._bounds = _sensor_heads(recording)
        self._version = str(meta.get("server_version", XELA_VERSION))

    @property
    def num_frames(self) -> int:
        return len(self._time)

    def seconds(self, frame: int) -> float:
        turn, index = divmod(frame, self.num_frames)
        return turn * self._turn_seconds + float(self._time[index])

    def frame_at(self, seconds: float) -> int:
        turn, turn_time = divmod(max(0.0, seconds), self._turn_seconds)
        return int(turn) * self.num_frames + max(
            0, int(np.searchsorted(self._time, turn_time, side="right")) - 1
        )

    def text(self, frame: int, stamp: float) -> str:
        # Formatted by hand: encoding all numbers with `json` would keep one core busy.
        turn, index = divmod(frame, self.num_frames)
        number = 1 + turn * (int(self._numbers[-1]) + 1) + int(self._numbers[index])
        texts = [
            f'{{"message": {number}, "time": {stamp!r}, "sensors": {len(self._sensor_heads)}, '
            f'"type": "routine", "version": {json.dumps(self._version)}'
        ]
        for i, (head, start, stop) in enumerate(
            zip(self._sensor_heads, self._bounds, self._bounds[1:], strict=False), start=1
        ):
            counts = self._counts[index, start:stop].astype(">u2")
            words = counts.tobytes().hex(",", 2).upper()
            texts.append(
                f', "{i}": {{"time": {stamp!r}, "sensor": "{i}", "data": "{words}", '
                f'"model": {head[0]}, "taxels": {stop - start}, '
                f'"integer": {counts.ravel().tolist()}, "handedness": {head[1]}}}'
            )
        return "".join([*texts, f', "sendtime": {time.time()!r}}}'])


def _sensor_heads(recording: Recording) -> tuple[list[tuple[str, str]], list[int]]:
    meta, num_taxels = recording.meta, recording.num_taxels
    taxels = meta.get("taxels")
    is_valid = isinstance(taxels, list) and all(isinstance(n, int) and n > 0 for n in taxels)
    if not is_valid or sum(taxels or ()) != num_taxels:
        taxels = [num_taxels]
    assert taxels is not None
    heads = []
    for i in range(len(taxels)):
        model, side = _list_entry(meta.get("models"), i), _list_entry(meta.get("handedness"), i)
        heads.append((json.dumps(model), json.dumps(side or "right")))
    return heads, [0, *np.cumsum(taxels).tolist()]


def _list_entry(values: Any, i: int) -> str:
    return str(values[i]) if isinstance(values, list) and i < len(values) else ""
