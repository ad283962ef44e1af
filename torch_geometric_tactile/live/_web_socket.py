r"""A WebSocket client without a thread."""

import math
import socket
import ssl
import time
from collections import deque
from contextlib import suppress
from typing import Any

from torch_geometric_tactile._limits import SENSOR_MESSAGE_BYTES

_INSTALL = "pip install 'torch-geometric-tactile[live]'"
_READ_BYTES = 1 << 16
_MIN_TIMEOUT_SHARE = 0.95  # a timeout of the socket that is at least this close is not set again
_CLOSE_SECONDS = 0.5


class WebSocket:
    r"""A WebSocket client. It uses the protocol of websockets, but not its client, which reads in a
    second thread: passing messages between threads costs more than reading them. Needs the extra
    :obj:`live`.

    Args:
        url (str): Address of the server.

    Raises:
        ImportError: If websockets is missing.
        ValueError: If :obj:`url` is not the address of a WebSocket.
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
        except (InvalidURI, ValueError) as error:  # ValueError: a port that is not a number
            raise ValueError(f"'url' must be the address of a WebSocket (got {error})") from error
        self._frame, self._opcodes = Frame, Opcode
        self._socket: socket.socket | None = None
        self._protocol: Any = None
        self._messages: deque[bytes] = deque()
        self._fragments: list[bytes] = []
        self._close_reason = ""
        self._timeout = math.inf

    def open(self, timeout: float) -> None:
        r"""Connects to the server.

        Raises:
            OSError: If the server does not answer within :obj:`timeout` seconds, or rejects the
                connection.
        """
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
            self._close_reason = "it was closed before the handshake"
            while self._close_reason:
                if self._socket is None or not self._read_events(deadline - time.perf_counter()):
                    raise TimeoutError("it does not answer as a WebSocket")
        except BaseException:
            self.close()
            raise

    def receive(self, timeout: float) -> bytes | None:
        r"""Returns the next message, or :obj:`None` if none arrives within :obj:`timeout` seconds.

        Raises:
            EOFError: If the connection is closed.
        """
        deadline = time.perf_counter() + timeout
        while not self._messages:
            if self._close_reason:
                raise EOFError(self._close_reason)
            if not self._read_events(deadline - time.perf_counter()):
                return None
        return self._messages.popleft()

    def close(self) -> None:
        r"""Closes the connection. Does nothing if it is closed."""
        if self._socket is None:
            return
        with suppress(OSError, EOFError):
            self._socket.settimeout(_CLOSE_SECONDS)
            if not self._close_reason:
                self._protocol.send_close(1000)
            self._send()
        self._socket.close()
        self._socket = None
        self._messages.clear()
        self._fragments.clear()

    def _read_events(self, timeout: float) -> bool:
        # Returns whether data arrived in time.
        if self._socket is None:
            raise OSError("the WebSocket is not open")
        timeout = max(timeout, 1e-3)
        if (
            not _MIN_TIMEOUT_SHARE * timeout <= self._timeout <= timeout
        ):  # setting it is a system call
            self._socket.settimeout(timeout)
            self._timeout = timeout
        try:
            data = self._socket.recv(_READ_BYTES)
        except TimeoutError:
            return False
        if data:
            self._protocol.receive_data(data)
        else:
            self._protocol.receive_eof()
        events = self._protocol.events_received()
        for event in events:
            self._handle_event(event)
        if len(events) != 1 or not self._messages:  # sends answers to pings and the like
            self._send()
        protocol_error = self._protocol.parser_exc
        if not data:
            raise EOFError(self._close_reason or "the connection was closed")
        if protocol_error is not None and not self._close_reason:
            self._close_reason = f"the server violates the protocol ({protocol_error})"
        return True

    def _handle_event(self, event: Any) -> None:
        opcodes = self._opcodes
        if not isinstance(event, self._frame):  # the response to the handshake
            handshake_error = self._protocol.handshake_exc
            if handshake_error is not None:
                raise ConnectionError(str(handshake_error)) from handshake_error
            self._close_reason = ""
        elif event.opcode in (opcodes.TEXT, opcodes.BINARY, opcodes.CONT):
            self._fragments.append(bytes(event.data))
            if event.fin:
                self._messages.append(b"".join(self._fragments))
                self._fragments.clear()
        elif event.opcode is opcodes.CLOSE:
            self._close_reason = (
                f"the server has closed the connection ({self._protocol.close_rcvd})"
            )

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
