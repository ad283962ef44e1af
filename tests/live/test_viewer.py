import http.client
import json
import socket
import threading
import time
from contextlib import ExitStack
from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("websockets", reason="needs the extra 'live'")

from viewer_messages import unpack
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect

from torch_geometric_tactile.data import Recording
from torch_geometric_tactile.live import ReplaySource, Stream, Viewer

LONG = 20.0
SHOWN = json.dumps({"kind": "shown"})


def recording(count=100, rate=200.0, num_taxels=4, channels=1, **kwargs):
    number = np.arange(count, dtype=np.float32)
    tactile = np.broadcast_to(number[:, None, None], (count, num_taxels, channels))
    return Recording(np.arange(count) / rate, tactile, **kwargs)


@pytest.fixture
def stream():
    with Stream(ReplaySource(recording(meta={"unit": "count"}), loop=True)) as stream:
        yield stream


@pytest.fixture
def viewer(stream):
    with Viewer(stream) as viewer:
        yield viewer


class Page:
    """A page without a browser: answers each message after it was read."""

    def __init__(self, viewer, **kwargs):
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


def test_page_forbids_everything_that_is_not_in_it(viewer):
    response, body = ask(viewer)
    assert response.status == 200
    assert response.getheader("Content-Type") == "text/html; charset=utf-8"
    policy = dict(
        rule.strip().split(" ", 1)
        for rule in response.getheader("Content-Security-Policy").split(";")
    )
    assert policy["default-src"] == "'none'"
    assert policy["frame-ancestors"] == "'none'"
    assert policy["connect-src"] == f"'self' {viewer.url.replace('http', 'ws')[:-1]}"
    for kind in ("script-src", "style-src"):
        assert policy[kind].startswith("'sha256-")
        assert "unsafe" not in policy[kind]
    assert b"http://" not in body.replace(b"http://www.w3.org/2000/svg", b"")
    assert b"https://" not in body
    assert response.getheader("X-Frame-Options") == "DENY"
    assert response.getheader("Cache-Control") == "no-store"


@pytest.mark.parametrize(
    "host",
    [
        "evil.example",
        "evil.example:{port}",
        "127.0.0.1.evil.example:{port}",
        "localhost.evil.example",
        "192.0.2.1:{port}",
        "localhost@evil.example",
        "[::1",
        "",
    ],
)
@pytest.mark.parametrize("path", ["/", "/live", "/other"])
def test_foreign_host_is_refused(viewer, host, path):
    name = host.format(port=viewer.url[:-1].rpartition(":")[2])
    response, body = ask(viewer, path, [("Host", name)])
    assert response.status == 403
    assert b"<html" not in body


def test_no_host_or_two_are_refused(viewer):
    assert ask(viewer, headers=[("Accept", "*/*")])[0].status == 403
    own = viewer.url[7:-1]
    assert ask(viewer, headers=[("Host", own), ("Host", "evil.example")])[0].status == 403


@pytest.mark.parametrize("host", ["localhost", "localhost:9", "LOCALHOST:8000", "127.0.0.1:1234"])
def test_names_of_this_machine_are_taken_with_any_port(viewer, host):
    assert ask(viewer, headers=[("Host", host)])[0].status == 200


@pytest.mark.parametrize("origin", ["http://evil.example", "null", "http://localhost:3000"])
def test_foreign_origin_is_refused(viewer, origin):
    own = viewer.url[7:-1]
    assert ask(viewer, headers=[("Host", own), ("Origin", origin)])[0].status == 403
    with pytest.raises(InvalidStatus) as refused:
        Page(viewer, origin=origin)
    assert refused.value.response.status_code == 403


def test_own_origin_is_taken(viewer):
    with Page(viewer, origin=viewer.url[:-1]) as page:
        assert page.next("layout")[0]["form"] == "numbers"


def test_other_paths_are_not_found(viewer):
    assert ask(viewer, "/secret")[0].status == 404
    assert ask(viewer, "/?x=1")[0].status == 200


