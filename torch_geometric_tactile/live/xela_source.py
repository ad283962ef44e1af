r"""XELA's server as a source."""

import time

from torch_geometric_tactile.data.live_frame import LiveFrame
from torch_geometric_tactile.io._xela_message import XelaFrame, parse_xela_text
from torch_geometric_tactile.live._web_socket import WebSocket
from torch_geometric_tactile.live.source import Source

_OPEN_SECONDS = 5.0
_MAX_STEP = 2**20  # messages, a few hours: a larger step is a restart of the server, not a loss
_FIRST_MESSAGE_SECONDS = 1.0  # the first message holds the sensors, which `meta` needs


class XelaSource(Source):
    r"""Reads live frames from the WebSocket of XELA's server. Needs the extra :obj:`live`.

    The number of a message is the frame number, and its time is the device time. The server stamps
    messages when it creates them, not when the sensor measures. The stream therefore computes
    regular times from the frame numbers.

    If the server restarts, its numbers start again, but the frame numbers continue. Frames lost in
    a restart are unknown and not counted. A message with the number of the previous message is
    dropped and counted as repeated. A message is counted as corrupt if it cannot be read, or if its
    number of taxels differs from the first message.

    :obj:`extra` holds :obj:`"temp"` (temperature in kelvins) and :obj:`"ups"` (updates per second,
    which may be fewer than messages) of each taxel, if the server sends them.

    Args:
        url (str): Address of the server.
        forces (bool): Whether to read the forces in newtons instead of the counts. Only some models
            have forces.

    Raises:
        ImportError: If the extra is missing.
        ValueError: If :obj:`url` is not the address of a WebSocket.

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
        self._unread_frames: list[LiveFrame] = []
        self._last_number: int | None = None
        self._sequence = 0
        self._taxel_counts: tuple[int, ...] | None = None

    def open(self) -> None:
        r"""Connects to the server. The first call waits up to a second for a message, which holds
        the sensors. Does nothing if the source is connected.

        Raises:
            OSError: If no server answers.
        """
        if self._is_open:
            return
        try:
            self._socket.open(_OPEN_SECONDS)
        except (OSError, EOFError) as error:
            raise ConnectionError(
                f"no XELA server answers at '{self.name}' ({error}); is it running?"
            ) from error
        self._is_open = True
        try:
            if self._taxel_counts is None:
                self._unread_frames = self.read(_FIRST_MESSAGE_SECONDS)
        except BaseException:
            self.close()
            raise

    def read(self, timeout: float) -> list[LiveFrame]:
        r"""Returns the next frame, or an empty list if none arrives within the timeout.

        Args:
            timeout (float): Limit of the wait in seconds.

        Raises:
            EOFError: If the server has closed the connection.
        """
        if self._unread_frames:
            frames, self._unread_frames = self._unread_frames, []
            return frames
        if not self._is_open:
            raise OSError(f"{self.name} is not open")
        deadline = time.perf_counter() + timeout
        while True:
            try:
                text = self._socket.receive(max(0.0, deadline - time.perf_counter()))
            except EOFError as error:
                raise EOFError(
                    f"the server at '{self.name}' closed the connection: {error}"
                ) from error
            if text is None:
                return []
            frame = self._to_frame(text, time.perf_counter_ns())
            if frame is not None:
                return [frame]
            if time.perf_counter() >= deadline:
                return []

    def _to_frame(self, text: bytes, received: int) -> LiveFrame | None:
        try:
            frame = parse_xela_text(text, self.forces)
        except ValueError as error:
            self.counts.corrupt += 1
            self.counts.refuse(str(error))
            return None
        if frame is None:
            return None
        if self._taxel_counts is None:
            self._set_meta(frame)
        elif frame.taxels != self._taxel_counts:
            self.counts.corrupt += 1
            self.counts.refuse(
                f"the sensors have {frame.taxels} taxels, but had {self._taxel_counts} at first"
            )
            return None
        last, self._last_number = self._last_number, frame.number
        if frame.number == last:
            self.repeats += 1
            return None
        if last is None:
            self._sequence = frame.number
        else:
            step = frame.number - last
            # The numbers of a restarted server step back or jump, but the frame numbers continue.
            step = step if 0 < step <= _MAX_STEP else 1
            self._sequence += step
            self.counts.lost += step - 1
        self.counts.good += 1
        optional_rows = {"temp": frame.temp, "ups": frame.ups}
        extra = {name: value for name, value in optional_rows.items() if value is not None}
        return LiveFrame(
            self._sequence, received * 1e-9, received, frame.time, frame.reading, None, extra
        )

    def why_no_frame(self) -> str:
        r"""Returns the reason why there is no frame, and the settings to check."""
        if not self.counts.corrupt:
            return "no message with readings arrived: check that the server has found its sensors"
        return (
            f"{self.counts.corrupt} messages arrived, but none is a frame. The first: "
            f"{self.counts.reason}"
        )

    def _set_meta(self, frame: XelaFrame) -> None:
        self._taxel_counts = frame.taxels
        self.meta.update(
            taxels=list(frame.taxels), models=list(frame.models), server_version=frame.version
        )

    def close(self) -> None:
        r"""Closes the connection. Does nothing if it is closed."""
        self._is_open = False
        self._unread_frames = []
        self._socket.close()
