# %% [markdown]
# # A policy that feels: what is touch worth to a robot that acts?
#
# A gripper lifts unknown objects. If it squeezes too little, they slip or turn. If it squeezes too
# much, they are crushed. An expert that knows each object demonstrates the task. Two policies learn
# from it, one from the motors alone and one with touch. Then both lift the same new objects.
#
# - **Data**: demonstrations of a simulated gripper (MuJoCo), recorded here.
# - **You will see** an expert's squeeze, two policies that differ only in their inputs, their
#   success in closed loop, and the demonstrations as a LeRobot data set.
# - **Time**: about 50 s. [The results page](../docs/results/touch_policies.md) has the whole table,
#   with five seeds and more inputs.

# %% [markdown]
# ## The task, and an expert
#
# `GripperLift` runs at 20 Hz. An action is a change of the logarithm of the squeeze and the speed
# of the lift. Each episode draws mass, friction, centre of mass and sensor errors. `record_lift`
# runs an episode and returns a `Recording` with the actions. With `noise`, the executed actions are
# disturbed for a while, so that the expert shows how to recover.

# %%
import matplotlib.pyplot as plt
import numpy as np

from torch_geometric_tactile.sim import GripperLift, constant_squeeze, record_lift

env = GripperLift()
demonstrations = [record_lift(env, seed, noise=0.4) for seed in range(120)]
print(env)
print(demonstrations[0])
print({label: sum(r.label == label for r in demonstrations) for label in ("success", "crushed")})

# %% [markdown]
# The right squeeze differs between objects by a factor of up to 40, so no constant fits. Each line
# ends one step before its episode:

# %% tags=["figure"]
figure, axes = plt.subplots(1, 3, figsize=(9, 2.6), sharey=True, layout="constrained")
for axis, seed in zip(axes, (8, 2, 4), strict=True):
    for name, policy in (("expert", None), ("constant 3 N", constant_squeeze(3.0))):
        options = {} if policy is None else {"policy": policy}
        recording = record_lift(env, seed, **options)
        axis.plot(
            recording.time, recording.privileged["squeeze"], label=f"{name}: {recording.label}"
        )
    need = recording.meta["need"]
    axis.axhspan(need, 1.6 * need + 0.5, color="green", alpha=0.15)
    axis.set(xlabel="time in s", title=f"object {seed}")
    axis.legend(fontsize=7)
axes[0].set(ylabel="squeeze in N, green: right")
plt.show()

# %% [markdown]
# ## Two policies
#
# `lift_inputs` returns the inputs of a policy at one step. `"none"` has the motors alone
# (positions, velocities, commands, forces), and `"taxels"` adds the readings of 32 taxels with
# three axes. Both policies see the last eight steps and have the same network, except for its first
# layer.

# %%
import torch
from torch import nn

from torch_geometric_tactile.sim import lift_inputs, lift_observations

STEPS, SCALE = 8, np.array([0.3, 0.05])  # the largest actions


def last_steps(steps):
    padded = np.concatenate([np.repeat(steps[:1], STEPS - 1, axis=0), steps])
    return np.lib.stride_tricks.sliding_window_view(padded, STEPS, axis=0).reshape(len(steps), -1)


def table(name):
    inputs, actions = [], []
    for r in demonstrations:
        inputs.append(last_steps(np.stack([lift_inputs(o, name) for o in lift_observations(r)])))
        actions.append(r.action / SCALE)
    return [torch.from_numpy(np.concatenate(rows)).float() for rows in (inputs, actions)]


def learn(name, updates=2000):
    torch.manual_seed(0)
    inputs, actions = table(name)
    mean, scale = inputs.mean(dim=0), inputs.std(dim=0) + 1e-6
    network = nn.Sequential(
        nn.Linear(inputs.size(1), 256), nn.ReLU(), nn.Linear(256, 256), nn.ReLU(), nn.Linear(256, 2)
    )
    optimizer = torch.optim.AdamW(network.parameters(), 1e-3)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, updates)
    for _ in range(updates):
        rows = torch.randint(len(inputs), (128,))
        loss = (network((inputs[rows] - mean) / scale) - actions[rows]).square().mean()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        schedule.step()
    print(f"{name}: {inputs.size(1)} inputs, {len(inputs)} steps, loss {loss:.3f}")
    return lambda steps: network((torch.from_numpy(steps).float() - mean) / scale)


policies = {name: learn(name) for name in ("none", "taxels")}

