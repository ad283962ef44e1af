"""Pages of the viewer without a browser."""

import http.client
import json
import struct
import time
from contextlib import ExitStack
from dataclasses import replace

import numpy as np
from recordings import counting_recording

LONG = 20.0


def unpack(message):
    """Returns the head and the arrays of a message, as the page reads them."""
    (size,) = struct.unpack_from("<I", message)
    head = json.loads(message[4 : 4 + size])
    offset, arrays = 4 + size, {}
    for name, shape in head["arrays"]:
        count = int(np.prod(shape))
        arrays[name] = np.frombuffer(message, "<f4", count, offset).reshape(shape)
        offset += 4 * count
    assert offset == len(message)
    return head, arrays


def recording(count=100, rate=200.0, num_taxels=4, channels=1, joint=None, **fields):
    frames = counting_recording(count, num_taxels, channels, rate=rate, **fields)
    return frames if joint is None else replace(frames, joint=joint)


class Page:
    """A page without a browser: answers each message after it was read."""

    def __init__(self, viewer, **kwargs):
        from websockets.sync.client import connect

        self.address = viewer.url.replace("http", "ws") + "live"
        self._open = ExitStack()
        self.socket = self._open.enter_context(connect(self.address, compression=None, **kwargs))

    def read(self, timeout=LONG):
        return unpack(self.socket.recv(timeout))

    def next(self, kind="frame"):
        deadline = time.monotonic() + LONG
        while time.monotonic() < deadline:
            head, arrays = self.read()
            self.say("shown")
            if head["kind"] == kind:
                return head, arrays
        raise TimeoutError(kind)

    def until(self, condition):
        deadline = time.monotonic() + LONG
        while time.monotonic() < deadline:
            head, arrays = self.read()
            self.say("shown")
            if condition(head):
                return head, arrays
        raise TimeoutError

    def say(self, kind, **content):
        self.socket.send(json.dumps({"kind": kind, **content}))

    def __enter__(self):
        return self

    def read_to_the_end(self):
        while True:
            self.read()

    def __exit__(self, *error):
        self._open.close()


def ask(viewer, path="/", headers=None, method="GET"):
    host, port = viewer.url[7:-1].split(":")
    connection = http.client.HTTPConnection(host, int(port), timeout=LONG)
    connection.putrequest(method, path, skip_host=True)
    for name, value in headers or [("Host", f"{host}:{port}")]:
        connection.putheader(name, value)
    connection.endheaders()
    response = connection.getresponse()
    body = response.read()
    connection.close()
    return response, body


def wait(condition):
    deadline = time.monotonic() + LONG
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.01)
