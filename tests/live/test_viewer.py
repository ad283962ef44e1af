import socket
import subprocess
import sys
import threading
import time
from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("websockets", reason="needs the extra 'live'")

from viewer_pages import LONG, Page, ask, recording, wait
from websockets.exceptions import ConnectionClosed

from torch_geometric_tactile.data import LiveFrame, Recording
from torch_geometric_tactile.live import ReplaySource, Stream, StreamEnded, Viewer


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
        # Milliseconds, from its arrival to the answer of the page.
        assert 400 < second["age"] < 1000 * LONG


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


def test_given_rest_goes_first_where_it_fits_and_other_taxels_begin_anew(stream):
    def shown(time, value, shape=(2, 1)):
        reading = np.full(shape, value, np.float32)
        return viewer._relative(LiveFrame(0, time, int(time * 1e9), None, reading)).ravel().tolist()

    viewer = Viewer(stream)
    viewer.rest = np.full((2, 1), 5.0)
    assert shown(0.0, 7.0) == [2.0, 2.0]
    assert shown(0.0, 7.0, (3, 1)) == [0.0] * 3
    viewer.rest = None
    assert shown(1.0, 7.0, (4, 3)) == [0.0] * 12
    assert shown(3.0, 9.0, (4, 3)) == [1.0] * 12
    assert shown(4.0, 9.0) == [0.0] * 2


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


def test_buttons_are_heeded_one_after_another(viewer):
    calls = []
    viewer.on_tare = lambda: (time.sleep(0.2), calls.append("tare"))
    viewer.on_record = lambda: calls.append("record")
    with Page(viewer) as page:
        page.say("tare")
        page.say("record", on=True)
        page.next()  # the picture does not wait for them
        wait(lambda: len(calls) == 2)
    assert calls == ["tare", "record"]


def test_of_many_presses_one_waits(viewer):
    calls, go_on = [], threading.Event()
    viewer.on_tare = lambda: (calls.append("tare"), go_on.wait(LONG))
    viewer.on_record = lambda: calls.append("record")
    with Page(viewer) as page:
        for _ in range(300):
            page.say("tare")
        page.say("record", on=True)
        wait(lambda: calls)
        page.next()
        page.next()  # all presses were taken
        go_on.set()
        wait(lambda: "record" in calls)
    assert calls in (["tare", "tare", "record"], ["tare", "record"])


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
        ("multilabel", "no contact", [np.nan, np.nan], "no contact"),
        ("regression", "no contact", [np.nan, np.nan], "no contact"),
        ("regression", "", [12.5, -3.0], ""),
    ],
)
def test_judgement_is_shown(viewer, task, label, probability, shown):
    now = time.perf_counter_ns()
    viewer.judgement(
        SimpleNamespace(
            label=label,
            task=task,
            class_names=("cup", "box"),
            probability=np.array(probability, np.float32),
            lacks_contact=label == "no contact",
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
        assert "Layout biotac_sp has 24 taxels, but frames have 4" in head["notes"][0][2]


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
    wait(lambda: viewer.clients == 0)


def test_closed_page_gives_its_subscription_up(stream, monkeypatch):
    kept, subscribe = [], stream.subscribe
    monkeypatch.setattr(
        stream, "subscribe", lambda policy: kept.append(subscribe(policy)) or kept[-1]
    )
    with Viewer(stream) as viewer:
        assert kept == []  # without a page, nothing is read
        with Page(viewer) as page:
            page.next()
        wait(lambda: viewer.clients == 0)
        with pytest.raises(StreamEnded):
            kept[0].get(timeout=0)
        assert kept[0].policy == "newest"


def test_close_ends_pages_and_threads(stream):
    before = set(threading.enumerate())
    viewer = Viewer(stream)
    viewer.close()
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


def test_port_that_is_taken(stream, viewer):
    port = int(viewer.url[:-1].rpartition(":")[2])
    with pytest.raises(OSError, match=f"the viewer cannot use 127.0.0.1:{port}: Address already"):
        Viewer(stream, port=port).start()


def test_layout_that_does_not_fit_is_told_before_the_viewer_runs(stream):
    with pytest.raises(ValueError, match="'layout' must be one of"):
        Viewer(stream, "no_such_layout")
    with pytest.raises(ValueError, match="'joint' must have shape"):
        Viewer(stream, "allegro_uskin", joint=np.zeros(3))
    named = Stream(ReplaySource(recording(meta={"sensor": "allegro_uskin"})))
    with named, pytest.raises(ValueError, match="'joint' must have shape"):
        Viewer(named, joint=np.zeros(3)).start()


def test_repr_and_address(stream):
    assert repr(Viewer(stream, port=8000)) == "Viewer('http://127.0.0.1:8000/')"
    assert Viewer(stream, host="::1", port=80).url == "http://[::1]:80/"
    assert Viewer(stream, host="0.0.0.0", port=80).url == "http://127.0.0.1:80/"


def test_websockets_is_an_extra(stream, monkeypatch):
    monkeypatch.setitem(sys.modules, "websockets", None)
    with pytest.raises(ImportError, match=r"pip install 'torch-geometric-tactile\[live\]'"):
        Viewer(stream)


def test_viewer_needs_no_torch():
    code = """
import sys
for name in ("torch", "torch_geometric", "scipy"):
    sys.modules[name] = None
import numpy as np
from websockets.sync.client import connect
from torch_geometric_tactile.data import LiveFrame
from torch_geometric_tactile.live import Source, Stream, Viewer

class Two(Source):
    def open(self): pass
    def close(self): pass
    def read(self, timeout):
        import time
        time.sleep(0.01)
        now = time.perf_counter_ns()
        return [LiveFrame(0, now / 1e9, now, None, np.zeros((2, 3), np.float32))]

with Stream(Two("two:", {"sensor": "biotac"})) as stream, Viewer(stream) as viewer:
    with connect(viewer.url.replace("http", "ws") + "live", compression=None) as page:
        seen = b""
        while b'"form":"numbers"' not in seen or b"needs PyTorch" not in seen:
            seen += page.recv(20)
            page.send('{"kind": "shown"}')
"""
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=False
    )
    assert done.returncode == 0, done.stderr


def test_annotations_of_a_replayed_recording_come_with_the_layout():
    spans = [(7.5, 8, "slip"), (8, 99, "<b>")]
    replayed = Recording(7 + np.arange(21) / 10, np.zeros((21, 4, 1)), annotations=spans)
    source = ReplaySource(replayed, speed=20, loop=True)
    with Stream(source) as stream, Viewer(stream) as viewer, Page(viewer) as page:
        head, _ = page.next("layout")
        assert head["spans"] == [[0.25, 0.5, "slip"], [0.5, 46.0, "<b>"]]
        page.say("shown")
        for _ in range(5):
            head, _ = page.next("frame")
            place = head["sequence"] % 21 / 20
            assert head["place"] == pytest.approx(place)


def test_an_annotation_that_is_recorded_is_told(viewer):
    with Page(viewer) as page:
        head, _ = page.next("layout")
        assert head["spans"] == []
        page.say("shown")
        head, _ = page.next("frame")
        assert head["place"] is None
        viewer.annotation = "slip"
        wait(lambda: page.next("frame")[0].get("annotation") == "slip")
