"""A robot without PyTorch: judging, streams and decoders with numpy and onnxruntime."""

import subprocess
import sys

import onnx_predictors as made
import pytest

from torch_geometric_tactile.io import read_recording
from torch_geometric_tactile.io._recording_npz import write_npz

SCRIPT = """
import sys

BLOCKED = ("torch", "torch_geometric", "lightning", "sklearn", "umap", "pooch")
for name in BLOCKED:
    sys.modules[name] = None

import numpy as np

from torch_geometric_tactile.data import LiveFrame
from torch_geometric_tactile.io import CobsDecoder, encode_packet
from torch_geometric_tactile.live import Judge, Rest, Subscription

model, = sys.argv[1:]
rest = Rest(seconds=0.3)
judge = Judge(model, rest)
decoder = CobsDecoder()
subscription = Subscription("all")
draw = np.random.default_rng(0)
for i in range(40):
    readings = 30000 + 5 * draw.standard_normal((11, 3))
    packet = encode_packet(i, readings.astype(np.float32))
    for frame in decoder.feed(packet, int(1e9 + 2e7 * i)):
        subscription.put(frame)
subscription.end()
judged = list(judge.follow(subscription))
assert [judgement.sequence for judgement in judged] == list(range(29, 40)), judged
assert all(judgement.label in ("ball", "cube") for judgement in judged)
assert rest.number == 1 and rest.value.shape == (11, 3)
loaded = [name for name in BLOCKED if sys.modules.get(name) is not None]
assert not loaded, loaded
print("judged", len(judged))
"""


@pytest.mark.xdist_group("onnx_predictors")
@pytest.mark.slow
def test_a_graph_is_judged_without_torch():
    for extra in ("onnx", "onnxscript", "onnxruntime"):
        pytest.importorskip(extra, reason="needs the extra 'export'")
    pytest.importorskip("cobs", reason="needs the extra 'live'")
    command = [sys.executable, "-c", SCRIPT, str(made.onnx_file("tare"))]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == ["judged", "11"]


LIVE = """
import sys

BLOCKED = ("torch", "torch_geometric", "lightning", "sklearn", "umap", "pooch")
for name in BLOCKED:
    sys.modules[name] = None

from torch_geometric_tactile.cli import main

source, model, out = sys.argv[1:]
arguments = ["live", source, "--model", model, "--record", out, "--view", "--no-browser"]
sys.exit(main([*arguments, "--policy", "all"]))
"""


@pytest.mark.xdist_group("onnx_predictors")
@pytest.mark.slow
def test_a_source_is_judged_recorded_and_shown_without_torch(tmp_path):
    for extra in ("onnx", "onnxscript", "onnxruntime"):
        pytest.importorskip(extra, reason="needs the extra 'export'")
    for extra in ("mcap", "google.protobuf", "zstandard", "websockets"):
        pytest.importorskip(extra, reason="needs the extra 'live'")
    whole = made.recording()
    write_npz(whole, tmp_path / "whole.npz")
    out = tmp_path / "a.mcap"
    command = [sys.executable, "-c", LIVE, str(tmp_path / "whole.npz")]
    command += [str(made.onnx_file("frame")), str(out)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    assert f"{whole.num_frames} frames, {whole.num_frames} judged" in done.stderr
    assert read_recording(out).num_frames == whole.num_frames
