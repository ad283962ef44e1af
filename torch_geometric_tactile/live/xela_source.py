r"""Frames from XELA's server."""

import time

from torch_geometric_tactile.data.live_frame import LiveFrame
from torch_geometric_tactile.io.xela_message import XelaFrame, parse_xela_text
from torch_geometric_tactile.live._web_socket import WebSocket
from torch_geometric_tactile.live.source import Source

_OPEN = 5.0  # seconds to connect
_LONGEST_GAP = 2**20  # messages, some hours: a longer step is another server
_FIRST = 1.0  # seconds that opening waits for the first message, which tells the sensors


class XelaSource(Source):
    r"""Reads live frames from the WebSocket of XELA's server. Needs the extra :obj:`live`.

    The number of a message is the number of the frame, and its time the time of the device. The
    server is a program and stamps messages when it makes them, so frames get regular times by their
    numbers. A server that was started again counts from the beginning: the numbers of the frames go
    on, and no loss is told, since nobody knows it. A
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

    Examples:
        >>> source = XelaSource("ws://127.0.0.1:5000")  # not connected yet
        >>> source.meta
        {'unit': 'count'}
        >>> with source:  # doctest: +SKIP
        ...     frames = source.read(timeout=1.0)
    """

    exact_clock = False
    device_order = True

    def __init__(self, url: str = "ws://127.0.0.1:5000", forces: bool = False) -> None:
        if not isinstance(url, str) or not url.startswith(("ws://", "wss://")):
            raise ValueError(f"'url' must begin with ws:// or wss:// (got {url!r})")
        super().__init__(url, {"unit": "newton" if forces else "count"})
        self.forces = forces
        self._socket = WebSocket(url)
        self._is_open = False
        self._waiting: list[LiveFrame] = []
        self._number: int | None = None
        self._sequence = 0
        self._taxels: tuple[int, ...] | None = None

    def open(self) -> None:
        r"""Connects to the server, the first time with up to a second for a message, which tells
        the sensors; does nothing if it is connected.

        Raises:
            OSError: If no server answers.
            ValueError: If its address is none.
        """
        if self._is_open:
            return
        try:
            self._socket.open(_OPEN)
        except (OSError, EOFError) as error:
            raise ConnectionError(
                f"no XELA server answers at '{self.name}' ({error}); is it running?"
            ) from error
        self._is_open = True
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
        if self._waiting:
            frames, self._waiting = self._waiting, []
            return frames
        if not self._is_open:
            raise OSError(f"{self.name} is not open")
        deadline = time.perf_counter() + timeout
        while True:
            try:
                text = self._socket.receive(max(0.0, deadline - time.perf_counter()))
            except EOFError as error:
                raise EOFError(f"the server at '{self.name}' has closed: {error}") from error
            if text is None:
                return []
            frame = self._frame(text, time.perf_counter_ns())
            if frame is not None:
                return [frame]
            if time.perf_counter() >= deadline:
                return []

    def _frame(self, text: bytes, received: int) -> LiveFrame | None:
        try:
            frame = parse_xela_text(text, self.forces)
        except ValueError as error:
            self.counts.corrupt += 1
            self.counts.refuse(str(error))
            return None
        if frame is None:
            return None
        if self._taxels is None:
            self._learn(frame)
        elif frame.taxels != self._taxels:
            self.counts.corrupt += 1
            self.counts.refuse(f"sensors of {frame.taxels} taxels came after {self._taxels}")
            return None
        last, self._number = self._number, frame.number
        if frame.number == last:
            self.repeats += 1
            return None
        if last is None:
            self._sequence = frame.number
        else:
            step = frame.number - last
            step = step if 0 < step <= _LONGEST_GAP else 1
            self._sequence += step
            self.counts.lost += step - 1
        self.counts.good += 1
        known = {"temp": frame.temp, "ups": frame.ups}
        extra = {name: value for name, value in known.items() if value is not None}
        return LiveFrame(
            self._sequence, received * 1e-9, received, frame.time, frame.reading, None, extra
        )

    def why_no_frame(self) -> str:
        r"""Returns why there is no frame: what came instead, and what to check."""
        if not self.counts.corrupt:
            return "no message with readings came: check that the server has found its sensors"
        return f"{self.counts.corrupt} messages came and make none, the first: {self.counts.reason}"

    def _learn(self, frame: XelaFrame) -> None:
        self._taxels = frame.taxels
        self.meta.update(
            taxels=list(frame.taxels), models=list(frame.models), server_version=frame.version
        )

    def close(self) -> None:
        r"""Closes the connection; does nothing if it is closed."""
        self._is_open = False
        self._waiting = []
        self._socket.close()
