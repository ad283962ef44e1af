# %% [markdown]
# # Real grasps with three fingertips: will it slip?
#
# A Shadow hand closes three BioTac SP fingertips around an object. Can one tactile reading, taken before the lift, tell whether
# the object will slip? The data are 5,831 real grasps of 51 objects (BTS3, a download of 2 MB).
#
# You will see the same model score above 90 % or near chance on the same grasps, depending on what the test holds out. You will
# also see why, and how to prepare the readings so that the score recovers. The tutorial takes about half a minute on one CPU
# core.

# %% [markdown]
# ## The data
#
# `train[0]` is an ordinary PyG `Data` object. It has 24 electrodes (taxels) with three channels, one for each finger, in raw
# counts. The label `y` is 1 if the object slipped. `group` is the number of the object. `session` is the number of the recording
# session: one for each pose of the palm, in training and in the official test.

# %%
from torch_geometric_tactile.datasets import BioTacSP

train = BioTacSP(split="train")
test = BioTacSP(split="test")
print(train[0])
for name, part in {"train": train, "test": test}.items():
    objects, slip = len(part.group.unique()), part.y.float().mean()
    print(f"{name}: {len(part)} grasps of {objects} objects, {100 * slip:.0f} % slip")
print("sessions:", *train.session_names)

# %% [markdown]
# The layout contains the positions of the electrodes. The figure shows the mean of all stable and of all slipping grasps of one
# object in one session, each finger relative to its own mean. The two outcomes differ little, so no single electrode gives the
# answer.

# %% tags=["figure"]
from torch_geometric.transforms import Compose

from torch_geometric_tactile.transforms import CommonMode, ZScore, fit_transform
from torch_geometric_tactile.visualization import plot_grasps

FINGERS = ["index finger", "middle finger", "thumb"]
scaled = fit_transform(Compose([CommonMode(), ZScore(per="channel")]), train)
of_olaf = (train.group == train.group_names.index("olaf")) & (train.session == 0)
means = {
    f"{name}, mean of {int((of_olaf & (train.y == label)).sum())} grasps": scaled.x[
        of_olaf & (train.y == label)
    ].mean(0)
    for label, name in enumerate(train.class_names)
}
plot_grasps(train.layout, means, FINGERS)

# %% [markdown]
# ## One model, four tests
#
# A score means little unless you say what was held out. We train the same support vector machine (SVM) on raw readings and test
# it in four ways:
#
# | protocol | new to the model | known to the model |
# |---|---|---|
# | random grasps | the grasp | the object and the session |
# | new objects | the object | the session |
# | new objects and session | the object, and all grasps of the session | two other sessions |
# | official test | the object, and all grasps of the session | three other sessions |
#
# The first three use training data only. `Protocol` draws the splits, and the SVM standardises each electrode on the training
# part.

# %%
import torch

from torch_geometric_tactile.baselines import GraspSVM
from torch_geometric_tactile.data import Protocol

every = BioTacSP(split=None)
PROTOCOLS = {
    "random grasps": (train, Protocol("frame", folds=3)),
    "new objects": (train, Protocol("group", folds=3)),
    "new objects and session": (train, Protocol("group", folds=3, unseen="session")),
    "official test": (every, Protocol("given")),
}


def right_answers(dataset, protocol, transform):
    """For each grasp 1 if the SVM was right, 0 if it was wrong, NaN if it was not tested on."""
    x, y = transform(dataset.data).x, dataset.y
    right = torch.full((len(dataset),), torch.nan)
    for fold in range(protocol.num_folds(dataset)):
        seen, _, held_out = protocol.split(dataset, seed=0, fold=fold)
        svm = GraspSVM(num_fingers=x.size(2)).fit(x[seen], y[seen])
        right[held_out] = (torch.from_numpy(svm.predict(x[held_out])) == y[held_out]).float()
    return right


raw = Compose([])  # changes nothing
right = {("raw", name): right_answers(*of, raw) for name, of in PROTOCOLS.items()}
accuracy = {key: float(answers.nanmean()) for key, answers in right.items()}
for (_, name), score in accuracy.items():
    print(f"{name:<24} {100 * score:.1f} %")

# %% [markdown]
# The stricter the test, the lower the score: it falls from above 90 % to near chance (50 %). A test on random grasps mostly
# measures what the model has already seen. New objects alone cost a few points. A new *session* costs nearly everything.

# %%
assert accuracy["raw", "random grasps"] > 0.88
assert accuracy["raw", "random grasps"] > accuracy["raw", "new objects"] + 0.01
assert accuracy["raw", "new objects"] > accuracy["raw", "official test"] + 0.1
assert accuracy["raw", "new objects and session"] < 0.62

# %% [markdown]
# ## Why: the sensor's level moves
#
# The figure shows the mean over the 24 electrodes of each finger, by session (boxes hold the middle half of the grasps, whiskers
# nearly all). For the middle finger and the thumb, the level differs more between training sessions than within a session. A
# model that has learnt levels fails in the next session. [A new day](04_new_day.py) asks whether the sensor or the object causes
# this.

