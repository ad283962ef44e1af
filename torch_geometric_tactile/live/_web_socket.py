r"""A WebSocket that is read without a thread."""

import math
import socket
import ssl
import time
from collections import deque
from contextlib import suppress
from typing import Any

from torch_geometric_tactile._limits import SENSOR_MESSAGE_BYTES

_INSTALL = "pip install 'torch-geometric-tactile[live]'"
_PIECE = 1 << 16  # bytes of one read
_SAME = 0.95  # part of a time-out that is as good as the whole of it
_CLOSE = 0.5  # seconds that a goodbye may take


class WebSocket:
    r"""The client's end of a WebSocket. The protocol is that of websockets, whose own client has a
    thread of its own: handing messages over would cost more than reading them. Needs the extra
    :obj:`live`.
    """

    def __init__(self, url: str) -> None:
        try:
            from websockets.exceptions import InvalidURI
            from websockets.frames import Frame, Opcode
            from websockets.uri import parse_uri
        except ImportError as error:
            raise ImportError(f"a WebSocket needs websockets: {_INSTALL}") from error
        try:
            self._uri = parse_uri(url)
        except (InvalidURI, ValueError) as error:  # ValueError: a port that is no number
            raise ValueError(f"'url' must be the address of a WebSocket (got {error})") from error
        self._frame, self._codes = Frame, Opcode
        self._socket: socket.socket | None = None
        self._protocol: Any = None
        self._messages: deque[bytes] = deque()
        self._parts: list[bytes] = []
        self._closed = ""
        self._timeout = math.inf

    def open(self, timeout: float) -> None:
        r"""Connects."""
        from websockets.client import ClientProtocol

        deadline = time.perf_counter() + timeout
        uri = self._uri
        self._timeout = math.inf
        self._socket = socket.create_connection((uri.host, uri.port), timeout=timeout)
        self._protocol = ClientProtocol(uri, max_size=SENSOR_MESSAGE_BYTES)
        try:
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
            if uri.secure:
                context = ssl.create_default_context()
                self._socket = context.wrap_socket(self._socket, server_hostname=uri.host)
            self._protocol.send_request(self._protocol.connect())
            self._send()
            self._closed = "before it had greeted"
            while self._closed:
                if self._socket is None or not self._receive(deadline - time.perf_counter()):
                    raise TimeoutError("it does not answer as a WebSocket")
        except BaseException:
            self.close()
            raise

    def receive(self, timeout: float) -> bytes | None:
        r"""Returns the next message, or :obj:`None` if none came in time."""
        deadline = time.perf_counter() + timeout
        while not self._messages:
            if self._closed:
                raise EOFError(self._closed)
            if not self._receive(deadline - time.perf_counter()):
                return None
        return self._messages.popleft()

    def close(self) -> None:
        r"""Says goodbye and closes the connection; does nothing if it is closed."""
        if self._socket is None:
            return
        with suppress(OSError, EOFError):
            self._socket.settimeout(_CLOSE)
            if not self._closed:
                self._protocol.send_close(1000)
            self._send()
        self._socket.close()
        self._socket = None
        self._messages.clear()
        self._parts.clear()

    def _receive(self, timeout: float) -> bool:
        # Whether anything came in time.
        if self._socket is None:
            raise OSError("the WebSocket is not open")
        timeout = max(timeout, 1e-3)
        if not _SAME * timeout <= self._timeout <= timeout:  # to set it costs a system call
            self._socket.settimeout(timeout)
            self._timeout = timeout
        try:
            data = self._socket.recv(_PIECE)
        except TimeoutError:
            return False
        if data:
            self._protocol.receive_data(data)
        else:
            self._protocol.receive_eof()
        events = self._protocol.events_received()
        for event in events:
            self._take(event)
        if len(events) != 1 or not self._messages:  # such as the answer to a ping
            self._send()
        wrong = self._protocol.parser_exc
        if not data:
            raise EOFError(self._closed or "the connection was closed")
        if wrong is not None and not self._closed:
            self._closed = f"what came breaks the protocol ({wrong})"
        return True

    def _take(self, event: Any) -> None:
        codes = self._codes
        if not isinstance(event, self._frame):  # the answer to the greeting
            refused = self._protocol.handshake_exc
            if refused is not None:
                raise ConnectionError(str(refused)) from refused
            self._closed = ""
        elif event.opcode in (codes.TEXT, codes.BINARY, codes.CONT):
            self._parts.append(bytes(event.data))
            if event.fin:
                self._messages.append(b"".join(self._parts))
                self._parts.clear()
        elif event.opcode is codes.CLOSE:
            self._closed = f"the server has closed it ({self._protocol.close_rcvd})"

    def _send(self) -> None:
        assert self._socket is not None
        for data in self._protocol.data_to_send():
            if data:
                self._socket.sendall(data)
            else:
                with suppress(OSError):
                    self._socket.shutdown(socket.SHUT_WR)

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self._uri.host!r}, {self._uri.port})"
