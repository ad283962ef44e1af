r"""Frames from XELA's server."""

import time
from inspect import signature
from typing import Any

from torch_geometric_tactile.data.live_frame import LiveFrame
from torch_geometric_tactile.io.xela_live import parse_xela_text
from torch_geometric_tactile.io.xela_message import XelaFrame
from torch_geometric_tactile.live.source import Source

_INSTALL = "pip install 'torch-geometric-tactile[live]'"
_OPEN = 5.0  # seconds to connect
_FIRST = 1.0  # seconds that opening waits for the first message, which tells the sensors
_CLOSE = 1.0


class XelaSource(Source):
    r"""Reads the WebSocket of XELA's server. Needs the extra :obj:`live`.

    The number of a message is the number of the frame, and its time the time of the device. A
    message with the number of the one before is left out and counted as repeated; one that cannot
    be read, or has another number of taxels than the first, is counted as corrupt. :obj:`extra` has
    :obj:`"temp"` (temperature in kelvins) and :obj:`"ups"` (updates per second, which may be fewer
    than messages) of each taxel, if the server sends them.

    Args:
        url (str): Address of the server.
        forces (bool): Whether to read the forces in newtons instead of the counts; only some
            models have them.

    Raises:
        ImportError: If the extra is missing.
        ValueError: If :obj:`url` is no address of a WebSocket.
    """

    def __init__(self, url: str = "ws://127.0.0.1:5000", forces: bool = False) -> None:
        try:
            from websockets.sync.client import connect
        except ImportError as error:
            raise ImportError(f"XELA's server needs websockets: {_INSTALL}") from error
        if not isinstance(url, str) or not url.startswith(("ws://", "wss://")):
            raise ValueError(f"'url' must begin with ws:// or wss:// (got {url!r})")
        super().__init__(url, {"unit": "newton" if forces else "count"})
        self.forces = forces
        self._connect = connect
        self._connection: Any = None
        self._socket: Any = None
        self._waiting: list[LiveFrame] = []
        self._number: int | None = None
        self._taxels: tuple[int, ...] | None = None

    def open(self) -> None:
        r"""Connects to the server, the first time with up to a second for a message, which tells
        the sensors; does nothing if it is connected.

        Raises:
            OSError: If no server answers.
            ValueError: If its address is none.
        """
        if self._socket is not None:
            return
        from websockets.exceptions import InvalidURI, WebSocketException

        # Compression costs more time than it saves on a cable; a proxy is for other hosts.
        options: dict[str, Any] = {"compression": None, "close_timeout": _CLOSE}
        if "proxy" in signature(self._connect).parameters:  # websockets 15
            options["proxy"] = None
        try:
            connection = self._connect(self.name, open_timeout=_OPEN, **options)
            self._socket = connection.__enter__()  # calls without it are on their way out
        except InvalidURI as error:
            raise ValueError(f"'url' must be the address of a WebSocket (got {error})") from error
        except (OSError, EOFError, WebSocketException) as error:
            raise ConnectionError(
                f"no server of XELA answers at '{self.name}' ({error}); is it running?"
            ) from error
        self._connection = connection
        try:
            if self._taxels is None:
                self._waiting = self.read(_FIRST)
        except BaseException:
            self.close()
            raise

    def read(self, timeout: float) -> list[LiveFrame]:
        r"""Returns the next frame, or none if none came in time.

        Args:
            timeout (float): How long to wait in seconds.

        Raises:
            EOFError: If the server has closed the connection.
        """
        from websockets.exceptions import ConnectionClosed

        if self._waiting:
            frames, self._waiting = self._waiting, []
            return frames
        if self._socket is None:
            raise OSError(f"{self.name} is not open")
        deadline = time.monotonic() + timeout
        while True:
            try:
                text = self._socket.recv(timeout=max(0.0, deadline - time.monotonic()))
            except TimeoutError:
                return []
            except ConnectionClosed as error:
                raise EOFError(f"the server at '{self.name}' has closed: {error}") from error
            frame = self._frame(text, time.monotonic_ns())
            if frame is not None:
                return [frame]
            if time.monotonic() >= deadline:
                return []

    def _frame(self, text: str | bytes, received: int) -> LiveFrame | None:
        try:
            frame = parse_xela_text(text, self.forces)
        except ValueError:
            self.counts.corrupt += 1
            return None
        if frame is None:
            return None
        if self._taxels is None:
            self._learn(frame)
        elif frame.taxels != self._taxels:
            self.counts.corrupt += 1
            return None
        last, self._number = self._number, frame.number
        if last is not None:
            if frame.number == last:
                self.repeats += 1
                return None
            self.counts.lost += max(0, frame.number - last - 1)
        self.counts.good += 1
        known = {"temp": frame.temp, "ups": frame.ups}
        extra = {name: value for name, value in known.items() if value is not None}
        return LiveFrame(
            frame.number, received * 1e-9, received, frame.time, frame.reading, None, extra
        )

    def _learn(self, frame: XelaFrame) -> None:
        self._taxels = frame.taxels
        self.meta.update(
            taxels=list(frame.taxels), models=list(frame.models), server_version=frame.version
        )

    def close(self) -> None:
        r"""Closes the connection; does nothing if it is closed."""
        connection, self._connection, self._socket = self._connection, None, None
        self._waiting = []
        if connection is not None:
            connection.__exit__(None, None, None)
