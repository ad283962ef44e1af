# ruff: noqa: E402
import json
import re
import signal
import subprocess
import sys
import threading
import time
from contextlib import suppress

import numpy as np
import pytest

for module in ("mcap", "google.protobuf", "zstandard", "websockets"):
    pytest.importorskip(module, reason="needs the extra 'live'")

from websockets.sync.client import connect
from xela_websocket import server

from torch_geometric_tactile.cli import main
from torch_geometric_tactile.data import Recording
from torch_geometric_tactile.io import encode_packet, read_recording
from torch_geometric_tactile.io._recording_npz import write_npz
from torch_geometric_tactile.live import ReplayServer

WRONG_XELA = '{"message": 7, "time": 0.5, "1": {"data": "0001,0002,00FF", "taxels": "16"}}'


@pytest.fixture
def whole(tmp_path):
    counts = np.arange(60 * 16 * 3, dtype=np.float32).reshape(60, 16, 3)
    recording = Recording(np.arange(60) / 100, counts, meta={"unit": "count"})
    write_npz(recording, tmp_path / "whole.npz")
    return recording


def start(*arguments):
    command = [sys.executable, "-m", "torch_geometric_tactile", *map(str, arguments)]
    return subprocess.Popen(
        command,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        bufsize=1,
        # In a job that a shell put into the background, Ctrl-C would be ignored.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )


@pytest.mark.parametrize("name", ["a.mcap", "a.h5"])
def test_record_keeps_what_a_source_sends(whole, tmp_path, capsys, name):
    if name == "a.h5":
        pytest.importorskip("h5py", reason="needs the extra 'io'")
    path = tmp_path / name
    source = f"{tmp_path / 'whole.npz'}?speed=4"
    assert main(["record", source, str(path), "--label", "mug"]) == 0
    assert f"{path}: 60 frames in 0.1" in capsys.readouterr().out
    found = read_recording(path)
    assert found.label == "mug"
    assert (found.tactile == whole.tactile).all()
    assert main(["record", source, str(path)]) == 1
    assert "exists: choose another name" in capsys.readouterr().err
    assert main(["record", source, str(path), "--overwrite", "--seconds", "0.05"]) == 0
    assert read_recording(path).label is None


def test_record_of_nothing_is_an_error_and_makes_no_file(tmp_path, capsys):
    assert main(["record", str(tmp_path / "none.npz"), str(tmp_path / "a.mcap")]) == 1
    assert "none.npz' does not exist" in capsys.readouterr().err
    assert [*tmp_path.iterdir()] == []


@pytest.mark.full
@pytest.mark.parametrize("verb", ["record", "live"])
def test_server_whose_messages_are_no_frames_is_explained_in_time(tmp_path, capsys, verb):
    file = [str(tmp_path / "a.mcap")] if verb == "record" else []
    over = threading.Event()
    with server() as (url, send):
        sender = threading.Thread(target=_send_until, args=(send, WRONG_XELA, over))
        sender.start()
        status = main([verb, url, *file, "--seconds", "0.5"])
        over.set()
        sender.join()
    said = capsys.readouterr().err
    assert status == 1
    assert re.search(
        rf"error: '{url}' sent no frame: [0-9]+ messages arrived, but none is a frame", said
    )
    assert "'taxels'" in said.splitlines()[-2]
    assert "16" in said.splitlines()[-2]
    assert [*tmp_path.iterdir()] == []


def _send_until(send, text, over):
    while not over.wait(0.01):
        with suppress(OSError):
            send(text)


NOISE = np.random.default_rng(0).integers(0, 256, 4000, dtype=np.uint8).tobytes()
FOUR = np.ones((40, 4, 4), "<f4") * 25


@pytest.mark.full
@pytest.mark.skipif(sys.platform == "win32", reason="needs pseudo terminals")
@pytest.mark.parametrize("verb", ["record", "live"])
@pytest.mark.parametrize(
    ("options", "data", "reason"),
    [
        ("protocol=cobs", NOISE, "between two zero bytes are not a packet with a correct CRC32"),
        ("protocol=anyskin", NOISE, "CR LF does not follow 80 plausible bytes"),
        (
            "protocol=anyskin",
            b"".join(one.tobytes() + b"\r\n" for one in FOUR),
            "expected for num_magnetometers=5",
        ),
        (
            "protocol=text&shape=2x2",
            b"1 2 3\r\n4 5 6\r\n\r\n" * 9,
            "2 rows of 3 must have 'shape' 2x2",
        ),
        ("protocol=m1616", NOISE, "no complete packet begins with AA AB AC"),
        ("protocol=cobs", b"", "no byte arrived: check the cable and the port"),
    ],
    ids=["noise", "wrong protocol", "magnetometers", "shape", "header", "nothing"],
)
def test_port_whose_bytes_are_no_frames_is_explained(tmp_path, capsys, verb, options, data, reason):
    from ptys import FakePort

    port = FakePort(tmp_path / "ttyFAKE")
    file = [str(tmp_path / "a.mcap")] if verb == "record" else []
    writer = threading.Timer(0.3, port.write, (data,))
    writer.start()
    status = main([verb, f"serial:{port.path}?{options}", *file, "--seconds", "1"])
    writer.join()
    port.close()
    said = capsys.readouterr().err
    assert status == 1
    assert "sent no frame" in said
    assert reason in said.splitlines()[-2]
    assert not (tmp_path / "a.mcap").exists()


@pytest.mark.skipif(sys.platform == "win32", reason="needs pseudo terminals")
def test_seconds_go_on_when_a_port_falls_silent(tmp_path, capsys):
    from ptys import FakePort

    port = FakePort(tmp_path / "ttyFAKE")
    data = b"".join(encode_packet(i, np.full((4, 3), i, np.int16)) for i in range(5))
    writer = threading.Timer(0.3, port.write, (data,))
    writer.start()
    source = f"serial:{port.path}?protocol=cobs"
    assert main(["record", source, str(tmp_path / "a.mcap"), "--seconds", "0.5"]) == 0
    writer.join()
    port.close()
    assert "a.mcap: 5 frames in" in capsys.readouterr().out


@pytest.mark.parametrize("seconds", ["0", "nan", "x"])
def test_record_refuses_strange_seconds(tmp_path, capsys, seconds):
    with pytest.raises(SystemExit):
        main(["record", "sim:", str(tmp_path / "a.mcap"), "--seconds", seconds])
    assert "must be a positive number of seconds" in capsys.readouterr().err


@pytest.mark.full
@pytest.mark.skipif(sys.platform == "win32", reason="needs SIGINT")
@pytest.mark.slow
@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM", "SIGHUP"])
def test_signals_end_a_recording_and_keep_it(whole, tmp_path, name):
    source = f"{tmp_path / 'whole.npz'}?loop=1"
    with start("record", source, tmp_path / "a.mcap") as child:
        first = child.stderr.readline()  # after the recorder has begun
        deadline = time.monotonic() + 60
        while not (tmp_path / "a.mcap").exists() and time.monotonic() < deadline:
            time.sleep(0.05)
        time.sleep(0.4)
        child.send_signal(getattr(signal, name))
        out, _ = child.communicate(timeout=60)
    assert child.returncode == 0
    assert "frames" in first
    found = read_recording(tmp_path / "a.mcap", recover=False)
    assert f"a.mcap: {found.num_frames} frames in" in out
    assert (found.tactile == whole.tactile[np.arange(found.num_frames) % 60]).all()


def test_replay_tells_how_it_went(whole, tmp_path, capsys):
    assert main(["replay", str(tmp_path / "whole.npz"), "--speed", "10"]) == 0
    said = capsys.readouterr()
    assert said.out == f"{tmp_path / 'whole.npz'}: replayed 60 frames\n"
    assert "Hz" in said.err


def test_replay_repairs(whole, tmp_path, capsys):
    path, out = tmp_path / "a.mcap", tmp_path / "b.mcap"
    assert main(["record", f"{tmp_path / 'whole.npz'}?speed=0", str(path)]) == 0
    path.write_bytes(path.read_bytes()[:-300])
    assert main(["replay", str(path), "--repair", str(out)]) == 0
    assert "b.mcap: saved 1 tactile.Health" not in capsys.readouterr().err
    assert (read_recording(out, recover=False).tactile == whole.tactile).all()
    assert main(["replay", str(path), "--repair", str(path)]) == 1
    assert "must not replace an input file" in capsys.readouterr().err


@pytest.mark.slow
def test_replay_serves_its_frames(whole, tmp_path):
    with start("replay", tmp_path / "whole.npz", "--serve", "ws:0", "--speed", "2") as child:
        said = child.stderr.readline()
        url = next(word for word in said.split() if word.startswith("ws://")).rstrip(",")
        with connect(url) as client:
            messages = [json.loads(text) for text in client]
        out, _ = child.communicate(timeout=60)
    assert messages[0] == {"message": "Welcome"}
    assert [message["message"] for message in messages[1:]] == list(range(1, 61))
    for message, counts in zip(messages[1:], whole.tactile, strict=True):
        assert message["1"]["integer"] == counts.ravel().tolist()
    assert "sent 60 messages" in out


@pytest.mark.parametrize("port", ["ws:", "http", "ws:70000", "ws:-1", "ws:x"])
def test_replay_refuses_strange_ports(tmp_path, capsys, port):
    with pytest.raises(SystemExit):
        main(["replay", str(tmp_path / "a.npz"), "--serve", port])
    assert "must be ws or ws:PORT" in capsys.readouterr().err


def test_taken_port_is_explained(whole, tmp_path, capsys):
    with ReplayServer(whole, port=0) as server:
        serve = f"ws:{server.port}"
        assert main(["replay", str(tmp_path / "whole.npz"), "--serve", serve]) == 1
    assert "ddress already in use" in capsys.readouterr().err
    assert threading.active_count() < 20


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="needs pseudo terminals")
@pytest.mark.parametrize("suffix", ["mcap", "h5"])
def test_keys_annotate_a_recording(whole, tmp_path, suffix):
    from ptys import Terminal

    source, path = f"{tmp_path / 'whole.npz'}?loop=1", tmp_path / f"a.{suffix}"
    terminal = Terminal(tmp_path, "record", source, path, "--labels", "open, slip,hold")
    terminal.until("frames, ")
    for key, told in (("1", "open begins at"), ("2", "slip begins at"), ("2", "slip ends at")):
        terminal.press(key)
        terminal.until(told)
        terminal.until("[slip]  " if told == "slip begins at" else "frames, ")
    terminal.press("9")
    terminal.until("key 9 has no label: --labels names 3 (open, slip, hold)")
    terminal.press("3")
    terminal.until("[hold]  ")
    terminal.press("q")
    terminal.end()
    found = read_recording(path)
    opened, slip, hold = found.annotations
    assert [a.label for a in found.annotations] == ["open", "slip", "hold"]
    assert 0 < opened.start < opened.end == slip.start < slip.end < hold.start
    assert hold.end == found.time[-1]


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="needs pseudo terminals")
def test_seconds_of_keys_are_those_of_inspect(whole, tmp_path, capsys):
    from ptys import FakePort, Terminal

    port = FakePort(tmp_path / "ttyFAKE")
    over, silent = threading.Event(), threading.Event()

    def send():
        number = 0
        while not over.wait(0.01):
            number += 1
            if not silent.is_set():
                port.write(encode_packet(number, np.full((4, 3), 1, np.int16)))

    sender = threading.Thread(target=send)
    sender.start()
    terminal = Terminal(tmp_path, "record", f"serial:{port.path}?protocol=cobs", "a.mcap")
    terminal.until("frames, ")
    silent.set()
    time.sleep(0.6)
    said = []
    for key, told in (("m", "marked at "), ("1", "1 begins at "), ("1", "1 ends at ")):
        terminal.press(key)
        terminal.until(told)
        terminal.until(" s")
        said.append(terminal.passed)
    silent.clear()
    time.sleep(0.3)
    terminal.press("q")
    terminal.end()
    over.set()
    sender.join()
    port.close()
    assert float(said[0]) > 0.5  # the last frame was before the silence
    assert main(["inspect", str(tmp_path / "a.mcap"), "--no-picture"]) == 0
    summary = capsys.readouterr().out
    assert f"events       {said[0]} s  mark\n" in summary
    assert f"{said[1]} to {said[2]} s  1\n" in summary


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="needs pseudo terminals")
def test_keys_annotate_what_live_records(whole, tmp_path):
    from ptys import Terminal

    terminal = Terminal(tmp_path, "live", f"{tmp_path / 'whole.npz'}?loop=1")
    terminal.until("Hz")
    terminal.press("4")
    terminal.until("nothing annotated: no recording is running")
    terminal.press("r")
    terminal.until("recorded")
    terminal.press("4")
    terminal.until("4 begins at")
    terminal.until("without --labels, the keys 1 to 9 write the labels 1 to 9: --labels open,slip")
    terminal.until("[4]  ")
    terminal.press("r")
    terminal.until("wrote ")
    terminal.press("q")
    terminal.end()
    (path,) = tmp_path.glob("*.mcap")
    found = read_recording(path)
    assert [a.label for a in found.annotations] == ["4"]
    assert found.annotations[0].end == found.time[-1]


@pytest.mark.parametrize(
    ("labels", "message"),
    [
        ("a,b,a", "must be up to 9 different labels"),
        ("1,2,3,4,5,6,7,8,9,0", "must be up to 9 different labels"),
        ("slip,gap", "must not contain 'gap', the label of time without frames"),
        ("a,,b", "labels of 1 to 255 printable characters"),
    ],
)
@pytest.mark.parametrize("verb", ["record", "live"])
def test_labels_that_no_keys_can_have_are_refused(tmp_path, capsys, verb, labels, message):
    file = [str(tmp_path / "a.mcap")] if verb == "record" else []
    with pytest.raises(SystemExit):
        main([verb, "sim:", *file, "--labels", labels])
    assert message in capsys.readouterr().err
    assert not (tmp_path / "a.mcap").exists()
