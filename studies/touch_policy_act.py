r"""The rows of ACT in docs/touch_policies.md: the policy of LeRobot, and the one with touch.

Trains LeRobot's ACT on the motors alone, and the policy of `packaging/lerobot_policy_touch` on the
motors and touch, on the demonstrations of `touch_policy.py`, and adds their outcomes to its file.
Runs in an environment with LeRobot, that package and MuJoCo. Both have the same numbers; the
learning rate had the most successes of the policy with touch on the episodes 400 to 449
(`--validate`).

Examples:
    export PYTHONPATH=benchmarks:studies
    python studies/touch_policy_act.py --out docs/results/touch_policies.json
"""

import functools
from pathlib import Path

import numpy as np
import torch
from joblib import delayed
from lerobot.configs.types import FeatureType, PolicyFeature
from lerobot.policies.act.configuration_act import ACTConfig
from lerobot.policies.act.modeling_act import ACTPolicy
from lerobot_policy_touch import TouchACTConfig, TouchACTPolicy
from shared import parse
from torch import Tensor, nn
from touch_policy import (
    ACTION_SCALE,
    NUM_DEMONSTRATIONS,
    STEPS,
    Episode,
    Runner,
    demonstrations,
    fit,
    inputs_table,
    read,
    run,
    run_seed,
)

from torch_geometric_tactile.sim import GripperLift

ROWS, RATES = ("ACT", "ACT with touch"), (3e-4, 1e-3)
LEARNING_RATE = 1e-3
NUM_MOTORS, CHUNK = 8, 8  # numbers of the motors; actions that ACT predicts: 0.4 s
SIZES = {
    "dim_model": 128,
    "n_heads": 4,
    "dim_feedforward": 256,
    "n_encoder_layers": 2,
    "use_vae": False,
}


class Policy(nn.Module):
    """A policy of LeRobot in the place of the networks of `touch_policy.py`."""

    def __init__(self, row: str, inputs: Tensor, layout: Path) -> None:
        super().__init__()
        types = {"observation.state": FeatureType.STATE, "observation.tactile": FeatureType.STATE}
        sizes = {
            "observation.state": NUM_MOTORS,
            "observation.tactile": inputs.size(-1) - NUM_MOTORS,
        }
        if row == "ACT":  # which needs a feature beside the state
            types = {**types, "observation.environment_state": FeatureType.ENV}
            sizes = {"observation.state": NUM_MOTORS, "observation.environment_state": NUM_MOTORS}
        options = {
            "input_features": {k: PolicyFeature(types[k], (size,)) for k, size in sizes.items()},
            "output_features": {"action": PolicyFeature(FeatureType.ACTION, (2,))},
            "chunk_size": CHUNK,
            "n_action_steps": 1,
            "device": "cpu",
            **SIZES,
        }
        if row == "ACT":
            self.policy = ACTPolicy(ACTConfig(**options))
        else:
            options |= {"layout": str(layout), "touch_channels": 3, "touch_steps": STEPS}
            self.policy = TouchACTPolicy(TouchACTConfig(**options))
        self.register_buffer("mean", inputs[..., :NUM_MOTORS].mean(dim=(0, 1)))
        self.register_buffer("scale", inputs[..., :NUM_MOTORS].std(dim=(0, 1)) + 1e-6)

    def batch(self, inputs: Tensor) -> dict[str, Tensor]:
        """Returns the batch of LeRobot for inputs (B, STEPS, D)."""
        motors = (inputs[:, -1, :NUM_MOTORS] - self.mean) / self.scale
        batch = {"observation.state": motors, "observation.tactile": inputs[..., NUM_MOTORS:]}
        return {**batch, "observation.environment_state": motors}

    def forward(self, inputs: Tensor) -> Tensor:
        """Returns the scaled actions (B, 2)."""
        return self.policy.predict_action_chunk(self.batch(inputs))[:, 0]


def train(row: str, episodes: list[Episode], seed: int, rate: float, layout: Path) -> nn.Module:
    """Returns a policy that imitates the actions."""
    inputs = inputs_table(row, episodes)
    chunks, padding = [], []
    for _, actions in episodes:
        index = np.arange(len(actions))[:, None] + np.arange(CHUNK)
        padding.append(index >= len(actions))
        chunks.append(actions[index.clip(max=len(actions) - 1)] / ACTION_SCALE)
    actions = torch.from_numpy(np.concatenate(chunks)).float()
    is_pad = torch.from_numpy(np.concatenate(padding))
    torch.manual_seed(seed)
    policy = Policy(row, inputs, layout).train()

    def loss(index: Tensor) -> Tensor:
        batch = {"action": actions[index], "action_is_pad": is_pad[index]}
        return policy.policy({**policy.batch(inputs[index]), **batch})[0]

    return fit(policy, loss, len(inputs), rate)


def main() -> None:
    """Runs what the file does not have yet, and prints the tables."""
    options = {
        "--out": (Path("touch_policies.json"), "file of the runs"),
        "--seeds": (5, "seeds of a row"),
        "--jobs": (2, "runs at once"),
        "--validate": (False, "print the successes of learning rates on validation episodes"),
    }
    arguments = parse(__doc__, options)
    layout = arguments.out.with_name("gripper_pads.json")
    GripperLift().layout.save(layout)
    try:
        if arguments.validate:
            torch.set_num_threads(1)
            for rate in RATES:
                policy = train(ROWS[1], demonstrations(NUM_DEMONSTRATIONS, "good"), 0, rate, layout)
                episodes = Runner(range(400, 450), "good", held_out=False, narrow=False)
                outcomes, _ = episodes.run(ROWS[1], policy)
                print(rate, outcomes.count("success"), "of 50", flush=True)
            return
        done = {(r["row"], r["seed"]) for r in read(arguments.out)}
        tasks = [(row, seed) for seed in range(1, arguments.seeds + 1) for row in ROWS]
        method = functools.partial(train, rate=LEARNING_RATE, layout=layout)
        calls = [delayed(run_seed)("clean", *task, method) for task in tasks if task not in done]
        run(arguments.out, arguments.jobs, calls)
    finally:
        layout.unlink()


if __name__ == "__main__":
    import touch_policy_act  # as a module, whose functions other processes find

    touch_policy_act.main()