# %% tags=["figure"]
import matplotlib.pyplot as plt

figure, axes = plt.subplots(1, 3, figsize=(9, 3.4), layout="constrained")
for finger, ax in enumerate(axes):
    levels = [every.x[every.session == s, :, finger].mean(1).numpy() for s in range(6)]
    boxes = ax.boxplot(levels, showfliers=False, patch_artist=True, medianprops={"color": "black"})
    for number, box in enumerate(boxes["boxes"]):
        box.set_facecolor("#9ecae1" if number < 3 else "#fdae6b")
    names = [name.replace("_", " ") for name in every.session_names]
    ax.set_xticks(range(1, 7), names, rotation=60, ha="right", rotation_mode="anchor")
    ax.set_title(FINGERS[finger])
axes[0].set_ylabel("mean of 24 electrodes (counts)")
parts = ["training", "official test"]
figure.legend(boxes["boxes"][::3], parts, loc="outside upper right", ncols=2, frameon=False)
plt.show()

# %% [markdown]
# ## The common mode restores the score
#
# `CommonMode` subtracts the mean over the electrodes of each finger from each reading. This removes the level from the first
# grasp of a session on and leaves only the differences between electrodes.
#
# For the index finger, even these differences do not carry over to another session, so the second step is to leave this finger
# out. We decided this on training data alone, with the protocol "new objects and session" ([how the choices were
# made](../docs/results/grasp_stability.md#how-the-choices-were-made)): an SVM that is trained on the index finger only is hardly
# better than chance there.

# %%
from torch_geometric_tactile.transforms import SelectChannels

index_finger = Compose([CommonMode(), SelectChannels([0])])
alone = right_answers(*PROTOCOLS["new objects and session"], index_finger).nanmean()
print(f"common mode, index finger alone, new objects and session: {100 * alone:.1f} %")
assert alone < 0.6

# %% [markdown]
# Now apply each step alone, and then both.

# %%
BEST = "common mode, middle + thumb"
middle_thumb = SelectChannels([1, 2])
READINGS = {
    "raw, middle + thumb": middle_thumb,
    "common mode": CommonMode(),
    BEST: Compose([CommonMode(), middle_thumb]),
}
for kind, transform in READINGS.items():
    for name, of in PROTOCOLS.items():
        right[kind, name] = right_answers(*of, transform)
accuracy = {key: float(answers.nanmean()) for key, answers in right.items()}

# %% [markdown]
# Grasps of the same object are similar and therefore not independent. The bars below are the standard error over *objects*: 41 in
# training, but only ten in the official test.

# %% tags=["figure"]
from torch_geometric_tactile.visualization import plot_protocols


def error_over_objects(answers, group):
    """The standard error of the accuracy if each object counts once."""
    tested = ~answers.isnan()
    objects = [answers[tested & (group == g)].mean() for g in group[tested].unique()]
    return float(torch.stack(objects).std() / len(objects) ** 0.5)


scores = {name: {} for name in PROTOCOLS}
for (kind, name), answers in right.items():
    error = error_over_objects(answers, PROTOCOLS[name][0].group)
    scores[name][kind] = (accuracy[kind, name], error)
plot_protocols({"SVM": scores}, chance=0.5)

# %% [markdown]
# - **New objects and session:** raw readings fail. One step alone gains 3 to 9 points. Both together reach about 80 %.
# - **Official test:** both steps together are best here too, at about 83 %. But nearly all of the gain comes from dropping the
#   index finger: raw readings of middle finger and thumb are one point behind, well within the error. The boxes above show a
#   likely reason. In these test sessions, the levels of both fingers lie between those of the training sessions, while a left-out
#   training session lies outside. You cannot expect this of the next session.
# - **Random grasps:** leaving a finger out *loses* about four points. A feature that misleads in another session is useful in the
#   same session, so a test with random grasps would have kept this finger.

# %%
session = {kind: accuracy[kind, "new objects and session"] for kind in ("raw", *READINGS)}
official = {kind: accuracy[kind, "official test"] for kind in ("raw", *READINGS)}
assert session[BEST] > max(score for kind, score in session.items() if kind != BEST) + 0.1
assert official[BEST] > official["raw"] + 0.08
assert official[BEST] > official["raw, middle + thumb"] - 0.02  # not claimed to be better
assert accuracy[BEST, "random grasps"] < accuracy["raw", "random grasps"] - 0.01

# %% [markdown]
# What would a robot notice? With the palm to the side, the raw SVM calls nearly every grasp of the official test stable. The
# accuracy of 50 % hides that its errors all go in one direction.

# %% tags=["figure"]
from sklearn.metrics import confusion_matrix

from torch_geometric_tactile.visualization import plot_confusion


def palm_side(kind):
    """The confusion matrix with the palm to the side, in the official test."""
    here = every.session == every.session_names.index("palm_side_test")
    y, was_right = every.y[here], right[kind, "official test"][here]
    return confusion_matrix(y, torch.where(was_right == 1, y, 1 - y))


