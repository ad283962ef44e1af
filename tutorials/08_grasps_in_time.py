# %% [markdown]
# # Grasps in time: can slip be seen before it happens?
#
# Three fingertips close around an object, lift it and shake it. Some grasps lose the object. A
# robot needs an alarm *before* the object begins to slide. This tutorial cuts recordings into
# windows, labels each window with what happens half a second later, and trains a temporal network
# that also runs frame by frame. It then counts correct and false alarms, and compares them with two
# thresholds that need no network.
#
# **Simulated**: 48 generated grasps in the format of the BiGS data set, of which we found no copy.
# Nothing on this page is a result on a real hand. It takes about half a minute.

# %% [markdown]
# ## Simulate some grasps
#
# Object, mass, friction, grip and timing differ between grasps. Nothing reacts to slip. A grasp
# takes about 0.3 s of one core and is written as one recording.

# %%
import tempfile

from torch_geometric_tactile.sim import simulate_bigs

folder = tempfile.TemporaryDirectory()
reports = list(simulate_bigs(folder.name, grasps=48, seed=0))
print(f"{sum(report.success for report in reports)} of {len(reports)} grasps held")

# %% [markdown]
# The figure shows a grasp that holds on the left and a grasp that fails on the right: the change of
# every electrode of each fingertip, the forces, and the vibration. The red line marks the onset of
# slip, and the dotted line the loss of the object. Both grasps shake strongly, and even an object
# that is held may slide a little.

# %% tags=["figure"]
from torch_geometric_tactile.io import read_recording
from torch_geometric_tactile.visualization import plot_bigs_grasps

recordings = {report.path.stem: read_recording(report.path) for report in reports}
slips = [name for name, grasp in recordings.items() if grasp.meta["slip_time"] is not None]
holds = [name for name in recordings if name not in slips]
plot_bigs_grasps([recordings[holds[0]], recordings[slips[0]]])

# %% [markdown]
# ## From recordings to windows
#
# `BiGS` reads the folder. We take all frames, including the shake (`until=None`). `Tare` subtracts
# the mean of the first 20 frames of each grasp, when nothing touches the skin. For each frame, we
# also store the seconds until the onset of slip (infinite if the grasp holds) and since the start
# of the lift. They are used to evaluate the alarms, never as an input.

# %%
from pathlib import Path

import torch

from torch_geometric_tactile.data import StaticDataset
from torch_geometric_tactile.datasets import BiGS
from torch_geometric_tactile.transforms import Tare

grasps = BiGS(folder.name, signals=("pressure", "pac"), until=None)
data = grasps.data
meta = [recordings[Path(name).stem].meta for name in grasps.trial_names]
onset = torch.tensor([one["slip_time"] or torch.inf for one in meta], dtype=torch.double)
lift = torch.tensor([one["pickup_time"] for one in meta], dtype=torch.double)

touch = Tare("trial", first=20).fit(data)(data).x
pressure = Tare("trial", first=20, attr="pressure").fit(data)(data).pressure
frames = StaticDataset.from_arrays(
    touch,
    data.slip,
    layout=grasps.layout,
    trial=data.trial,
    group=data.group,
    time=data.time,
    to_slip=onset[data.trial] - data.time,
    since_lift=data.time - lift[data.trial],
    weak_grip=-pressure.mean(dim=1),
    vibration=data.pac.std(dim=2).amax(dim=1),
)
print(frames, frames[0].x.shape)

# %% [markdown]
# A window has 64 frames of 10 ms. Its label is `slip` if the object slips half a second **after**
# the last frame (`label="ahead"`, `horizon=50`). We evaluate windows between the lift and the
# onset, because an alarm comes too late once the object slides.

# %%
from torch_geometric_tactile.data import Windows

windows = Windows(frames, length=64, hop=5, label="ahead", horizon=50)
windows = windows[(windows.since_lift >= 0) & (windows.to_slip > 0.005)]
print(len(windows), "windows of", tuple(windows[0].x.shape), "(electrodes, fingers * frames)")
print(f"{windows.y.double().mean():.1%} of them slip within half a second")

# %% [markdown]
# Windows of one grasp overlap, so we split **by grasp** (`"trial"`). With three folds, every grasp
# is tested once, by a network that was trained on the others.

# %%
from torch_geometric_tactile.data import Protocol

protocol = Protocol("trial", folds=3, stratify="group")
splits = [protocol.split(windows, seed=0, fold=fold) for fold in range(3)]
for split in splits:
    train, test = (set(windows.trial[part].tolist()) for part in (split.train, split.test))
    assert not train & test, "a grasp must not be on both sides"
    print(f"train on {len(train)} grasps, test on {len(test)}")

# %% [markdown]
# ## Train one network for windows and streams
#
# `TemporalTaxelNet` looks 64 frames back and never ahead. It takes the neighbours of each electrode
# from the layout and scales raw counts itself. Slips are rare, so the loss weighs both classes
# equally.