def test_layout_comes_once_then_frames(viewer, stream):
    with Page(viewer) as page:
        head, arrays = page.read()
        assert head["kind"] == "layout"
        assert (head["unit"], head["channels"], head["source"]) == ("count", 1, stream.source.name)
        assert arrays["pos"].shape == (4, 3)
        page.say("shown")
        for _ in range(5):
            head, arrays = page.next("frame")
            assert arrays["tactile"].shape == (4, 1)
            assert "pose" not in arrays or head["sequence"] < 1000


def test_next_frame_waits_for_the_one_before_and_is_new(viewer):
    with Page(viewer) as page:
        page.next("layout")
        first, _ = page.read()
        with pytest.raises(TimeoutError):
            page.read(timeout=0.5)
        page.say("shown")
        second, _ = page.read()
        assert second["sequence"] > first["sequence"] + 50  # at 200 frames per second
        assert second["oldest"] is None or second["oldest"] > 400
        assert second["age"] > 400  # milliseconds, from its arrival to the answer of the page


def test_pages_get_frames_of_their_own(viewer):
    with Page(viewer) as slow, Page(viewer) as fast:
        slow.next("layout")
        numbers = [fast.next()[0]["sequence"] for _ in range(5)]
        assert len(set(numbers)) == 5


def test_readings_are_relative_to_the_rest(viewer):
    viewer.rest = np.full((4, 1), 1000.0)
    with Page(viewer) as page:
        _, arrays = page.next()
        assert -1000 <= arrays["tactile"].max() < -800
        viewer.rest = None
        assert viewer.rest is None
        head, _ = page.until(lambda head: head.get("rest") == "measured")
        assert head["health"]["state"] == "open"


def test_missing_readings_stay_missing():
    tactile = np.zeros((50, 3, 1), np.float32)
    tactile[:, 1] = np.nan
    source = ReplaySource(Recording(np.arange(50) / 100, tactile), loop=True)
    with Stream(source) as stream, Viewer(stream) as viewer, Page(viewer) as page:
        _, arrays = page.next()
        assert np.isnan(arrays["tactile"][:, 0]).tolist() == [False, True, False]


def test_tare_calls_back_or_measures_anew(viewer):
    pressed = threading.Event()
    with Page(viewer) as page:
        page.until(lambda head: head.get("rest") == "measured")
        page.say("tare")
        page.until(lambda head: head.get("rest") == "measuring")
        viewer.on_tare = pressed.set
        page.say("tare")
        assert pressed.wait(LONG)


def test_record_button(viewer):
    calls = []

    def toggle():
        calls.append(viewer.recording)
        viewer.recording = not viewer.recording

    with Page(viewer) as page:
        assert page.until(lambda head: "can_record" in head)[0]["can_record"] is False
        heeded = threading.Event()
        viewer.on_tare = heeded.set
        page.say("record", on=True)  # nobody to call
        page.say("tare")
        assert heeded.wait(LONG)
        viewer.on_record = toggle
        page.until(lambda head: head.get("can_record"))
        page.say("record", on=False)  # nothing to end
        page.say("record", on=True)
        page.until(lambda head: head.get("recording") is not None)
        page.say("record", on=True)  # of a page that does not know it yet
        page.say("record", on=False)
        wait(lambda: len(calls) == 2)
        page.until(lambda head: "recording" in head and head["recording"] is None)
    assert calls == [False, True]


def test_error_of_a_callback_is_told_on_the_page(viewer):
    def fail():
        raise OSError("no space left on device")

    viewer.on_record = fail
    with Page(viewer) as page:
        page.say("record", on=True)
        head, _ = page.until(lambda head: head.get("notes"))
        assert head["notes"][0][2] == "The recording failed: no space left on device"
        page.next()


