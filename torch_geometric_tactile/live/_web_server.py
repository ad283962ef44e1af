r"""A WebSocket server in one thread, and checks of its clients."""

import asyncio
import logging
import re
import socket
import threading
from contextlib import suppress
from typing import Any, Self
from urllib.parse import urlsplit

from torch_geometric_tactile._limits import VIEWER_MESSAGE_BYTES

_INSTALL = "pip install 'torch-geometric-tactile[live]'"


class WebServer:
    r"""Base class of servers that serve all WebSocket clients in one background thread. Subclasses
    define :meth:`_serve_client`. Pages of other sites and clients beyond the limit are rejected.

    Args:
        host (str): Address to listen on.
        port (int): Port to listen on; any free port if 0.
        name (str): Name of the server in messages.
        max_clients (int): Limit of connected clients.
        close_timeout (float): Seconds to wait for clients that do not confirm the close.

    Raises:
        ImportError: If websockets is missing.
    """

    def __init__(
        self, host: str, port: int, *, name: str, max_clients: int, close_timeout: float
    ) -> None:
        try:
            import websockets  # noqa: F401
        except ImportError as error:
            raise ImportError(f"{name} needs websockets: {_INSTALL}") from error
        self.host, self.port, self.clients = host, port, 0
        self._name, self._max_clients, self._close_timeout = name, max_clients, close_timeout
        self._thread: threading.Thread | None = None
        self._loop: asyncio.AbstractEventLoop | None = None
        self._stop: asyncio.Event | None = None

    async def _serve_client(self, connection: Any) -> None:
        raise NotImplementedError

    def _respond(self, connection: Any, request: Any, is_full: bool) -> Any:
        # The response to a request, or None if it may continue as a WebSocket.
        return connection.respond(503, "Too many clients are connected.\n") if is_full else None

    def start(self) -> None:
        r"""Starts to serve in a background thread. Does nothing if the server is running.

        Raises:
            OSError: If the port is in use or the address does not belong to this machine.
        """
        if self._thread is not None:
            return
        listener = self._open_listener()
        self.port = listener.getsockname()[1]
        ready = threading.Event()
        self._thread = threading.Thread(
            target=self._run, args=(listener, ready), name=self._name, daemon=True
        )
        self._thread.start()
        ready.wait()

    def close(self) -> None:
        r"""Stops the server and disconnects the clients. Does nothing if the server is closed."""
        thread, self._thread = self._thread, None
        if thread is None:
            return
        with suppress(RuntimeError):  # the loop has ended after an error
            assert self._loop is not None
            assert self._stop is not None
            self._loop.call_soon_threadsafe(self._stop.set)
        thread.join()

    def __enter__(self) -> Self:
        self.start()
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def _open_listener(self) -> socket.socket:
        family = socket.AF_INET6 if ":" in self.host else socket.AF_INET
        try:
            return socket.create_server((self.host, self.port), family=family)
        except OSError as error:
            text = f"{self._name} cannot use {self.host}:{self.port}: "
            raise OSError(error.errno, text + (error.strerror or str(error))) from error

    def _run(self, listener: socket.socket, ready: threading.Event) -> None:
        try:
            asyncio.run(self._serve(listener, ready))
        finally:
            ready.set()
            listener.close()

    async def _serve(self, listener: socket.socket, ready: threading.Event) -> None:
        from websockets.asyncio.server import serve

        self._loop, self._stop = asyncio.get_running_loop(), asyncio.Event()
        logger = logging.getLogger(f"{__name__}.websockets")
        logger.setLevel(
            logging.CRITICAL
        )  # broken requests are errors of clients, not of this program
        async with serve(
            self._track_client,
            sock=listener,
            process_request=self._process_request,
            compression=None,
            max_size=VIEWER_MESSAGE_BYTES,
            close_timeout=self._close_timeout,
            server_header=None,
            logger=logger,
        ):
            ready.set()
            await self._stop.wait()

    async def _track_client(self, connection: Any) -> None:
        from websockets.exceptions import ConnectionClosed

        self.clients += 1
        try:
            with suppress(ConnectionClosed):
                await self._serve_client(connection)
        finally:
            self.clients -= 1

    def _process_request(self, connection: Any, request: Any) -> Any:
        reason, is_full = (
            rejection_reason(connection, request, self.host),
            self.clients >= self._max_clients,
        )
        return (
            connection.respond(403, reason)
            if reason
            else self._respond(connection, request, is_full)
        )


def rejection_reason(connection: Any, request: Any, host: str) -> str:
    r"""Returns the reason why a request is rejected, or an empty string. A request is rejected if
    its :obj:`Host` is not a name of this machine, or if a page of another site sends it.

    A foreign name that resolves to this machine (DNS rebinding) is rejected. The port in
    :obj:`Host` may differ from the port of the server, since ports may be forwarded. :obj:`Origin`
    must have the same port as :obj:`Host`.
    """
    name = _single_value(request.headers.get_all("Host"))
    origin = request.headers.get_all("Origin")
    server_names = {"localhost", host.lower(), connection.local_address[0]}
    if name is None or _hostname(name) not in server_names:
        return "The host name is not a name of this server.\n"
    if origin and _single_value(origin) != f"http://{name}":
        return "Pages of other sites may not use this server.\n"
    return ""


def _hostname(host: str) -> str | None:
    # Without the port, which differs if it is forwarded, as with `ssh -L`.
    if not re.fullmatch(r"[\w.:\[\]-]+", host, re.ASCII):
        return None
    try:
        return urlsplit(f"//{host}").hostname
    except ValueError:
        return None


def _single_value(values: list[str]) -> str | None:
    return values[0] if len(values) == 1 else None
