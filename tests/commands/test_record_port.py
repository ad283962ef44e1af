"""Commands that record a real pseudo terminal or WebSocket, with a layout."""

# ruff: noqa: E402
import json
import os
import re
import subprocess
import sys
import threading
import time
from contextlib import contextmanager

import numpy as np
import pytest

for module in ("mcap", "google.protobuf", "zstandard", "websockets", "cobs"):
    pytest.importorskip(module, reason="needs the extra 'live'")
if sys.platform == "win32":
    pytest.skip("needs pseudo terminals", allow_module_level=True)

from ptys import FakePort
from xela_websocket import server

from torch_geometric_tactile.cli import main
from torch_geometric_tactile.io import encode_packet, read_recording
from torch_geometric_tactile.io._xela_message import format_xela_message
from torch_geometric_tactile.live import (
    LiveSession,
    Stream,
    TaxelMap,
    XelaSource,
)
from torch_geometric_tactile.live.taxel_map import TaxelOrder
from torch_geometric_tactile.sensors import allegro_uskin_368, grid

SENDER = """
import os, sys, time, numpy as np
from torch_geometric_tactile.io import encode_packet
line, rate = int(sys.argv[1]), float(sys.argv[2])
os.set_blocking(line, False)
packets = [np.full((16, 3), i, np.uint16) for i in range(100)]
start, number = time.monotonic(), 0
while True:
    try:
        os.write(line, encode_packet(number, packets[number % 100]))
    except BlockingIOError:  # nobody reads: lost, as on a cable
        pass
    number += 1
    time.sleep(max(0.0, start + number / rate - time.monotonic()))
"""


@contextmanager
def sending(tmp_path, rate):
    """The path of a port on which packets with numbers come from another process."""
    port = FakePort(tmp_path / "ttyFAKE")
    command = [sys.executable, "-c", SENDER, str(port.master), str(rate)]
    with subprocess.Popen(command, pass_fds=[port.master]) as child:
        try:
            yield port.path
        finally:
            child.kill()
    port.close()


def run(*arguments, cwd=None):
    command = [sys.executable, "-m", "torch_geometric_tactile", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, cwd=cwd, timeout=120)