# %% [markdown]
# ## Closed loop
#
# The loss of a policy says little, since its errors add up. What matters is whether it lifts new
# objects. Both policies get the same objects and the same noise, so the episodes are paired.


# %%
class Policy:
    """Decides by the last steps of an episode."""

    def __init__(self, name):
        self.name, self.history = name, []

    @torch.no_grad()
    def __call__(self, env):
        self.history.append(lift_inputs(env.observation, self.name))
        steps = last_steps(np.stack(self.history[-STEPS:]))[-1:]
        return policies[self.name](steps)[0].double().numpy() * SCALE


FAILURES = ("slipped", "turned", "crushed", "unfinished")
episodes = {
    name: [record_lift(env, seed, policy=Policy(name)) for seed in range(500, 570)]
    for name in policies
}
success = {name: np.array([r.label == "success" for r in rows]) for name, rows in episodes.items()}
for name, rows in episodes.items():
    counts = {label: sum(r.label == label for r in rows) for label in FAILURES}
    print(f"{name:7}{success[name].mean():5.0%} of {len(rows)} lifted, failures: {counts}")

# %% [markdown]
# Is the difference beyond the noise? There is one training of each policy, so only the objects
# count here:

# %%
gain = success["taxels"].astype(float) - success["none"]
error = gain.std(ddof=1) / np.sqrt(len(gain))
print(f"touch lifts {100 * gain.mean():.0f} ± {200 * error:.0f} points more (95 %)")
assert gain.mean() > 2 * error, "touch helps"

# %% tags=["figure"]
figure, axes = plt.subplots(1, 2, figsize=(8, 3), sharey=True, layout="constrained")
titles = {"none": "motors only", "taxels": "motors and touch"}
for axis, (name, rows) in zip(axes, episodes.items(), strict=True):
    need = np.array([r.meta["need"] for r in rows])
    peak = np.array([r.meta["peak"] for r in rows])
    line = np.geomspace(0.2, 13, 50)
    axis.fill_between(line, line, 1.6 * line + 0.5, color="green", alpha=0.15)
    for label, marker in (("success", "o"), ("slipped", "v"), ("turned", "s"), ("crushed", "x")):
        those = np.array([r.label == label for r in rows])
        axis.scatter(need[those], peak[those], marker=marker, s=18, label=label)
    axis.set(xscale="log", yscale="log", xlabel="needed squeeze in N", title=titles[name])
axes[0].set_ylabel("peak squeeze in N")
axes[1].legend(fontsize=8)
plt.show()

# %% [markdown]
# Without touch, the squeeze follows the need only roughly, through the force of the lifting motor:
# objects that need little are crushed, and objects that need much turn. With touch, it follows the
# need over a factor of ten. Most failures are squeezed a little too much, and a few lifts do not
# end in time.
#
# ## Write the demonstrations for LeRobot
#
# LeRobot's policies read only `observation.state`, `observation.environment_state` and images, so
# write touch to one of these features: `key=` names the feature. To use ACT with an encoder that
# knows the layout, keep the readings as `observation.tactile` and use the plug-in
# `lerobot_policy_touch` ([LeRobot data sets](../docs/lerobot.md#a-policy-that-reads-touch)).

# %%
import json
import tempfile
from dataclasses import replace
from pathlib import Path

from torch_geometric_tactile.io import write_lerobot

root = Path(tempfile.mkdtemp()) / "lift"
measured = [replace(r, privileged={}) for r in demonstrations]  # without what only MuJoCo knows
write_lerobot(measured, root, fps=20, key="observation.environment_state")
features = json.loads((root / "meta" / "info.json").read_text())["features"]
print(
    {
        name: feature["shape"]
        for name, feature in features.items()
        if "." in name or name == "action"
    }
)

# %% [markdown]
# ## What to take from this
#
# * Evaluate a policy in closed loop, on paired episodes. Its loss does not show the value of touch.
# * The claim is "from the same demonstrations", not "impossible without touch".
# * The gripper is simulated and its sensor is good. With a rough sensor (15 % gains, 20 mN
#   offsets), the gain is smaller or gone: see [the table](../docs/results/touch_policies.md).
# * For LeRobot, touch counts only in a feature that the policy reads.
#
# ## Next
#
# * [The task](../docs/touch_policies.md), its limits, and [all
#   rows](../docs/results/touch_policies.md).
# * [Touch in LeRobot](../docs/lerobot.md).
# * [Tutorial 3](03_live_robot.py): the same numbers live as in the lab.