def test_notes_come_once_and_to_pages_that_open_later(viewer):
    viewer.note("first")
    with Page(viewer) as page:
        assert page.until(lambda head: head.get("notes"))[0]["notes"][0][2] == "first"
        viewer.note("second")
        assert [n[2] for n in page.until(lambda h: h.get("notes"))[0]["notes"]] == ["second"]
    with Page(viewer) as page:
        head, _ = page.until(lambda head: head.get("notes"))
        assert [note[2] for note in head["notes"]] == ["first", "second"]


@pytest.mark.parametrize(
    ("task", "label", "probability", "shown"),
    [
        ("multiclass", "cup", [0.75, 0.25], "cup"),
        ("multiclass", "a;b", [0.75, 0.25], "a;b"),
        ("multilabel", "cup;box", [0.75, 0.5625], "cup, box"),
        ("multilabel", "", [0.25, 0.125], "none"),
        ("multiclass", "", [np.nan, 0.25], "no answer"),
        ("regression", "", [12.5, -3.0], ""),
    ],
)
def test_judgement_is_shown(viewer, task, label, probability, shown):
    now = time.monotonic_ns()
    viewer.judgement(
        SimpleNamespace(
            label=label,
            task=task,
            class_names=("cup", "box"),
            probability=np.array(probability, np.float32),
            received=now - 3_000_000,
            finished=now,
        )
    )
    with Page(viewer) as page:
        head, _ = page.until(lambda head: head.get("judgement"))
    judgement = head["judgement"]
    assert (judgement["label"], judgement["names"]) == (shown, ["cup", "box"])
    sent = [None if np.isnan(one) else one for one in probability]
    assert judgement["probability"] == sent
    assert judgement["latency"] == 3.0


@pytest.mark.parametrize("junk", ["", "[]", "{", "12", '{"kind": 1}', "[" * 900, b"\xff\x00"])
def test_junk_of_a_page_is_ignored(viewer, junk):
    with Page(viewer) as page:
        page.next()
        page.socket.send(junk)
        page.next()


def test_long_message_closes_that_page_only(viewer):
    with Page(viewer) as page, Page(viewer) as other:
        page.socket.send("x" * 2000)
        with pytest.raises(ConnectionClosed):
            page.read_to_the_end()
        other.next()


def test_too_many_pages(viewer):
    pages = [Page(viewer) for _ in range(8)]
    for page in pages:
        page.next()
    with pytest.raises(InvalidStatus) as refused:
        Page(viewer)
    assert refused.value.response.status_code == 503
    pages[0].socket.close()
    wait(lambda: viewer._pages < 8)
    with Page(viewer) as page:
        page.next()
    for page in pages:
        page.socket.close()


def test_end_and_error_of_the_stream_are_told():
    class Fails(ReplaySource):
        def read(self, timeout):
            frames = super().read(timeout)
            if frames and frames[-1].sequence > 40:
                raise RuntimeError("the cable burns")
            return frames

    for source, error in ((ReplaySource, None), (Fails, "the cable burns")):
        with Stream(source(recording(60))) as stream, Viewer(stream) as viewer:
            with Page(viewer) as page:
                head, _ = page.until(lambda h: h.get("health", {}).get("state") == "ended")
            assert head["health"]["error"] == error


def test_viewer_may_start_before_the_stream():
    source = ReplaySource(recording(num_taxels=24, meta={"sensor": "biotac_sp"}), loop=True)
    stream = Stream(source)
    with Viewer(stream) as viewer, Page(viewer) as page:
        assert page.until(lambda head: True)[0]["health"]["state"] == "closed"
        with stream:
            assert page.next("layout")[0]["layout"] == "biotac_sp"
            page.next()


def test_layout_of_another_size_is_told_and_shown_by_number(stream):
    with Viewer(stream, "biotac_sp") as viewer, Page(viewer) as page:
        assert page.next("layout")[0]["form"] == "numbers"
        head, _ = page.until(lambda head: head.get("notes"))
        assert "Layout biotac_sp has 24 taxels, and frames have 4" in head["notes"][0][2]