@pytest.mark.slow
@pytest.mark.parametrize("verb", ["record", "live"])
def test_layout_costs_no_frame_and_seconds_are_kept(tmp_path, verb):
    # PyTorch is loaded for a layout, which takes seconds: a port keeps 4 kB, 0.07 s at this rate.
    grid(4, 4, pitch=0.01).save(tmp_path / "pad.json")
    file = ["a.mcap"] if verb == "record" else ["--record", "a.mcap"]
    with sending(tmp_path, 500.0) as path:
        source = f"serial:{path}?protocol=cobs"
        done = run(verb, source, *file, "--layout", "pad.json", "--seconds", "1.5", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    said = done.stdout + done.stderr
    assert re.search(r"\d+ lost .*and \d corrupt in transmission", said)
    recording = read_recording(tmp_path / "a.mcap")
    numbers = recording.extra["sequence"]
    # A machine that stops this process for longer than the port keeps loses frames of its own.
    assert numbers[-1] - numbers[0] + 1 - len(numbers) <= 10
    assert recording.duration == pytest.approx(1.5, abs=0.1)
    assert recording.meta["sensor"] == "grid_4x4"


@pytest.mark.slow
def test_recording_that_begins_while_live_runs_loses_no_frame(tmp_path):
    from ptys import Terminal

    grid(4, 4, pitch=0.01).save(tmp_path / "pad.json")
    with sending(tmp_path, 200.0) as path:
        source = f"serial:{path}?protocol=cobs"
        terminal = Terminal(tmp_path, "live", source, "--layout", "pad.json")
        terminal.until("Hz")
        terminal.press("r")
        terminal.until("recording 2")
        time.sleep(1.0)
        terminal.press("r")
        terminal.until("wrote 2")
        terminal.press("q")
        terminal.until("corrupt in transmission")
        terminal.end()
    (file,) = tmp_path.glob("*.mcap")
    recording = read_recording(file)
    numbers = recording.extra["sequence"]
    assert numbers[-1] - numbers[0] + 1 - len(numbers) <= 10
    assert recording.duration > 0.5


@pytest.mark.slow
def test_outage_of_a_port_is_in_the_last_line_and_in_the_file(tmp_path, capsys):
    port = FakePort(tmp_path / "ttyFAKE")
    over = threading.Event()

    def send():
        number = 0
        while not over.wait(0.01):
            if not 100 <= number < 170:
                port.write(encode_packet(number, np.full((4, 3), number, np.uint16)))
            number += 1

    sender = threading.Thread(target=send)
    sender.start()
    source = f"serial:{port.path}?protocol=cobs"
    status = main(["record", source, str(tmp_path / "a.mcap"), "--seconds", "2.5"])
    over.set()
    sender.join()
    port.close()
    assert status == 0
    said = capsys.readouterr().out
    assert re.search(r"frames in 2\.\d+ s, [1-9] outages?, [0-9.]+ s; \d+ frames lost other", said)
    recording = read_recording(tmp_path / "a.mcap")
    gap = max(recording.annotations, key=lambda a: a.end - a.start)
    assert gap.label == "gap"
    assert gap.end - gap.start == pytest.approx(0.71, abs=0.25)
    assert main(["inspect", str(tmp_path / "a.mcap"), "--no-picture"]) == 0
    assert re.search(r"gaps +[1-9], [0-9.]+ s without frames", capsys.readouterr().out)


ORDER = np.arange(368 * 3, dtype=np.uint16).reshape(368, 3)
IN_LAYOUT = TaxelMap.load("xela_allegro_368").apply(ORDER.astype(np.float32))


@contextmanager
def hand(model="XR23AHRCPP", counts=ORDER):
    """The URL of a server that sends the readings of a hand in the order of its wiring."""
    over = threading.Event()

    def send_all(send):
        number = 0
        while not over.wait(0.01):
            number += 1
            message = format_xela_message(counts, number, time.time(), models=[model])
            send(json.dumps(message))

    with server() as (url, send):
        sender = threading.Thread(target=send_all, args=(send,))
        sender.start()
        try:
            yield url
        finally:
            over.set()
            sender.join()


@pytest.mark.slow
@pytest.mark.parametrize("verb", ["record", "live"])
@pytest.mark.parametrize(
    ("layout", "options", "expected"),
    [
        ("allegro_uskin_368", [], IN_LAYOUT),
        ("allegro_uskin_368", ["--map", "xela_allegro_368"], IN_LAYOUT),
        ("allegro_uskin_368", ["--map", "none"], ORDER),
        (
            "allegro_uskin",
            [],
            TaxelMap.load("xela_allegro_368_to_384").apply(ORDER.astype(np.float32)),
        ),
    ],
    ids=["automatic", "given", "none", "384"],
)
def test_taxels_of_a_hand_are_recorded_in_the_order_of_the_layout(
    tmp_path, verb, layout, options, expected
):
    path = str(tmp_path / "a.mcap")
    file = [path] if verb == "record" else ["--record", path]
    with hand() as url:
        assert main([verb, url, *file, "--layout", layout, "--seconds", "0.3", *options]) == 0
    recording = read_recording(path)
    assert recording.meta["sensor"] == layout
    for tactile in recording.tactile:
        np.testing.assert_array_equal(tactile, expected)


@pytest.mark.slow
@pytest.mark.parametrize("verb", ["record", "live", "view"])
def test_unknown_order_of_a_layout_is_refused_before_anything_is_recorded(tmp_path, capsys, verb):
    path = str(tmp_path / "a.mcap")
    file = {"record": [path], "live": ["--record", path], "view": ["--no-browser"]}[verb]
    with hand("uSPa99") as url:
        assert main([verb, url, *file, "--layout", "allegro_uskin_368"]) == 1
    said = capsys.readouterr().err
    assert "(USPA99) sends 368 taxels in the order of its wiring" in said
    assert "--map FILE" in said
    assert not os.path.exists(path)


def test_view_takes_a_map(tmp_path, monkeypatch):
    from torch_geometric_tactile.commands import view

    seen = []

    def show(stream, viewer):
        frame = next(stream.subscribe())
        seen.append((frame.tactile, viewer.scenes.scene(368).name))

    monkeypatch.setattr(view, "_show_until_end", show)
    for options in ([], ["--map", "xela_allegro_368"], ["--map", "none"]):
        with hand() as url:
            more = ["--layout", "allegro_uskin_368", "--no-browser", *options]
            assert main(["view", url, *more]) == 0
    for (tactile, name), expected in zip(seen, (IN_LAYOUT, IN_LAYOUT, ORDER), strict=True):
        assert name == "allegro_uskin_368"
        np.testing.assert_array_equal(tactile, expected)


class StubJudge:
    """A judge that keeps the readings that it gets."""

    length = 1

    def __init__(self, layout, num_taxels):
        self.info = {"layout": layout, "num_taxels": num_taxels, "rest": None}
        self.rest = self.contact = None
        self.measures_rest = self.relative = False
        self.length, self.note = 1, ""
        self.seen = []

    def __call__(self, frame, predict=True):
        self.seen.append(frame.tactile)


@pytest.mark.parametrize(
    ("taxel_map", "expected"), [(None, IN_LAYOUT), ("none", ORDER)], ids=["automatic", "none"]
)
def test_model_gets_the_taxels_of_its_layout(taxel_map, expected):
    judge = StubJudge("allegro_uskin_368", 368)
    with (
        hand() as url,
        LiveSession(XelaSource(url), judge=judge, taxel_map=taxel_map) as session,
    ):
        session.run(0.3)
    assert judge.seen
    for tactile in judge.seen:
        np.testing.assert_array_equal(tactile, expected)


def test_taxel_map_must_be_one_or_none():
    with pytest.raises(ValueError, match="'taxel_map' must be a TaxelMap or 'none'"):
        LiveSession(XelaSource(), taxel_map="xela")


@pytest.mark.parametrize("layout", [TaxelOrder("allegro_uskin_368", 368), allegro_uskin_368()])
def test_other_sources_keep_their_order(layout):
    from fake_source import ended, frame

    source = ended(frame(0, tactile=ORDER.astype(np.float32)), sensor="allegro_uskin_368")
    stream = Stream(source, layout=layout)
    subscription = stream.subscribe()
    with stream:
        np.testing.assert_array_equal(subscription.get(20).tactile, ORDER)
    assert stream.taxel_map is None


def test_map_for_a_sensor():
    small = TaxelOrder("pad", 16)
    assert TaxelMap.for_sensor(["XR23AHRCPP"], 368, small) is None
    for models in (["XR23AHLCPP"], ["xr23ahrcpp"]):
        found = TaxelMap.for_sensor(models, 368, TaxelOrder("allegro_uskin", 384))
        assert len(found.index) == 384
    for models, name in (([], "an unknown model"), ([""], "an unknown model"), (["B"], "(B)")):
        with pytest.raises(ValueError, match=re.escape(name)):
            TaxelMap.for_sensor(models, 16, small)
