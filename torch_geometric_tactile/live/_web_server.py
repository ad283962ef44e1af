r"""A server of WebSockets in one thread, and who may use it."""

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
    r"""Serves WebSockets in a thread of its own, however many clients there are: those that
    :meth:`_show` serves. A page of another site is refused, and so is a client when there are too
    many.
    """

    def __init__(self, host: str, port: int, *, name: str, most: int, closing: float) -> None:
        try:
            import websockets  # noqa: F401
        except ImportError as error:
            raise ImportError(f"{name} needs websockets: {_INSTALL}") from error
        self.host, self.port, self.clients = host, port, 0
        self._name, self._most, self._closing = name, most, closing
        self._thread: threading.Thread | None = None
        self._loop: asyncio.AbstractEventLoop | None = None
        self._stop: asyncio.Event | None = None

    async def _show(self, connection: Any) -> None:
        raise NotImplementedError

    def _page(self, connection: Any, request: Any, full: bool) -> Any:
        # The answer to a request; None if it may go on as a web socket.
        return connection.respond(503, "Too many clients are connected.\n") if full else None

    def start(self) -> None:
        r"""Begins to serve, in a thread of its own; does nothing if it does already.

        Raises:
            OSError: If the port is taken or the address is not one of this machine.
        """
        if self._thread is not None:
            return
        listening = self._listening()
        self.port = listening.getsockname()[1]
        ready = threading.Event()
        self._thread = threading.Thread(
            target=self._run, args=(listening, ready), name=self._name, daemon=True
        )
        self._thread.start()
        ready.wait()

    def close(self) -> None:
        r"""Ends the serving, and disconnects the clients; does nothing if it is closed."""
        thread, self._thread = self._thread, None
        if thread is None:
            return
        with suppress(RuntimeError):  # its loop has ended by itself
            assert self._loop is not None
            assert self._stop is not None
            self._loop.call_soon_threadsafe(self._stop.set)
        thread.join()

    def __enter__(self) -> Self:
        self.start()
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def _listening(self) -> socket.socket:
        family = socket.AF_INET6 if ":" in self.host else socket.AF_INET
        try:
            return socket.create_server((self.host, self.port), family=family)
        except OSError as error:
            text = f"{self._name} cannot use {self.host}:{self.port}: "
            raise OSError(error.errno, text + (error.strerror or str(error))) from error

    def _run(self, listening: socket.socket, ready: threading.Event) -> None:
        try:
            asyncio.run(self._serve(listening, ready))
        finally:
            ready.set()
            listening.close()

    async def _serve(self, listening: socket.socket, ready: threading.Event) -> None:
        from websockets.asyncio.server import serve

        self._loop, self._stop = asyncio.get_running_loop(), asyncio.Event()
        quiet = logging.getLogger(f"{__name__}.websockets")
        quiet.setLevel(logging.CRITICAL)  # broken requests are the client's affair
        async with serve(
            self._count,
            sock=listening,
            process_request=self._answer,
            compression=None,
            max_size=VIEWER_MESSAGE_BYTES,
            close_timeout=self._closing,
            server_header=None,
            logger=quiet,
        ):
            ready.set()
            await self._stop.wait()

    async def _count(self, connection: Any) -> None:
        from websockets.exceptions import ConnectionClosed

        self.clients += 1
        try:
            with suppress(ConnectionClosed):
                await self._show(connection)
        finally:
            self.clients -= 1

    def _answer(self, connection: Any, request: Any) -> Any:
        why, full = foreign(connection, request, self.host), self.clients >= self._most
        return connection.respond(403, why) if why else self._page(connection, request, full)


def foreign(connection: Any, request: Any, host: str) -> str:
    r"""Returns why a request is refused: it is not for a name of this machine, or from the page of
    another; empty if it is neither.

    A name that a foreign site has made lead here (DNS rebinding) is not one. The port of the name
    may be another one, since ports are forwarded; that of :obj:`Origin` may not.
    """
    name = _only(request.headers.get_all("Host"))
    origin = request.headers.get_all("Origin")
    own = {"localhost", host.lower(), connection.local_address[0]}
    if name is None or _hostname(name) not in own:
        return "This name is not one of this server's.\n"
    if origin and _only(origin) != f"http://{name}":
        return "Pages of others may not use this server.\n"
    return ""


def _hostname(host: str) -> str | None:
    # Without the port, which differs where it is forwarded, as by `ssh -L`.
    if not re.fullmatch(r"[\w.:\[\]-]+", host, re.ASCII):
        return None
    try:
        return urlsplit(f"//{host}").hostname
    except ValueError:
        return None


def _only(values: list[str]) -> str | None:
    return values[0] if len(values) == 1 else None
