# %% [markdown]
# # A new day: is it the sensor or the object?
#
# A model of grasp stability has an accuracy of 91 %. The next day, with new objects, the accuracy is 70 %. Did the sensor change,
# or are the objects too different? The data are those of [tutorial 1](01_real_grasps.py): 5,831 real grasps with three BioTac SP
# fingertips (BTS3, a download of 2 MB).
#
# You will see how to separate the two causes with data that you already have, four ways to prepare the readings, and how many
# grasps of a new session are needed before scaling by session works. The tutorial takes about half a minute on one CPU core.

# %% [markdown]
# ## What the data can show
#
# The official test has other objects *and* other sessions, so it cannot separate the two. The training set can: the same 41
# objects were grasped in each of its three sessions, which differ in the pose of the palm and in time.

# %%
from torch_geometric_tactile.datasets import BioTacSP

train, test = BioTacSP(split="train"), BioTacSP(split="test")
every = BioTacSP(split=None)
for number, name in enumerate(every.session_names):
    here = every.session == number
    slip = every.y[here].float().mean()
    print(
        f"{name:<15} {here.sum():>5} grasps, {len(every.group[here].unique())} objects, {slip:.0%} slip"
    )

# %% [markdown]
# First, look at the readings. The figure shows the mean over the 24 electrodes of each finger, grasp by grasp, in the order of
# the files. This mean is the level of the finger, in raw counts.

# %% tags=["figure"]
import matplotlib.pyplot as plt
import torch

FINGERS = ["index finger", "middle finger", "thumb"]
levels = every.x.mean(1)
figure, axes = plt.subplots(3, 1, figsize=(9, 6), sharex=True, layout="constrained")
for finger, ax in enumerate(axes):
    for number, name in enumerate(every.session_names):
        (rows,) = torch.where(every.session == number)
        ax.plot(rows, levels[rows, finger], ".", markersize=2, label=name.replace("_", " "))
    ax.set_ylabel(f"{FINGERS[finger]}\n(counts)")
figure.legend(*axes[0].get_legend_handles_labels(), loc="outside upper center", ncols=6,
              markerscale=5, fontsize=9, frameon=False)  # fmt: skip
axes[2].set_xlabel("grasp, in the order of the files")
plt.show()

# %% [markdown]
# The level jumps between sessions. Within a session, it drops at some places, often for several fingers at once, and rises again
# over about a hundred grasps and several objects. A sensor that settles after a restart looks like this. The authors neither
# explain these drops nor say that the rows are in the order of recording, but the smooth rises suggest it.
#
# ## The same object, twice
#
# Some objects were grasped again later in the same session. If the object determined the level, the same object would return to
# the same level, and the next object would have a different one. We compare the mean levels of runs of grasps of one object.

# %%
from torch_geometric.utils import scatter

place = every.session * len(every.group_names) + every.group  # one number for object and session
run_place, run, size = torch.unique_consecutive(place, return_inverse=True, return_counts=True)
run_level = scatter(levels, run, reduce="mean")
first, second = torch.combinations(torch.where(size >= 5)[0]).T
change = (run_level[first] - run_level[second]).abs()
session, group = run_place // len(every.group_names), run_place % len(every.group_names)
same_session, same_object = session[first] == session[second], group[first] == group[second]
changes = {
    "next object,\nsame session": change[same_session & ~same_object & (second == first + 1)],
    "same object, later\nin the session": change[same_session & same_object],
    "same object,\nother session": change[~same_session & same_object],
}

# %% tags=["figure"]
figure, axes = plt.subplots(1, 3, figsize=(9, 3.2), sharey=True, layout="constrained")
for finger, ax in enumerate(axes):
    values = [pairs[:, finger].numpy() for pairs in changes.values()]
    ax.boxplot(values, showfliers=False, medianprops={"color": "black"})
    ax.set_xticks(
        [1, 2, 3], [f"{name}\n({len(pairs)})" for name, pairs in changes.items()], fontsize=7
    )
    ax.set_title(FINGERS[finger])
