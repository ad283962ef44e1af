r"""A recording sent as XELA's server sends its frames."""

import json
import threading
import time
from typing import Any, Self

import numpy as np

from torch_geometric_tactile.data.recording import Recording
from torch_geometric_tactile.io.xela_message import XELA_VERSION
from torch_geometric_tactile.typing import PathLike

_HIGHEST = 0xFFFF
_MOST_LATE = 2.0  # seconds after which a client that is too slow goes on with the present
_WAIT = 0.1
_JOIN = 5.0
_CLOSE = 0.5


class ReplayServer:
    r"""Replays a recording to any number of WebSocket clients in the message format of XELA's
    server, for tests without a hand.

    It begins with the first client. Each one gets :obj:`{"message": "Welcome"}` and then the
    frames, in the time of the recording; one that reads so slowly that it is 2 seconds late misses
    the frames between, as their numbers show. At the end of the recording the connections are
    closed.

    Args:
        recording (Recording, str or PathLike): The recording or its file: counts of 3 channels,
            without missing ones.
        port (int): The port; 0 takes a free one.
        speed (float): How many times as fast as it was recorded.
        loop (bool): Whether to begin again at the end; the numbers go on.
        host (str): The address to listen at.

    Attributes:
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
        if not speed > 0 or speed == float("inf"):
            raise ValueError(f"'speed' must be positive and finite (got {speed})")
        self._serve = _require_serve()
        if not isinstance(recording, Recording):
            from torch_geometric_tactile.io import read_recording

            recording = read_recording(recording)
        self._messages = _Messages(recording)
        self.host, self.speed, self.loop = host, speed, loop
        self.sent = 0
        self._port = port
        self._began: float | None = None
        self._clients: set[Any] = set()
        self._finished = False
        self._lock = threading.Lock()
        self._stop = threading.Event()
        self._ended = threading.Event()
        self._server: Any = None
        self._thread: threading.Thread | None = None

    @property
    def port(self) -> int:
        r"""The port that it listens at; the one that was asked for before it is started."""
        return self._port if self._server is None else self._server.socket.getsockname()[1]

    @property
    def url(self) -> str:
        r"""Its address, such as :obj:`ws://127.0.0.1:5000`."""
        host = f"[{self.host}]" if ":" in self.host else self.host
        return f"ws://{host}:{self.port}"

    @property
    def clients(self) -> int:
        r"""The number of clients that are connected."""
        return len(self._clients)

    def start(self) -> None:
        r"""Begins to listen; does nothing if it does.

        Raises:
            OSError: If the port is taken.
        """
        if self._server is None:
            self._server = self._serve(
                self._play,
                self.host,
                self._port,
                compression=None,
                close_timeout=_CLOSE,  # of a client that does not read
            )
            self._thread = threading.Thread(target=self._server.serve_forever, daemon=True)
            self._thread.start()

    def wait(self, timeout: float | None = None) -> bool:
        r"""Waits for the end of the recording, and returns whether it has come.

        Args:
            timeout (float, optional): How long in seconds; without end if left out.
        """
        return self._ended.wait(timeout)

    def close(self) -> None:
        r"""Closes all connections; does nothing if it is closed."""
        self._stop.set()
        self._ended.set()
        if self._server is not None and self._thread is not None:
            self._server.shutdown()
            self._thread.join(_JOIN)

    def __enter__(self) -> Self:
        self.start()
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def _play(self, client: Any) -> None:
        from websockets.exceptions import ConnectionClosed

        with self._lock:
            if self._began is None:
                self._began = time.perf_counter()
            self._clients.add(client)
        finished = False
        try:
            client.send(json.dumps({"message": "Welcome"}))
            finished = self._send_all(client, self._next_after(time.perf_counter()))
        except (ConnectionClosed, OSError):
            pass
        finally:
            with self._lock:
                self._clients.discard(client)
                self._finished = self._finished or finished
                if self._finished and not self._clients:
                    self._ended.set()

    def _send_all(self, client: Any, frame: int) -> bool:
        length = self._messages.num_frames
        while self.loop or frame < length:
            late = time.perf_counter() - self._due(frame)
            while late < 0:
                if self._stop.wait(min(-late, _WAIT)):
                    return False
                late = time.perf_counter() - self._due(frame)
            if late > _MOST_LATE:
                frame = self._next_after(time.perf_counter())
                continue
            if self._stop.is_set():
                return False
            client.send(self._messages.text(frame, self._stamp(frame)))
            self.sent += 1
            frame += 1
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


def _require_serve() -> Any:
    try:
        from websockets.sync.server import serve
    except ImportError as error:
        raise ImportError(
            "a server needs websockets: pip install 'torch-geometric-tactile[live]'"
        ) from error
    return serve


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