# %%
from torch.nn.functional import cross_entropy

from torch_geometric_tactile.loader import StaticLoader
from torch_geometric_tactile.nn import TemporalTaxelNet


def fit(train, epochs=8):
    model = TemporalTaxelNet(windows.layout, 2, in_channels=3)
    weight = len(train) / (2 * train.y.bincount())
    loader = StaticLoader(train[::3], batch_size=32, shuffle=True, drop_last=True)
    optimizer = torch.optim.AdamW(model.parameters(), weight_decay=0.03)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimizer, 4e-3, epochs * len(loader))
    for _ in range(epochs):
        for batch in loader:
            optimizer.zero_grad()
            cross_entropy(model(batch.x), batch.y, weight).backward()
            optimizer.step()
            schedule.step()
    return model.eval()


torch.manual_seed(0)
models = [fit(windows[split.train]) for split in splits]
print(models[0])

# %% [markdown]
# ## Frame by frame, as on the robot
#
# `initial_state` and `step` run the same network one frame at a time. The state holds the past
# features that the network needs, so no window is computed twice. After `receptive_field` frames,
# the answer must equal the answer for the window that ends at the same frame. The network was
# trained on windows after the lift only, so its answers before the dashed line are meaningless.

# %% tags=["figure"]
import matplotlib.pyplot as plt

fold = 0
held_out = windows.trial[splits[fold].test].unique().tolist()
number = next(i for i in held_out if onset[i] - lift[i] > 1.5 and onset[i] < torch.inf)
stream = frames[frames.trial == number]

model, answers = models[fold], []
with torch.inference_mode():
    state = model.initial_state(batch_size=1)
    for frame in stream.batch(range(len(stream))).x:
        logits, state = model.step(frame.unsqueeze(0), None, state)
        answers.append(logits)
    streamed = torch.cat(answers)
    whole = Windows(stream, length=64)
    windowed = model(whole.batch(range(len(whole))).x)
difference = float((streamed[63:] - windowed).abs().max())
print(f"largest difference between streamed and windowed logits: {difference:.1e}")
assert difference < 1e-3

fig, ax = plt.subplots(figsize=(8, 3), layout="constrained")
ax.plot(stream.time, streamed.softmax(dim=1)[:, 1])
ax.axvline(lift[number], color="grey", linestyle="--", label="lift")
ax.axvline(onset[number], color="#b00020", label="onset of slip")
ax.set(xlabel="time (s)", ylabel="slips within 0.5 s", ylim=(0, 1))
ax.set_title("One held-out grasp, streamed")
ax.legend()
plt.close(fig)  # or the notebook shows it twice
fig

# %% [markdown]
# ## Alarms: how many, how early, and how many are false
#
# Three scores predict how soon a slip will come:
#
# * **the network**, trained on the other grasps;
# * **weak grip**: the negative fluid pressure, averaged over the fingertips. Any robot has this
#   number, and it needs no training;
# * **vibration**: the loudest fingertip in the last 10 ms, the classical slip detector.
#
# Each score gets the threshold that 5 % of the moments of holding grasps exceed. It is chosen on
# the scores below, so that all three have equally many false alarms. On a robot, choose it on other
# grasps.

# %%
import numpy as np

tested = windows[torch.cat([split.test for split in splits])]
with torch.inference_mode():
    logits = [
        model(batch.x)
        for model, split in zip(models, splits, strict=True)
        for batch in StaticLoader(windows[split.test], batch_size=512)
    ]
scores = {
    "TemporalTaxelNet": torch.cat(logits).diff(dim=1)[:, 0].numpy(),
    "weak grip (pressure)": tested.weak_grip.numpy(),
    "vibration": tested.vibration.numpy(),
}
to_slip, since_lift = tested.to_slip.numpy(), tested.since_lift.numpy()
is_held = np.isinf(to_slip)


def alarm_threshold(score, false_alarms=0.05):
    held = np.sort(score[is_held])
    limit = held[-1 - int(false_alarms * len(held))]  # the largest score without an alarm
    return held[held > limit].min()


alarms = {name: score >= alarm_threshold(score) for name, score in scores.items()}
for name, alarm in alarms.items():
    print(f"{name:22}{alarm[is_held].mean():.1%} of the moments of holding grasps have an alarm")

# %% [markdown]
# The shake begins at about the same time in every grasp, so even a clock would announce some slips.
# We therefore count false alarms in the holding grasps **at the same moments** at which the other
# grasps are about to slip. A clock would give the same curve on both sides of the figure.

# %% tags=["figure", "thumbnail"]
seconds = (0.05, 0.1, 0.2, 0.3, 0.4, 0.5, 0.75, 1.0)


