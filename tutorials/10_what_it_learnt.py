# %% [markdown]
# # What has it learnt? Pictures of a model, with an untrained network beside each
#
# Attribution maps on the hand, embeddings and confusion matrices are easy to believe. But some of
# them look nearly the same for a network that was never trained. This tutorial loads a predictor
# that tells the shape of a held object, tests it on new objects, and compares each picture with
# that of the same network with **random weights**. A picture that does not change says nothing
# about what was learnt.
#
# **Simulated**: hand and objects are simulated, in training and here. The tutorial takes about half
# a minute.

# %% [markdown]
# ## A trained model in one file
#
# `hand.predictor` (193 kB) contains a `PosedTaxelNet`, the layout of the hand and the transform
# before the network. [make_predictor.py](data/make_predictor.py) created it, in about two minutes
# of training and evaluation and ten of simulation. `hand.json` describes the training data and the
# scores on held-out grasps.

# %%
import json
from pathlib import Path

from torch_geometric_tactile import Predictor

predictor = Predictor.load("data/hand.predictor")
card = json.loads(Path("data/hand.json").read_text())
print(predictor)
print("task:", card["task"])
print("trained on:", card["trained_on"], "of 40 objects")
print("held-out trials of these objects:", card["held_out_trials_of_the_same_objects"])
print("80 other objects:", card["80_other_objects_one_trial_each"])

# %% [markdown]
# ## New objects
#
# We draw 24 objects, six of each shape, with new sizes, masses and frictions. Seed 2 was used
# neither for training nor for the numbers above. The predictor takes readings relative to the mean
# reading while the hand hovers (`tare="hover"`), together with the joint angles.

# %%
import tempfile

from torch_geometric_tactile.datasets import AllegroUSkin
from torch_geometric_tactile.sim import GraspSpread, simulate

folder = tempfile.TemporaryDirectory()
settings = {"preset": "ci", "seconds": 5, "plan": GraspSpread.wide()}
reports = list(simulate(folder.name, "shapes", trials=1, seed=2, num_objects=24, **settings))

phases = ("squeeze", "lift", "hold")
dataset = AllegroUSkin(
    folder.name, task="shape", split=None, phases=phases, stride=16, tare="hover"
)
samples = dataset.batch(range(len(dataset)))
batch = predictor.prepare(samples.x, samples.joint)
y = samples.y
print(f"{len(y)} frames of {len(reports)} grasps: {', '.join(predictor.class_names)}")

# %% [markdown]
# ## The untrained networks
#
# An untrained network has the same architecture with random weights. It has seen these readings
# once to measure the scale of its inputs (the running means of its batch normalisation), but never
# a label. We create five of them.

# %%
import copy

import torch


def untrained(seed):
    torch.manual_seed(seed)
    model = copy.deepcopy(predictor.model)
    model.reset_parameters()
    with torch.no_grad():
        for _ in range(30):  # batch normalisation forgets its old means slowly
            logits(model.train(), batch)
    return model.eval()


def logits(model, batch):
    return model(batch.x, pos=batch.pos, normal=batch.normal, tangent=batch.tangent)


trained = predictor.model
untrained_models = [untrained(seed) for seed in range(5)]

# %% [markdown]
# ## Confusion: the picture that changes
#
# The first comparison is the simplest. The trained network names most shapes of new objects, while
# an untrained network is near chance (25 %).

# %% tags=["figure"]
from torch_geometric_tactile.analysis import class_confusion
from torch_geometric_tactile.visualization import plot_confusion


def answers(model):
    with torch.no_grad():
        return logits(model, batch).argmax(dim=1)


accuracy = float((answers(trained) == y).double().mean())
untrained_accuracy = [float((answers(model) == y).double().mean()) for model in untrained_models]
names = predictor.class_names
counts = class_confusion(y, answers(trained), len(names))
plot_confusion(counts, names, f"24 new objects, trained: {accuracy:.0%} of the frames")

# %% tags=["figure"]
counts = class_confusion(y, answers(untrained_models[0]), len(names))
plot_confusion(counts, names, f"24 new objects, untrained: {untrained_accuracy[0]:.0%}")

# %%
print(
    f"trained {accuracy:.0%}, untrained",
    " ".join(f"{one:.0%}" for one in untrained_accuracy),
)
assert accuracy > 0.65
assert max(untrained_accuracy) < accuracy - 0.15

# %% [markdown]
# ## Attribution on the hand: where is the evidence?
#
# Integrated gradients assign each taxel a part of a logit. With four classes, a logit has a meaning
# only relative to the others, so we subtract the mean over the classes. Positive scores (red) are
# evidence for this shape, negative scores (blue) for the others.

# %%
from torch_geometric_tactile.analysis import IntegratedGradients, taxel_attribution

steps = IntegratedGradients(num_steps=8)


def evidence(model):
    maps = []
    for shape in range(len(names)):
        chosen = batch.index_select(y == shape)
        every = [
            taxel_attribution(model, chosen, target, algorithm=steps)
            for target in range(len(names))
        ]
        maps.append(every[shape] - torch.stack(every).mean(dim=0))
    return torch.stack(maps)


learnt = evidence(trained)
random = [evidence(model) for model in untrained_models]

# %% [markdown]
# The figure shows two of the shapes on the hand: the mean pressure of their frames, the evidence of
# the trained network, and that of the first untrained network. Each picture is divided by its 99th
# percentile.

# %% tags=["figure"]
from torch_geometric_tactile.visualization import plot_hand_panels


def scaled(values):
    return values / values.abs().quantile(0.99)


