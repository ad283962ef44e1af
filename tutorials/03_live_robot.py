# %% [markdown]
# # To a live robot: does the model say the same as in the lab?
#
# A trained model is of use when it judges the next frame, not the last recording. This tutorial
# trains a small model, writes it as one ONNX file, sends a recording through a serial port frame by
# frame as a sensor would, and compares the live labels with those of the recording.
#
# - **Data**: the simulated glove of [tutorial 2](02_your_own_glove.py) (no measurement). The port
#   is a pseudo terminal (pty): for the program that reads it a serial device like any other.
# - **You will see** the rest being measured, labels while frames arrive, the latency from the last
#   byte to the label, and that live and offline labels are the same.
# - **Time**: about half a minute. Linux or macOS; Windows has no pty, see the end.

# %%
import logging
import shutil
import sys
import tempfile
import warnings
from pathlib import Path

import lightning

# The library's notes are printed in the notebook; those of Lightning are switched off.
logging.basicConfig(stream=sys.stdout, format="note: %(message)s")
logging.getLogger("lightning.pytorch").setLevel(logging.ERROR)
warnings.filterwarnings("ignore")  # of other libraries

folder = Path(tempfile.mkdtemp())
grasps = Path(shutil.copytree("data/glove", folder / "grasps"))

# %% [markdown]
# ## 1. A model
#
# As in tutorial 2, in short: a layout, the recordings, a tare per trial, `TaxelNet`. All trials
# with the pen are the test part, so that object is new to the model; one of its trials is played
# below.

# %%
from torch_geometric.transforms import Compose

from torch_geometric_tactile import Predictor
from torch_geometric_tactile.data import Protocol, Recording
from torch_geometric_tactile.datasets import RecordingFrames
from torch_geometric_tactile.nn import TaxelNet
from torch_geometric_tactile.sensors import TaxelLayout
from torch_geometric_tactile.training import TactileDataModule, TactileModule
from torch_geometric_tactile.transforms import FillMissing, Tare, ZScore

rows = {"palm": 10, "thumb": 3, "index": 4, "middle": 4, "ring": 4, "little": 3}
place = [(0.02 * i, 0.02 * row) for row, count in enumerate(rows.values()) for i in range(count)]
layout = TaxelLayout("glove", place)  # each part as a row, for short
columns = {"tactile": r"(palm|thumb|index|middle|ring|little)_\d+", "label": "grasp"}
dataset = RecordingFrames(grasps, layout=layout, target="grasp", read_options=columns, unit="count")

lightning.seed_everything(0, verbose=False)
scale = Compose([Tare("trial", seconds=0.3), ZScore(per="channel"), FillMissing()])
pens = Protocol("group", leave_one_out=True)
module = TactileDataModule(dataset, split=pens, fold=2, transform=scale, batch_size=32)
classifier = TactileModule(TaxelNet(layout, dataset.num_classes, in_channels=1))
trainer = lightning.Trainer(
    max_epochs=10,
    logger=False,
    enable_checkpointing=False,
    enable_progress_bar=False,
    enable_model_summary=False,
)
trainer.fit(classifier, module)
(metrics,) = trainer.test(classifier, module, verbose=False)
print(f"accuracy on the new object: {metrics['test/accuracy']:.3f}")

# %% [markdown]
# ## 2. Two files
#
# The **predictor** keeps layout, tare, scaling, network and class names together; it needs PyTorch.
# The **ONNX file** holds the same from raw reading to probability, and a robot runs it with
# onnxruntime alone. Never deploy the bare network: it expects scaled readings, and answers raw ones
# without complaint, and wrongly.

# %%
from torch_geometric_tactile.predictor import export_onnx

predictor = Predictor.from_dataset(classifier.model, dataset, module.transform)
predictor.save(folder / "glove.predictor")
export_onnx(predictor, folder / "glove.onnx", unit="count")
for name in ("glove.predictor", "glove.onnx"):
    print(f"{name:16} {(folder / name).stat().st_size / 1000:.0f} kB")

# %% [markdown]
# ## 3. A sensor to read
#
# We play a trial of the new object at 100 Hz: the open hand for a second, the grasp for two, and
# the open hand again. (The file has 22 frames; they are repeated.) `encode_packet` makes the bytes
# that a device with our firmware sends, with a counter and a CRC32.

# %%
import os
import threading
import time
import tty

from torch_geometric_tactile.io import encode_packet, read_recording

recording = read_recording(grasps / "pen_2.csv", **columns)
order = [*range(6)] * 17 + [6, 7, 8] + [*range(9, 22)] * 14 + [*range(6)] * 5


def send(port):
    for number, frame in enumerate(order):
        os.write(port, encode_packet(number, recording.tactile[frame], device_time=number / 100))
        time.sleep(0.01)


# %% [markdown]
# ## 4. Live
#
# The `Judge` takes the newest frame only, so it never lags behind. Its `Rest` collects 0.8 s in
# which nothing moves; before that there is no label. A `Callback` is your code: here it keeps the
# judgements, on a robot it would close the hand.

