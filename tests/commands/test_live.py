# ruff: noqa: E402
import argparse
import os
import pty
import re
import signal
import subprocess
import sys
import time
from contextlib import suppress

import numpy as np
import pytest
import torch

for module in ("mcap", "google.protobuf", "zstandard", "websockets"):
    pytest.importorskip(module, reason="needs the extra 'live'")

from torch_geometric_tactile import Predictor
from torch_geometric_tactile.cli import main
from torch_geometric_tactile.commands import live
from torch_geometric_tactile.data import Recording
from torch_geometric_tactile.io import encode_packet, read_recording
from torch_geometric_tactile.io._recording_npz import write_npz
from torch_geometric_tactile.live import Judge
from torch_geometric_tactile.nn import TaxelNet
from torch_geometric_tactile.sensors import biotac_sp, grid

SHAPE = (24, 3)
WHOLE = "whole.npz?speed=0"


@pytest.fixture
def whole(tmp_path):
    draw = np.random.default_rng(0)
    tactile = draw.normal(size=(60, *SHAPE)).astype(np.float32)
    recording = Recording(np.arange(60) / 100, tactile, meta={"unit": "count"})
    write_npz(recording, tmp_path / "whole.npz")
    return recording


@pytest.fixture
def model(tmp_path):
    torch.manual_seed(0)
    layout = biotac_sp()
    predictor = Predictor(
        TaxelNet(layout, 2, in_channels=3), layout, class_names=["hold", "slip"], num_channels=3
    )
    predictor.save(tmp_path / "m.predictor")
    return str(tmp_path / "m.predictor")


def test_recording_is_judged_and_recorded(whole, model, tmp_path, capsys):
    out = tmp_path / "a.mcap"
    source = f"{tmp_path / 'whole.npz'}?speed=2"
    arguments = ["live", source, "--model", model, "--record", str(out), "--label", "mug"]
    assert main([*arguments, "--policy", "all"]) == 0
    said = capsys.readouterr().err
    assert "60 frames, 60 judged" in said
    assert f"wrote {out}" in said
    assert re.search(r"Hz .* lost 0 .* (hold|slip) \d+ % .* latency [\d.]+ ms", said)
    found = read_recording(out)
    assert (found.tactile == whole.tactile).all()
    assert found.label == "mug"
    assert main([*arguments]) == 1
    assert "exists: choose another name" in capsys.readouterr().err


def test_frames_without_contact_are_told(whole, model, tmp_path, capsys):
    source = f"{tmp_path / 'whole.npz'}?speed=2"
    arguments = ["live", source, "--model", model, "--rest", "0.1", "--policy", "all", "--contact"]
    for threshold, text in ((["20"], "  no contact  "), (["0.001"], "slip|hold")):
        assert main([*arguments, *threshold]) == 0
        assert re.search(text, capsys.readouterr().err)
    with pytest.raises(SystemExit):
        main(["live", "--contact", source, "--model", model])
    assert "must be a positive number in the unit of the readings" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ([WHOLE, "--label", "mug"], "'--label' must come with '--record FILE' (got no file)"),
        ([WHOLE, "--contact"], "'--contact' must come with '--model FILE' (got no model)"),
        ([WHOLE, "--tare"], "'--tare' must come with '--model FILE' (got no model)"),
        ([WHOLE, "--model", "none.onnx"], "none.onnx"),
        ([WHOLE, "--map", "none.json"], "none.json"),
        ([WHOLE, "--layout", "none.json", "--record", "a.mcap"], "none.json"),
        (["other.npz", "--model", "m.predictor"], "a frame must have shape (24, 3)"),
        (["usb:3"], "serial:"),
        (["serial:/dev/ttyNONE?protocol=cobs"], "/dev/ttyNONE"),
    ],
)
def test_mistakes_are_one_line(whole, model, tmp_path, monkeypatch, capsys, arguments, message):
    monkeypatch.chdir(tmp_path)
    write_npz(Recording(np.arange(9) / 100, np.zeros((9, 5, 3), dtype=np.float32)), "other.npz")
    assert main(["live", *arguments]) == 1
    lines = [line for line in capsys.readouterr().err.splitlines() if "error" in line]
    assert len(lines) == 1
    assert message in lines[0]
    assert not (tmp_path / "a.mcap").exists()


@pytest.mark.parametrize("suffix", ["onnx", "predictor"])
def test_layout_of_the_model_is_shown_whatever_its_name(tmp_path, suffix):
    if suffix == "onnx":
        pytest.importorskip("onnxscript", reason="needs the extra 'export'")
        pytest.importorskip("onnxruntime", reason="needs the extra 'export'")
        from torch_geometric_tactile.predictor import export_onnx
    torch.manual_seed(0)
    layout = grid(3, 4, pitch=0.01)
    predictor = Predictor(
        TaxelNet(layout, 2, in_channels=1), layout, class_names=["hold", "slip"], num_channels=1
    )
    path = tmp_path / f"m.{suffix}"
    export_onnx(predictor, path) if suffix == "onnx" else predictor.save(path)
    arguments = argparse.Namespace(view=True, record=None)
    found = live._model_layout(Judge(str(path)), arguments)
    assert found.matches(layout)


@pytest.mark.slow
def test_board_on_a_terminal_with_keys_and_ctrl_c(tmp_path):
    pytest.importorskip("cobs", reason="needs the extra 'live'")
    board, port = pty.openpty()
    terminal, screen = pty.openpty()
    name = os.ttyname(port)
    command = [sys.executable, "-m", "torch_geometric_tactile", "live"]
    command += [f"serial:{name}?protocol=cobs"]
    child = subprocess.Popen(
        command,
        stdin=screen,
        stdout=screen,
        stderr=screen,
        cwd=tmp_path,
        env={**os.environ, "COLUMNS": "300"},
        start_new_session=True,
        # In a job that a shell put into the background, Ctrl-C would be ignored.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )
    os.set_blocking(terminal, False)
    os.set_blocking(board, False)
    said, number, deadline, pressed = "", 0, time.monotonic() + 40, []

    def press(key):
        pressed.append(key)
        os.write(terminal, key)

    while child.poll() is None and time.monotonic() < deadline:
        with suppress(BlockingIOError):  # nobody reads yet
            os.write(board, encode_packet(number, np.full((4, 3), number, dtype=np.int16)))
            number += 1
        time.sleep(0.005)
        with suppress(BlockingIOError):
            said += os.read(terminal, 65536).decode()
        if "Hz" in said and not pressed:
            press(b"r")
        elif "recording 2" in said and len(pressed) == 1:
            press(b"t")
        elif "measures the rest again" in said and len(pressed) == 2:
            press(b"m")
        elif "marked at" in said and len(pressed) == 3:
            press(b"r")
        elif "wrote 2" in said and len(pressed) == 4:
            pressed.append("Ctrl-C")
            child.send_signal(signal.SIGINT)
    if child.poll() is None:
        child.kill()
    assert child.wait() == 0, said
    with suppress(OSError):
        said += os.read(terminal, 65536).decode()
    assert re.search(r"\d+ frames, 0 judged", said)
    (kept,) = tmp_path.glob("*.mcap")
    frames = read_recording(kept)
    assert (np.diff(frames.extra["sequence"]) == 1).all()
    assert (frames.tactile[:, 0, 0] == frames.extra["sequence"]).all()
    assert [event["kind"] for event in frames.meta["events"]] == ["retare", "mark"]
    assert frames.time[0] < frames.meta["events"][1]["time"] < frames.time[-1]
    for line in (board, port, terminal, screen):
        os.close(line)