def rows_by_grasp(mask):
    trial = np.where(mask, tested.trial.numpy(), -1)
    return [np.flatnonzero(trial == number) for number in np.unique(trial[mask])]


def rows_at(time, moment, grasps):  # the nearest window of each grasp, at most 50 ms away
    nearest = [rows[np.abs(time[rows] - moment).argmin()] for rows in grasps]
    return [row for row in nearest if abs(time[row] - moment) <= 0.05]


slipping, holding = rows_by_grasp(~is_held), rows_by_grasp(is_held)
before_slip = [rows_at(to_slip, lead, slipping) for lead in seconds]
same_moments = [
    [row for moment in since_lift[rows] for row in rows_at(since_lift, moment, holding)]
    for rows in before_slip
]
titles = ("slipping grasps with an alarm", "holding grasps with an alarm, same moments")
fig, axes = plt.subplots(1, 2, figsize=(9, 3.5), sharey=True, layout="constrained")
for ax, windows_at, title in zip(axes, (before_slip, same_moments), titles, strict=True):
    for name, alarm in alarms.items():
        ax.plot(seconds, [alarm[rows].mean() for rows in windows_at], marker="o", label=name)
    ax.set(title=title, xlabel="seconds before the onset of slip", xlim=(1.05, 0), ylim=(0, 1))
axes[0].set_ylabel("share of the grasps")
axes[0].legend()
plt.close(fig)
fig

# %% [markdown]
# The table has three numbers for each score: the share of slips that are announced in the last half
# second, the share of holding grasps with an alarm at any moment, and the area under the ROC of
# single moments (in the last half second before a slip, against those of holding grasps).

# %%
from sklearn.metrics import roc_auc_score

is_soon = to_slip <= 0.5
judged = is_soon | is_held
announced, held_alarmed, auc = {}, {}, {}
print("method                announced  holding grasps with an alarm  area under ROC")
for name, alarm in alarms.items():
    announced[name] = np.mean([alarm[rows].any() for rows in rows_by_grasp(is_soon)])
    held_alarmed[name] = np.mean([alarm[rows].any() for rows in holding])
    auc[name] = roc_auc_score(is_soon[judged], scores[name][judged])
    print(f"{name:22}{announced[name]:8.0%}{held_alarmed[name]:22.0%}{auc[name]:24.2f}")

# %% [markdown]
# Each line shows something different:
#
# * **Vibration announces few slips, and late.** It is strong when something slides, but also in
#   every shake: most holding grasps have such an alarm at some moment.
# * **Weak grip announces about half of the slips long before the onset**, without any training. The
#   curves are flat until shortly before the onset, so these alarms detect a weak grasp, not the
#   start of a slide.
# * **The network, trained on 31 or 32 grasps, is not better than the pressure.** It must extract
#   from 57 electrodes what the pressure shows in one number. On the same simulator with 2,000
#   grasps, about 1,200 of them for training, the network ranks moments better: the area under the
#   ROC is 0.92 for the network and 0.84 for the pressure
#   ([results](../docs/results/early_slip.md)). At the same rate of false alarms, both announce as
#   many slips there.

# %%
early = {name: alarm[before_slip[seconds.index(0.5)]].mean() for name, alarm in alarms.items()}

assert auc["TemporalTaxelNet"] > 0.65, "the network must tell coming slips from holding grasps"
assert auc["weak grip (pressure)"] > 0.75 > auc["vibration"] + 0.05
assert auc["TemporalTaxelNet"] < auc["weak grip (pressure)"] + 0.05, "no gain from so few grasps"
assert early["weak grip (pressure)"] > early["vibration"] + 0.2
assert held_alarmed["vibration"] > 0.6

# %% [markdown]
# ## What to take from this
#
# * `Windows(label="ahead", horizon=...)` turns any recording with labels in time into a forecast.
#   Split by trial, since windows of one grasp are nearly copies of each other.
# * For each frame, `step` with a state gives the same numbers as the window, so the model that you
#   tested is the model that runs on the robot.
# * Count false alarms at the same moments as correct alarms, and compare every network with a
#   threshold on one signal. Here, the threshold wins with 31 training grasps. With 1,200, it
#   announces as many slips, and the network only ranks moments better.
# * An early alarm mostly reflects the grip. None of this was measured on a real hand, and each
#   point of the figure stands for only 15 to 24 slipping grasps.
#
# ## Next
#
# * [Windows, trials and time](../docs/time.md), and [simulated
#   grasps](../docs/simulation.md#grasps-with-three-fingertips): what the simulator models and what
#   it leaves out.
# * [Early slip, the full study](../docs/results/early_slip.md): 2,000 grasps, an LSTM, held-out
#   objects.
# * [Grasps of your own in this format](../docs/bigs.md), and [tutorial 3](03_live_robot.py): the
#   model on a live stream.