axes[0].set_ylabel("change of the level (counts)")
plt.show()

# %% [markdown]
# A new object changes the level by about 40 counts on average. The *same* object, some hundreds of grasps later, differs from
# itself by two to three times as much (there are only 13 such pairs). The level therefore depends on time more than on the
# object.
#
# Is the pose of the palm the cause? If it were, the poses would differ in the test as much as in training. They do not:

# %%
next_object, same_later, _ = (pairs.mean(0) for pairs in changes.values())
assert (same_later > 1.4 * next_object).all()

pose_level = scatter(levels, every.session, reduce="mean")
for finger, name in enumerate(FINGERS):
    ranges = [float(pose_level[part, finger].max() - pose_level[part, finger].min())
              for part in (slice(0, 3), slice(3, 6))]  # fmt: skip
    print(
        f"{name:<14} the poses differ by {ranges[0]:.0f} counts in training, {ranges[1]:.0f} in the test"
    )
    assert ranges[0] > 2 * ranges[1]

# %% [markdown]
# ## Four scores in place of one
#
# Now train the model. `Protocol` holds out objects, sessions or both within the training set, which gives a table of two rows and
# two columns. The readings are prepared in four ways:
#
# | readings | preparation | requirement |
# |---|---|---|
# | raw | mean and deviation of each electrode in the training part | none |
# | tare | first subtracts the mean of each electrode in its session | unlabelled grasps of the session |
# | session | mean and deviation of each electrode in its session | unlabelled grasps of the session |
# | common mode | subtracts each finger's mean in this reading; middle finger and thumb only | none |
#
# A real tare subtracts readings at rest, before touch (`Tare("session", first=...)`). This data set has none, so we use the mean
# of the session instead. `fit_parts(..., adapt=True)` measures a new session and changes nothing else.

# %%
import copy

from torch_geometric.transforms import Compose

from torch_geometric_tactile.baselines import GraspSVM
from torch_geometric_tactile.data import Protocol
from torch_geometric_tactile.transforms import (
    CommonMode,
    SelectChannels,
    SessionZScore,
    Tare,
    ZScore,
    fit_parts,
)

READINGS = {
    "raw": Compose([ZScore()]),
    "tare": Compose([Tare("session"), ZScore()]),
    "session": Compose([SessionZScore()]),
    "common mode": Compose([CommonMode(), SelectChannels([1, 2]), ZScore()]),
}
PROTOCOLS = {
    "same objects,\nsame session": Protocol("frame", folds=3),
    "new objects,\nsame session": Protocol("group", folds=3),
    "same objects,\nnew session": Protocol("session", leave_one_out=True),
    "new objects,\nnew session": Protocol("group", folds=3, unseen="session"),
}


def fitted(transform, dataset):
    """A scaling and an SVM of a training part."""
    scaling = copy.deepcopy(transform)
    fit_parts(scaling, dataset.data)
    x = scaling(dataset.data).x
    return scaling, GraspSVM(num_fingers=x.size(2)).fit(x, dataset.y)


def adapted(scaling, dataset):
    """The scaling after it has measured the new sessions of a data set, without labels."""
    scaling = copy.deepcopy(scaling)
    fit_parts(scaling, dataset.data, adapt=True)
    return scaling


def right_answers(scaling, svm, dataset):
    """Whether the SVM is right, for each grasp of a data set."""
    return torch.from_numpy(svm.predict(scaling(dataset.data).x)) == dataset.y


accuracy, error = {}, {}
for kind, transform in READINGS.items():
    for name, protocol in PROTOCOLS.items():
        right = torch.zeros(len(train))
        for fold in range(protocol.num_folds(train)):
            seen, _, held_out = protocol.split(train, fold=fold)
            scaling, svm = fitted(transform, train[seen])
            scaling = adapted(scaling, train[held_out])
            right[held_out] = right_answers(scaling, svm, train[held_out]).float()
        of_object = torch.stack([right[train.group == g].mean() for g in train.group.unique()])
        error[kind, name] = float(of_object.std() / len(of_object) ** 0.5)
        accuracy[kind, name] = float(right.mean())