# %%
from torch_geometric_tactile.live import Callback, Judge, LiveSession, Rest, open_source


class Keep(Callback):
    def __init__(self):
        self.judgements = []

    def on_judgement(self, session, judgement):
        self.judgements.append(judgement)


def play(model):
    master, device = os.openpty()
    tty.setraw(device)
    keep, judge = Keep(), Judge(model, Rest(seconds=0.8))
    source = open_source(f"serial:{os.ttyname(device)}?protocol=cobs")
    with LiveSession(source, judge=judge, callbacks=[keep]) as session:
        threading.Thread(target=send, args=(master,), daemon=True).start()
        session.run(seconds=len(order) / 100 + 1.5)
    print(source.counts)
    return keep.judgements, judge.rest.frames


judgements, rest = play(folder / "glove.onnx")
print(f"the rest is the mean of {len(rest.time)} frames; then {len(judgements)} judgements")

# %% tags=["figure"]
import matplotlib.pyplot as plt

figure, ax = plt.subplots(figsize=(7, 2.8))
for number, name in enumerate(judgements[0].class_names):
    ax.plot(
        [judgement.sequence / 100 for judgement in judgements],
        [judgement.probability[number] for judgement in judgements],
        label=name,
    )
ax.axvspan(0, judgements[0].sequence / 100, color="0.9", label="rest")
ax.set(xlabel="time in s", ylabel="probability", title="pen_2, live")
ax.legend(loc="center left", bbox_to_anchor=(1, 0.5))
figure.tight_layout()

# %% [markdown]
# ## 5. The same labels as offline
#
# Offline, the predictor measures the same rest and is given the whole recording at once. Every live
# label must be the same, and the probabilities must agree to the rounding of float32.

# %%
import numpy as np

offline = Predictor.load(folder / "glove.predictor")
at_rest = Recording(time=rest.time, tactile=rest.tactile)
offline.adapt_recording(at_rest, rest=1.0)  # all of its frames, as live
probability = offline(recording.tactile)
labels = [label for (label,) in offline.labels(probability)]

live = {judgement.sequence: judgement for judgement in judgements}
assert len(live) > 100
assert all(live[number].label == labels[order[number]] for number in live)
difference = max(
    float(np.abs(live[number].probability - probability[order[number]].numpy()).max())
    for number in live
)
print(f"{len(live)} live labels equal the offline ones; probabilities differ by {difference:.0e}")
assert difference < 1e-4

# %% [markdown]
# ## 6. How long does a label take?
#
# From the last byte of a frame to its label, with the ONNX file and with PyTorch. The numbers are
# those of the machine that ran this page, which does other work as well; measure yours.

# %% tags=["figure"]
slower, _ = play(folder / "glove.predictor")
total = {
    "ONNX": [1000 * judgement.latency["total"] for judgement in judgements],
    "PyTorch": [1000 * judgement.latency["total"] for judgement in slower],
}
figure, ax = plt.subplots(figsize=(6, 2.8))
for name, values in total.items():
    p50, p99 = np.percentile(values, [50, 99])
    edges = np.geomspace(0.1, 100, 60)
    ax.hist(values, edges, alpha=0.7, label=f"{name}: median {p50:.1f} ms, 99 % below {p99:.1f} ms")
ax.set(xscale="log", xlabel="milliseconds from last byte to label", ylabel="frames")
ax.legend(loc="upper center", bbox_to_anchor=(0.5, -0.25), frameon=False)
figure.tight_layout()

# %%
assert all(judgement.label == labels[order[judgement.sequence]] for judgement in slower)

# %% [markdown]
# ## On a robot
#
# The same session from the command line, with every frame recorded and shown in the browser:
#
# ```sh
# tactile ports
# tactile live "serial:/dev/ttyACM0?protocol=cobs" --model glove.onnx --record grasp.mcap --view
# ```
#
# **Without a pty** (Windows): any recording is a source as well,
# `open_source("file:mug.h5?speed=1")`, and `tactile replay mug.h5 --serve ws` sends it on a
# WebSocket, if it has three channels of counts. A pair of virtual COM ports (com0com) takes the
# place of the pty.
#
# ## What to take from this
#
# - Deploy the predictor or its ONNX file, never the bare network.
# - A model that was trained relative to rest needs a rest before its first label. Leave the sensor
#   alone for a second.
# - Labels were the same live and offline, from the same rest, in PyTorch and in ONNX.
# - Judge the newest frame; the recorder keeps all of them.
#
# ## Next
#
# - [A new day](04_new_day.py): what changes when the sensor does
# - [Live](../docs/live.md): sources, health, reconnecting; [export](../docs/predictor.md#export-one-onnx-file-from-reading-to-label); [the
#   predictor](../docs/predictor.md)
# - [Your own device](../docs/your_own_classes.md#a-live-device): a decoder for your board
