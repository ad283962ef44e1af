import json
import socket
import threading
import time
from contextlib import ExitStack
from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("websockets", reason="needs the extra 'live'")

from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

from torch_geometric_tactile.data import Recording
from torch_geometric_tactile.io._xela_message import format_xela_message, parse_xela_message
from torch_geometric_tactile.live import ReplayServer
from torch_geometric_tactile.live.replay_server import _Messages


def a_recording(frames=40, rate=400, **more):
    draw = np.random.default_rng(0)
    counts = draw.integers(0, 65536, (frames, 24, 3)).astype(np.float32)
    meta = {"unit": "count", "taxels": [16, 8], "models": ["XR1944", "é"], "handedness": ["left"]}
    return Recording(
        np.arange(frames) / rate, counts, meta={**meta, **more.pop("meta", {})}, **more
    )


def received(url, number=None):
    with connect(url) as one:
        return [json.loads(text) for text, _ in zip(one, range(number or 10**6), strict=False)]


@pytest.mark.parametrize(("frames", "span"), [(1, 0.01), (2, 0.5), (5, 1.25)])
def test_a_loop_begins_anew_one_step_after_the_last_frame(frames, span):
    messages = _Messages(a_recording(frames, rate=4))
    assert messages.seconds(frames) == span
    assert messages.frame_at(span) == frames


def test_clients_get_what_the_server_of_xela_sends():
    recording = a_recording()
    with ReplayServer(recording, port=0) as server:
        messages = received(server.url)
        assert server.wait(10)
        assert server.sent == 40
    assert messages[0] == {"message": "Welcome"}
    for i, message in enumerate(messages[1:]):
        expected = format_xela_message(
            recording.tactile[i],
            i + 1,
            message["time"],
            taxels=[16, 8],
            models=["XR1944", "é"],
            handedness=["left", "right"],
        )
        assert message.pop("sendtime") > 1e9
        expected.pop("sendtime")
        assert json.dumps(message) == json.dumps(expected)
    steps = np.diff([message["time"] for message in messages[1:]])
    assert steps == pytest.approx(1 / 400, abs=1e-5)


def test_several_clients_get_the_same_numbers():
    recording = a_recording(frames=100)
    found = []
    with ReplayServer(recording, port=0) as server:
        threads = [
            threading.Thread(target=lambda: found.append(received(server.url))) for _ in range(3)
        ]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join(30)
    assert len(found) == 3
    for messages in found:
        numbers = [message["message"] for message in messages[1:]]
        assert numbers == list(range(numbers[0], 101))
        for message in messages[1:]:
            reading = parse_xela_message(message).reading
            assert (reading == recording.tactile[message["message"] - 1]).all()


def test_numbers_go_on_in_a_loop_and_tell_of_losses():
    recording = a_recording(4, extra={"sequence": np.array([7, 8, 11, 12])})
    with ReplayServer(recording, port=0, speed=4, loop=True) as server:
        messages = received(server.url, 10)
        assert server.clients == 0 or not server.wait(0)
    numbers = [message["message"] for message in messages[1:]]
    assert numbers == [1, 2, 5, 6, 7, 8, 11, 12, 13]


def test_client_that_comes_late_gets_the_present():
    with ReplayServer(a_recording(1000, rate=200), port=0) as server:
        early = received(server.url, 40)
        late = received(server.url, 2)
    assert early[1]["message"] == 1
    assert late[1]["message"] >= early[-1]["message"]


def test_client_that_is_two_seconds_late_misses_frames(monkeypatch):
    clock = SimpleNamespace(late=0.0, time=time.time)
    clock.perf_counter = lambda: time.perf_counter() + clock.late
    monkeypatch.setattr("torch_geometric_tactile.live.replay_server.time", clock)
    with ReplayServer(a_recording(2000, rate=100), port=0) as server, connect(server.url) as one:
        assert "Welcome" in one.recv(20)
        numbers = (json.loads(one.recv(20))["message"] for _ in range(2000))
        steps = (after - before for before, after in pairwise(numbers))
        clock.late = 0.5
        assert {next(steps) for _ in range(80)} == {1}
        clock.late = 3.5  # messages on their way to the client still arrive
        assert next(step for step in steps if step > 1) > 100


def test_pages_of_others_are_refused():  # as in test_viewer_page.py, for all servers
    with ReplayServer(a_recording(), port=0, loop=True) as server:
        with connect(server.url, origin=server.url.replace("ws", "http")) as own:
            assert "Welcome" in own.recv(20)
        with pytest.raises(InvalidStatus, match="403"):
            connect(server.url, origin="http://evil.example").close()


def test_many_clients_are_refused_and_cost_no_threads():
    before = threading.active_count()
    with ReplayServer(a_recording(), port=0, loop=True) as server, ExitStack() as kept:
        lines = [
            kept.enter_context(socket.create_connection(("127.0.0.1", server.port), timeout=20))
            for _ in range(60)
        ]
        assert threading.active_count() == before + 1
        for line in lines:
            line.sendall(
                f"GET / HTTP/1.1\r\nHost: 127.0.0.1:{server.port}\r\nUpgrade: websocket\r\n"
                "Connection: Upgrade\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n"
                "Sec-WebSocket-Version: 13\r\n\r\n".encode()
            )
        answers = [line.recv(12) for line in lines]
        assert answers.count(b"HTTP/1.1 101") == 32
        assert answers.count(b"HTTP/1.1 503") == 28
        assert threading.active_count() == before + 1


def test_client_that_never_reads_does_not_keep_the_server():
    recording = a_recording(20000, rate=10000)
    with (
        ReplayServer(recording, port=0) as server,
        connect(server.url, max_queue=1, close_timeout=0.1),
    ):
        assert not server.wait(0.3)
        server.close()
        server.close()


@pytest.mark.parametrize(
    ("taxels", "sensors"),
    [([16, 8], 2), ([24], 1), ([16, 4], 1), ([30, -6], 1), ([16.0, 8.0], 1), ("16", 1), (None, 1)],
    ids=str,
)
def test_taxels_of_sensors_that_do_not_add_up_are_one_sensor(taxels, sensors):
    with ReplayServer(a_recording(meta={"taxels": taxels}), port=0) as server:
        message = received(server.url, 2)[1]
    assert message["sensors"] == sensors
    assert sum(message[str(i + 1)]["taxels"] for i in range(sensors)) == 24


@pytest.mark.parametrize(
    ("recording", "settings", "match"),
    [
        (a_recording(meta={"unit": "newton"}), {}, "must hold counts of 3 channels"),
        (a_recording().select(slice(0, 0)), {}, "at least one frame"),
        (a_recording(), {"speed": 0}, "'speed' must be positive"),
        (a_recording(), {"speed": float("inf")}, "'speed' must be positive and finite"),
        (
            Recording([0.0], np.full((1, 2, 3), np.nan)),
            {},
            "from 0 to 65535 .*got nan in frame 0, taxel 0, axis x",
        ),
        (Recording([0.0], np.full((1, 2, 3), 0.5)), {}, "got 0.5 in frame 0"),
    ],
    ids=["unit", "empty", "speed", "infinite", "missing", "fraction"],
)
def test_what_the_server_of_xela_could_not_send(recording, settings, match):
    with pytest.raises(ValueError, match=match):
        ReplayServer(recording, port=0, **settings)


def test_repr_and_address():
    server = ReplayServer(a_recording(), port=5005)
    assert repr(server) == "ReplayServer('ws://127.0.0.1:5005', num_frames=40)"
    assert ReplayServer(a_recording(), host="::1").url == "ws://[::1]:5000"