# %% tags=["figure"]
from torch_geometric_tactile.visualization import plot_protocols

table = {name: {k: (accuracy[k, name], error[k, name]) for k in READINGS} for name in PROTOCOLS}
plot_protocols({"SVM": table}, chance=0.5)

# %% [markdown]
# The bars show the standard error over the 41 objects, about one point. In the first row, new objects cost a few points. A new
# session with the *same* objects costs more than thirty, and new objects on top of it cost hardly anything more. **The cause is
# the session, not the object.**
#
# In the lower rows, the session costs much less. Scaling by session and the common mode both stay above 80 % with new objects in
# a new session. The common mode, with one finger left out, loses a few points if nothing has changed.
#
# A caveat: here, a session is a pose *and* a time. The levels above suggest that time is the cause, but accuracy cannot separate
# the two with these data.

# %%
same, objects, sessions, both = PROTOCOLS
raw = {name: accuracy["raw", name] for name in PROTOCOLS}
assert raw[same] - raw[objects] < 0.08
assert raw[same] - raw[sessions] > 0.25
assert raw[sessions] - raw[both] < 0.05
assert min(accuracy["session", both], accuracy["common mode", both]) > raw[both] + 0.2

# %% [markdown]
# ## How many grasps does a new session need?
#
# Scaling by session must see some grasps of the session first. We train on all training grasps and test on the official test:
# three new sessions, ten new objects. In each session, the robot makes $n$ grasps, drawn at random, without labels. The scaling
# measures these, and the score is that of all other grasps. We repeat the draw four times for each $n$.

# %%
draws = torch.Generator().manual_seed(0)
official = {kind: fitted(transform, train) for kind, transform in READINGS.items()}


def draw(n, allowed):
    """Indices of n allowed grasps of each session of the official test."""
    drawn = []
    for number in test.session.unique():
        (index,) = torch.where((test.session == number) & allowed)
        drawn.append(index[torch.randperm(len(index), generator=draws)[:n]])
    return torch.cat(drawn)


def score_after(kind, chosen):
    """Accuracy on the other grasps of the test, once the scaling has measured the chosen ones."""
    scaling, svm = official[kind]
    others = torch.ones(len(test), dtype=torch.bool)
    others[chosen] = False
    return float(right_answers(adapted(scaling, test[chosen]), svm, test[others]).float().mean())


anything = torch.ones(len(test), dtype=torch.bool)
NUMBERS = (2, 5, 10, 20, 100)
curves = {
    kind: {
        n: torch.tensor([score_after(kind, draw(n, anything)) for _ in range(4)]) for n in NUMBERS
    }
    for kind in ("tare", "session")
}
nothing_needed = {
    kind: float(right_answers(*official[kind], test).float().mean())
    for kind in ("raw", "common mode")
}

# %% tags=["figure"]
figure, ax = plt.subplots(figsize=(7, 4), layout="constrained")
for kind, scores in curves.items():
    means, spreads = ([float(f(v)) for v in scores.values()] for f in (torch.mean, torch.std))
    ax.errorbar(NUMBERS, means, spreads, marker="o", capsize=3, label=f"{kind}, after n grasps")
for (kind, score), style in zip(nothing_needed.items(), (":", "--"), strict=True):
    ax.axhline(score, color="black", linestyle=style, label=f"{kind}, from the first grasp")
ax.set_xscale("log")
ax.set_xticks(NUMBERS, NUMBERS)
ax.set_ylim(0.45, 0.87)
ax.minorticks_off()
ax.set_xlabel("n: unlabelled grasps of each new session")
ax.set_ylabel("accuracy on the official test")
ax.legend()
plt.show()

