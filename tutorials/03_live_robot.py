# %% [markdown]
# # To a live robot: does the model say the same as in the lab?
#
# A trained model is useful if it classifies the next frame, not only recordings. This tutorial
# trains a small model and exports it as one ONNX file. It then sends a recording through a serial
# port frame by frame, as a sensor would, and compares the live labels with the offline labels of
# the recording.
#
# - **Data**: the simulated glove of [tutorial 2](02_your_own_glove.py). The port is a pseudo
#   terminal (pty), which looks like a serial device to the program that reads it.
# - **You will see** how the rest is measured, labels of arriving frames, the latency from the last
#   byte to the label, and that live and offline labels agree.
# - **Time**: about half a minute. Linux or macOS only, since Windows has no pty (see the end).

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
# We repeat the steps of tutorial 2: a layout, the recordings, a tare per trial, and `TaxelNet`. All
# trials with the pen are the test part, so this object is new to the model. One of these trials is
# replayed below.

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
# The **predictor** contains layout, tare, scaling, network and class names, and needs PyTorch. The
# **ONNX file** contains the same steps from raw reading to probability, and a robot runs it with
# onnxruntime alone. Never deploy the bare network: it expects scaled readings, and gives wrong
# answers for raw readings without an error.

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
# We replay a trial of the new object at 100 Hz: the open hand for a second, the grasp for two
# seconds, and the open hand again. (The file has 22 frames, which are repeated.) `encode_packet`
# creates the bytes that a device with our firmware sends, with a counter and a CRC32.

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
# The `Judge` takes only the newest frame, so it never lags behind. Its `Rest` collects 0.8 s
# without movement; before that, there is no label. A `Callback` is your code. Here it stores the
# judgements; on a robot, it would close the hand.

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
# Offline, the predictor measures the same rest and gets the whole recording at once. Every live
# label must equal the offline label, and the probabilities must agree to the rounding of float32.

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
# The figure shows the time from the last byte of a frame to its label, with the ONNX file and with
# PyTorch. The numbers are those of the machine that ran this page, which was also doing other work.
# Measure them on your machine.

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
# On the command line, this is the same session. It also records every frame and shows it in the
# browser:
#
# ```sh
# tactile ports
# tactile live "serial:/dev/ttyACM0?protocol=cobs" --model glove.onnx --record grasp.mcap --view
# ```
#
# **Without a pty** (Windows), a recording can be the source: `open_source("file:mug.h5?speed=1")`.
# If it has three channels of counts, `tactile replay mug.h5 --serve ws` sends it over a WebSocket.
# A pair of virtual COM ports (com0com) replaces the pty.
#
# ## What to take from this
#
# - Deploy the predictor or its ONNX file, never the bare network.
# - A model that was trained relative to rest needs a rest before its first label. Leave the sensor
#   untouched for a second.
# - From the same rest, labels were the same live and offline, in PyTorch and in ONNX.
# - The judge takes the newest frame; the recorder stores all frames.
#
# ## Next
#
# - [A new day](04_new_day.py): what happens if the sensor changes
# - [Live](../docs/live.md): sources, health and reconnecting
# - [Predictors](../docs/predictor.md) and [their
#   export](../docs/predictor.md#export-one-onnx-file-from-reading-to-label)
# - [Your own device](../docs/your_own_classes.md#a-live-device): a decoder for your board