def test_pose_comes_only_when_the_joints_move():
    joint = np.zeros((400, 16), np.float32)
    joint[200:] = 0.2
    frames = recording(400, 100.0, 384, 3, joint=joint, meta={"sensor": "allegro_uskin"})
    with (
        Stream(ReplaySource(frames, loop=True)) as stream,
        Viewer(stream) as viewer,
        Page(viewer) as page,
    ):
        page.next("layout")
        posed = [page.next() for _ in range(20)]
    with_pose = [arrays["pose"] for _, arrays in posed if "pose" in arrays]
    assert 1 <= len(with_pose) <= 3
    assert with_pose[0].shape == (21, 12)


@pytest.mark.parametrize("joint", [np.zeros(3, np.float32), np.full(16, np.nan, np.float32)])
def test_joint_angles_that_pose_nothing_leave_the_hand_as_it_is(joint):
    joints = np.broadcast_to(joint, (50, len(joint)))
    frames = recording(50, 100.0, 384, 3, joint=joints, meta={"sensor": "allegro_uskin"})
    with (
        Stream(ReplaySource(frames, loop=True)) as stream,
        Viewer(stream) as viewer,
        Page(viewer) as page,
    ):
        _, layout = page.next("layout")
        _, arrays = page.next()
    np.testing.assert_array_equal(arrays["pose"], layout["pose"])


def test_a_page_that_sleeps_or_vanishes_costs_others_nothing(stream, viewer):
    everything = stream.subscribe("all")
    with Page(viewer) as page:
        page.next()  # and never answers again
        vanishing = Page(viewer)
        vanishing.next()
        vanishing.socket.socket.shutdown(socket.SHUT_RDWR)
        numbers = [everything.get(LONG).sequence for _ in range(200)]
    assert numbers == list(range(numbers[0], numbers[0] + 200))
    assert not everything.overflowed
    wait(lambda: viewer._pages == 0)


def test_close_ends_pages_and_threads(stream):
    before = set(threading.enumerate())
    viewer = Viewer(stream)
    viewer.start()
    viewer.start()
    viewer.on_tare = lambda: None
    page = Page(viewer)
    page.say("tare")
    page.next()
    viewer.close()
    viewer.close()
    with pytest.raises(ConnectionClosed):
        page.read_to_the_end()
    page.socket.close()
    wait(lambda: set(threading.enumerate()) <= before)
    with pytest.raises(ConnectionRefusedError):
        ask(viewer)


def test_close_without_start(stream):
    Viewer(stream).close()


def test_port_that_is_taken(stream, viewer):
    port = int(viewer.url[:-1].rpartition(":")[2])
    with pytest.raises(OSError, match=f"the viewer cannot use 127.0.0.1:{port}: Address already"):
        Viewer(stream, port=port).start()


def test_unknown_layout(stream):
    with pytest.raises(ValueError, match="'layout' must be one of"):
        Viewer(stream, "no_such_layout")


def test_wrong_number_of_joints(stream):
    with pytest.raises(ValueError, match="'joint' must have shape"):
        Viewer(stream, "allegro_uskin", joint=np.zeros(3))


def test_repr_and_address(stream):
    assert repr(Viewer(stream, port=8000)) == "Viewer('http://127.0.0.1:8000/')"
    assert Viewer(stream, host="::1", port=80).url == "http://[::1]:80/"
    assert Viewer(stream, host="0.0.0.0", port=80).url == "http://127.0.0.1:80/"


def test_other_machines_only_with_a_warning(stream, caplog):
    with Viewer(stream, host="0.0.0.0") as viewer:
        assert ask(viewer)[0].status == 200
        assert "may press its buttons" in caplog.text
        assert ask(viewer, headers=[("Host", "robot.example")])[0].status == 403


def test_websockets_is_an_extra(stream, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "websockets", None)
    with pytest.raises(ImportError, match=r"pip install 'torch-geometric-tactile\[live\]'"):
        Viewer(stream)
