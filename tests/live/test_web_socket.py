import http
import queue
import socket
import threading
import time
from contextlib import closing, contextmanager

import pytest

pytest.importorskip("websockets", reason="needs the extra 'live'")

from websockets.sync.server import serve

from torch_geometric_tactile.live._web_socket import WebSocket

LONG = 20.0


@contextmanager
def served(handler, **options):
    """The address of a server whose connections are handled by `handler`."""
    with serve(handler, "127.0.0.1", 0, **options) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        yield f"ws://127.0.0.1:{server.socket.getsockname()[1]}"
        server.shutdown()
        thread.join()


@contextmanager
def answered(data):
    """The address of something else, which answers with these bytes and hangs up."""
    with socket.create_server(("127.0.0.1", 0)) as listening:

        def answer():
            connection, _ = listening.accept()
            with connection:
                connection.recv(65536)
                connection.sendall(data)

        thread = threading.Thread(target=answer)
        thread.start()
        yield f"ws://127.0.0.1:{listening.getsockname()[1]}"
        thread.join()


@contextmanager
def opened(url):
    client = WebSocket(url)
    client.open(LONG)
    yield client
    client.close()


def test_messages_come_whole_and_in_order():
    texts = ["", "a", "é" * 70_000, "{}"]

    def send(connection):
        for text in texts:
            connection.send(text)
        connection.send(iter(["in ", "three ", "parts"]))
        connection.send(b"bytes")

    with served(send) as url, opened(url) as client:
        found = [client.receive(LONG) for _ in range(6)]
        assert found == [*(text.encode() for text in texts), b"in three parts", b"bytes"]
        with pytest.raises(EOFError, match=r"the server has closed the connection .*1000"):
            client.receive(LONG)


def test_ping_is_answered():
    answered_in_time = []

    def ping(connection):
        answered_in_time.append(connection.ping().wait(LONG))
        connection.send("done")

    with served(ping) as url, opened(url) as client:
        assert client.receive(LONG) == b"done"
    assert answered_in_time == [True]


def test_nothing_in_time_is_none_and_costs_no_message():
    go = threading.Event()

    def send(connection):
        go.wait(LONG)
        connection.send("late")

    with served(send) as url, opened(url) as client:
        start = time.monotonic()
        assert client.receive(0.05) is None
        assert time.monotonic() - start >= 0.04
        assert client.receive(0.0) is None
        go.set()
        assert client.receive(LONG) == b"late"


def test_goodbye_is_said():
    ended = queue.Queue()  # the server's threads may outlive it for a moment

    def wait(connection):
        for _ in connection:
            pass
        ended.put(connection.close_code)

    with served(wait) as url, opened(url) as client:
        client.close()
        client.close()
        with pytest.raises(OSError, match="is not open"):
            client.receive(0.0)
        client.open(LONG)  # again
    assert [ended.get(timeout=LONG), ended.get(timeout=LONG)] == [1000, 1000]


def test_server_that_refuses():
    def refuse(connection, request):
        return connection.respond(http.HTTPStatus.FORBIDDEN, "no\n")

    with (
        served(lambda connection: None, process_request=refuse) as url,
        pytest.raises(ConnectionError, match="403"),
        opened(url),
    ):
        pass


@pytest.mark.parametrize(
    "data",
    [b"", b"\x00" * 99, b"HTTP/1.1 200 OK\r\nContent-Length: 0\r\n\r\n", b"HTTP/1.1 101"],
    ids=["nothing", "garbage", "a page", "half"],
)
def test_what_is_no_web_socket_is_told(data):
    with answered(data) as url, pytest.raises((OSError, EOFError)), opened(url):
        pass


def greet_and_receive(client):
    # What breaks the protocol may come in one read with the greeting.
    client.open(LONG)
    client.receive(LONG)


def break_it(connection):
    connection.socket.sendall(b"\xff\xff\xff\xff")
    connection.close_socket()


@pytest.mark.parametrize(
    ("handler", "match"),
    [
        (break_it, r"violates the protocol|closed"),
        (lambda connection: connection.send(b"0" * ((1 << 24) + 1)), "violates the protocol"),
    ],
    ids=["no frame", "too large"],
)
def test_what_breaks_the_protocol_ends_the_connection(handler, match):
    with (
        served(handler) as url,
        closing(WebSocket(url)) as client,
        pytest.raises(EOFError, match=match),
    ):
        greet_and_receive(client)


@pytest.mark.parametrize("url", ["http://127.0.0.1", "ws://", "nowhere", "ws://a:b"])
def test_address_that_is_none(url):
    with pytest.raises(ValueError, match="'url' must be the address of a WebSocket"):
        WebSocket(url)


def test_nobody_there():
    with socket.create_server(("127.0.0.1", 0)) as listening:
        port = listening.getsockname()[1]
    with pytest.raises(ConnectionRefusedError), opened(f"ws://127.0.0.1:{port}"):
        pass


def test_repr():
    assert repr(WebSocket("ws://127.0.0.1:5000")) == "WebSocket('127.0.0.1', 5000)"