plot_confusion(palm_side("raw"), every.class_names, "Palm to the side, raw readings")

# %% tags=["figure"]
plot_confusion(palm_side(BEST), every.class_names, f"Palm to the side, {BEST}")

# %%
assert palm_side("raw")[1, 1] < 0.2 * palm_side("raw")[1].sum()  # few slips are announced
assert palm_side(BEST)[1, 1] > 0.7 * palm_side(BEST)[1].sum()

# %% [markdown]
# ## Does a network change this?
#
# We train two networks with Lightning, on raw readings and on the best readings from above, with two seeds each, and score them
# on the official test. `GraspGCN` is a graph convolution over the two nearest electrodes (the GCN-DF of a published paper).
# `TaxelNet` is our network and uses directions on the skin. `tactile table bts3` trains them for 8 and 10 epochs with a schedule;
# here we train for 5 epochs to save time.
#
# `TactileDataModule` fits the scaling on the training part. The `Predictor` takes raw readings, as a robot would.

# %%
from functools import partial

import lightning

from torch_geometric_tactile import Predictor
from torch_geometric_tactile.nn import GraspGCN, TaxelNet
from torch_geometric_tactile.training import TactileDataModule, TactileModule, quiet_lightning
from torch_geometric_tactile.transforms import KNNGraph

graphs = BioTacSP(split=None, transform=KNNGraph(k=2))


def official_score(model, optimizer, transform):
    """Trains on all training grasps; returns the accuracy on the official test."""
    data = TactileDataModule(graphs, split=Protocol("given"), transform=transform, batch_size=256)
    classifier = TactileModule(model, optimizer)
    with quiet_lightning():
        trainer = lightning.Trainer(max_epochs=5, accelerator="cpu", barebones=True)
        trainer.fit(classifier, data)
    predictor = Predictor.from_dataset(classifier.model, graphs, data.transform)
    return float((predictor(test.data.x).argmax(-1) == test.y).float().mean())


adam = partial(torch.optim.Adam, lr=0.01, weight_decay=0.001)
adamw = partial(torch.optim.AdamW, lr=0.003)
networks = {}
for kind, fingers, transform in [
    ("raw", 3, ZScore()),
    (BEST, 2, Compose([CommonMode(), middle_thumb, ZScore(per="channel")])),
]:
    for seed in (0, 1):
        lightning.seed_everything(seed, verbose=False)
        gcn = GraspGCN("biotac_sp", 2, num_fingers=fingers, dropout=0.1)
        net = TaxelNet("biotac_sp", 2, in_channels=fingers, depth=1, taxel_dropout=0.0)
        networks.setdefault(("GraspGCN", kind), []).append(official_score(gcn, adam, transform))
        networks.setdefault(("TaxelNet", kind), []).append(official_score(net, adamw, transform))

# %% tags=["figure"]
rows = {("SVM", "raw"): [official["raw"]], ("SVM", BEST): [official[BEST]], **networks}
table = {}
for (model, kind), values in rows.items():
    mean, spread = torch.tensor(values).mean(), torch.tensor(values).std(correction=0)
    protocol = table.setdefault(model, {"official test": {}})["official test"]
    protocol[kind] = (float(mean), float(spread))
plot_protocols(table, chance=0.5)

# %% [markdown]
# The bars show the spread over two seeds (the SVM has no seed). The ten test objects add an error of about 3 points to every
# number. The prepared readings gain more than ten points for the SVM and the GCN, and about six for `TaxelNet`. With these
# readings, no network beats the SVM by more than the error.

# %%
mean = {key: sum(values) / len(values) for key, values in networks.items()}
assert mean["GraspGCN", BEST] > mean["GraspGCN", "raw"] + 0.05
assert mean["TaxelNet", BEST] > mean["TaxelNet", "raw"] + 0.02
assert abs(mean["TaxelNet", BEST] - official[BEST]) < 0.06

# %% [markdown]
# ## What to take from this
#
# - Say what was held out before you say how good a model is. The score was 91 % on random grasps and 54 % in a new session.
# - Hold out what will be new in use. For a robot, this is the session *and* the object. `Protocol("group", unseen="session")`
#   does this within the training data.
# - The level of a tactile sensor drifts. `CommonMode` on raw counts removes it within a single reading, without labels. It also
#   removes the overall strength of the touch, so do not use it if your task depends on strength.
# - Dropping a drifting finger can be better than keeping it. Decide this on training data, not on the test.
# - Ten test objects give an error of about 3 points. Smaller differences between models mean nothing here.
#
# ## Next
#
# - [A new day: is it the sensor or the object?](04_new_day.py), on the same data
# - [Your own glove](02_your_own_glove.py): the same steps with your own recordings
# - [All results on these grasps](../docs/results/grasp_stability.md): three seeds, more models, and how the settings were chosen
# - [From raw readings to inputs](../docs/scaling.md#common-mode), [what each metric means](../docs/metrics.md)