pressure = torch.stack([batch.x[y == shape, :, 2].mean(dim=0) for shape in range(len(names))])
panels = {}
for name in ("box", "sphere"):
    shape = names.index(name)
    panels[f"{name}: pressure"] = scaled(pressure[shape])
    panels[f"{name}: trained"] = scaled(learnt[shape])
    panels[f"{name}: untrained"] = scaled(random[0][shape])
plot_hand_panels(
    predictor.layout, panels, label="part of the 99th percentile", limit=1.0, columns=3
)

# %% [markdown]
# All three columns mark fingertips for the box and the upper edge of the palm for the sphere. Did
# the network learn these places? We compare the size of the evidence with the pressure, and then
# its sign with that of the untrained networks.


# %%
def correlation(a, b):
    return float(torch.corrcoef(torch.stack([a.flatten(), b.flatten()]))[0, 1])


size = correlation(learnt.abs(), pressure)
untrained_size = [correlation(one.abs(), pressure) for one in random]
sign = [correlation(learnt, one) for one in random]
print(f"size of the evidence and mean pressure: trained {size:.2f}, untrained", end=" ")
print(" ".join(f"{one:.2f}" for one in untrained_size))
print("evidence with its sign, trained and untrained:", " ".join(f"{one:.2f}" for one in sign))

assert size < max(untrained_size) + 0.2, "the place of the evidence is not learnt"
assert max(abs(one) for one in sign) < 0.5, "its sign is not that of an untrained network"

# %% [markdown]
# **Where** a map is strong says nothing here: it follows the pressure, for the trained network and
# for the untrained networks. The network takes the 48 touched taxels with the largest pressure, so
# no other taxel can get any evidence. **The sign** of the evidence has nothing in common with an
# untrained network, so only the sign can have been learnt. This is still no proof that the evidence
# is right.

# %% [markdown]
# ## Embeddings: do shapes form clusters?
#
# The 48 numbers before the last layer describe a frame. Frames of one grasp are similar for any
# network, so clusters in such a map may be grasps and not shapes. We therefore also test, for each
# frame, whether the nearest frame **of another grasp** has the same shape (chance is 5 of 23, 22
# %).

# %% tags=["figure", "thumbnail"]
from torch_geometric_tactile.analysis import embed_nodes
from torch_geometric_tactile.visualization import plot_sample_embeddings


def features(model):
    found = []
    handle = model.lin_out.register_forward_pre_hook(lambda _, inputs: found.append(inputs[0]))
    with torch.no_grad():
        logits(model, batch)
    handle.remove()
    return found[0]


labels = [names[shape] for shape in y.tolist()]
described = {
    "trained": features(trained),
    "untrained": features(untrained_models[0]),
    "readings": batch.x.flatten(1),
}
places = {name: (embed_nodes(rows, seed=0), labels) for name, rows in described.items()}
plot_sample_embeddings(places, "t-SNE of the frames of 24 new objects")

# %%
from torch_geometric_tactile.analysis import node_matrix, segment_clustering


def nearest_elsewhere(rows):
    rows = node_matrix(rows)
    distance = torch.cdist(rows, rows)
    distance[samples.trial[:, None] == samples.trial] = torch.inf
    return float((y[distance.argmin(dim=1)] == y).double().mean())


rows = {"trained": described["trained"], "readings": described["readings"]}
rows |= {f"untrained {i}": features(model) for i, model in enumerate(untrained_models)}
print("frames by                same grasp nearby  same shape nearby  same shape, other grasp")
for name, one in rows.items():
    grasp = segment_clustering(one, samples.trial, num_neighbors=5).neighbor_share
    shape = segment_clustering(one, y, num_neighbors=5).neighbor_share
    print(f"{name:20}{grasp:20.0%}{shape:19.0%}{nearest_elsewhere(one):22.0%}")

# %% [markdown]
# All three maps show tight clusters, and in all three nearly every neighbour belongs to the same
# grasp and therefore has the same shape. This says nothing about learning. Only the last column
# separates them: across objects, the trained network finds the same shape about twice as often as
# most untrained networks, and the readings are no better than an untrained network.

# %%
elsewhere = {name: nearest_elsewhere(one) for name, one in rows.items()}
same_grasp = {
    name: segment_clustering(one, samples.trial, num_neighbors=5).neighbor_share
    for name, one in rows.items()
}
untrained_elsewhere = [elsewhere[f"untrained {i}"] for i in range(len(untrained_models))]
assert same_grasp["trained"] < min(same_grasp[f"untrained {i}"] for i in range(5)) + 0.1
assert elsewhere["trained"] > sum(untrained_elsewhere) / len(untrained_models) + 0.15

# %% [markdown]
# ## What to take from this
#
# * Compare each picture with that of an untrained network: `copy.deepcopy(model)` and
#   `reset_parameters()`. Give it the scale of the data, or it fails for a trivial reason.
# * Here, confusion, the sign of the evidence, and neighbours in other grasps change with training.
#   The places of the evidence and the tight clusters do not, so they say nothing about what was
#   learnt.
# * Frames of one grasp are nearly copies. If you count neighbours, exclude those of the same grasp.
# * The difference became visible in numbers, not in pictures. The numbers are from one trained
#   network, five untrained networks and 24 simulated objects.
#
# ## Next
#
# * [What a model has learnt](../docs/analysis.md): the same analysis with one command, `tactile
#   analyze`, with encoder maps and occlusion; and [an analysis of five
#   models](../docs/results/analysis.md).
# * [Predictors](../docs/predictor.md): the contents of the file, and [tutorial
#   3](03_live_robot.py): how it runs live.
# * [The study of the simulated hand](../docs/results/hand_study.md): where the pose helps, and
#   where it does not.