# %% [markdown]
# Two grasps do not determine a deviation, and scaling by session is at chance, far *below* raw readings. From 10 to 20 grasps on,
# both methods are near their best, about 80 %. The tare needs fewer grasps, since it measures only a mean. The common mode needs
# none and is as good or better here. The ten test objects give an error of about 3 points, so do not read more into this.

# %%
mean = {(kind, n): float(v.mean()) for kind in curves for n, v in curves[kind].items()}
assert mean["session", 2] < nothing_needed["raw"] - 0.1
assert min(mean["session", 20], mean["tare", 20]) > nothing_needed["raw"] + 0.05
assert mean["tare", 5] > mean["session", 5]
assert nothing_needed["common mode"] > mean["session", 100] - 0.03

# %% [markdown]
# ## Which grasps?
#
# The draws above mix all ten objects and both outcomes, which a robot on a new day may not do. What if it makes 20 grasps of
# *one* object in each session, or only stable or only slipping grasps?

# %% tags=["figure"]
one_object = [test.group == number for number in test.group.unique()]
CHOICES = {
    "one object": one_object,
    "stable only": [test.y == 0] * 3,
    "slipping only": [test.y == 1] * 3,
}
after = {"all objects": {kind: scores[20] for kind, scores in curves.items()}}
after |= {
    name: {k: torch.tensor([score_after(k, draw(20, a)) for a in allowed]) for k in curves}
    for name, allowed in CHOICES.items()
}
figure, ax = plt.subplots(figsize=(7, 3.5), layout="constrained")
for offset, kind in ((-0.1, "tare"), (0.1, "session")):
    for number, scores in enumerate(after.values()):
        places = number + offset + torch.linspace(-0.05, 0.05, len(scores[kind]))
        color = {"tare": "C0", "session": "C1"}[kind]
        ax.plot(places, scores[kind], ".", color=color, label=None if number else kind)
ax.axhline(nothing_needed["raw"], color="black", linestyle=":", label="raw")
ax.axhline(nothing_needed["common mode"], color="black", linestyle="--", label="common mode")
ax.set_xticks(range(len(after)), [f"20 grasps,\n{name}" for name in after])
ax.set_ylabel("accuracy on the official test")
ax.set_ylim(0.45, 0.87)
ax.legend(loc="lower left")
plt.show()

# %% [markdown]
# Each dot is one draw. Adapted on one object, scaling by session falls below raw readings for most objects: it mistakes the
# effect of this object for the offset and gain of the sensor. Slipping grasps alone also cost points, while stable ones cost
# little here. The scaling uses no labels, but it needs sessions that mix objects and outcomes.


# %%
def average(name, kind):
    """The mean over the draws."""
    return float(after[name][kind].mean())


assert average("one object", "session") < average("all objects", "session") - 0.06
assert average("one object", "session") < nothing_needed["raw"]
assert average("slipping only", "session") < average("all objects", "session") - 0.03

# %% [markdown]
# ## What to take from this
#
# - A single test with new objects *and* a new session cannot show the cause of an error. Record the same objects on two days, and
#   hold out objects, sessions, and both.
# - In these data, the cause is the session: the same objects in a new session cost over 30 points, new objects in a known session
#   a few.
# - If you can, record a few frames at rest in each session and use `Tare("session", first=...)`. These data have none.
# - `CommonMode` needs no grasps of the new session. Scaling by session needs 10 to 20 in each, of several objects and both
#   outcomes. With fewer grasps, or grasps of one object, it can be worse than raw readings.
# - These data cannot show whether the sensor's offset, its temperature or the grasp force changed. Without readings at rest,
#   these causes look the same.
#
# ## Next
#
# - [To a live robot](03_live_robot.py): rest and tare on a running sensor
# - [What has it learnt?](10_what_it_learnt.py)
# - [Session scaling: what it may and may not assume](../docs/scaling.md#session-scaling-assumptions-and-limits), and [from raw
#   readings to inputs](../docs/scaling.md)
# - [All results on these grasps](../docs/results/grasp_stability.md)
