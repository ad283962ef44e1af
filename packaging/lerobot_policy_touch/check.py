"""Shows in an environment with LeRobot what its policies read of touch, and that they train on it.

    python check.py FOLDER

Writes data sets of random demonstrations with torch_geometric_tactile, in which the actions are
readings of single taxels, trains ACT and the policy of this package on them for a few steps by
lerobot-train, loads the checkpoints, and prints one line for each fact. Exits with 1 if one does
not hold.
"""

import importlib.metadata
import os
import re
import subprocess
import sys
from math import isfinite
from pathlib import Path
from typing import Any

os.environ.setdefault("HF_HUB_OFFLINE", "1")

import numpy as np
import torch
from lerobot.configs.policies import PreTrainedConfig
from lerobot.configs.types import FeatureType, PolicyFeature
from lerobot.datasets.lerobot_dataset import LeRobotDataset
from lerobot.policies.act.configuration_act import ACTConfig
from lerobot.policies.act.modeling_act import ACTPolicy
from lerobot.policies.factory import get_policy_class, make_pre_post_processors
from lerobot.utils.import_utils import register_third_party_plugins
from torch.utils.data import default_collate

from torch_geometric_tactile.data import Recording
from torch_geometric_tactile.io import write_lerobot
from torch_geometric_tactile.sensors import stock_layout

LAYOUT, NUM_TAXELS, CHANNELS, FPS, STEPS = "biotac", 19, 3, 20, 20
SMALL = (
    *("--policy.chunk_size=8", "--policy.n_action_steps=1", "--policy.dim_model=64"),
    *("--policy.n_heads=4", "--policy.dim_feedforward=128", "--policy.use_vae=false"),
    *("--policy.device=cpu", "--policy.push_to_hub=false", "--wandb.enable=false"),
    *(
        "--batch_size=8",
        f"--steps={STEPS}",
        f"--save_freq={STEPS}",
        "--log_freq=5",
        "--num_workers=0",
    ),
)
ENVIRONMENT = "observation.environment_state"
failures: list[str] = []


def report(fact: str, holds: bool) -> None:
    """Prints a fact, and whether it holds."""
    print(f"{'yes' if holds else 'NO '}  {fact}", flush=True)
    if not holds:
        failures.append(fact)


def demonstrations(num_episodes: int = 6, num_actions: int = 2) -> list[Recording]:
    """Returns recordings at 100 frames per second whose actions are readings."""
    draw = np.random.default_rng(0)
    recordings = []
    for _ in range(num_episodes):
        touch = draw.normal(size=(200, NUM_TAXELS, CHANNELS)).cumsum(axis=0) / 10
        action = touch[:, :num_actions, 0].copy()
        touch[::17, 5] = np.nan  # a taxel that fails now and then
        joint = draw.normal(size=(200, 2)) / 10
        recordings.append(
            Recording(np.arange(200) / 100, touch, joint=joint, action=action, label="lift")
        )
    return recordings


def train(root: Path, out: Path, *options: str) -> tuple[Path, float]:
    """Trains by lerobot-train, and returns the folder of the checkpoint and the last loss."""
    command = [str(Path(sys.executable).with_name("lerobot-train"))]
    command += [f"--dataset.repo_id=local/{root.name}", f"--dataset.root={root}", *SMALL, *options]
    done = subprocess.run(
        [*command, f"--output_dir={out}"], capture_output=True, text=True, timeout=600
    )
    if done.returncode:
        raise RuntimeError(done.stderr[-2000:])
    losses = re.findall(r"[ _]loss:([\w.]+)", done.stdout + done.stderr)
    return out / "checkpoints" / "last" / "pretrained_model", float(losses[-1])


def load(folder: Path) -> tuple[Any, Any]:
    """Returns the policy of a checkpoint, as lerobot loads it, and its pre-processor."""
    config = PreTrainedConfig.from_pretrained(folder)
    policy = get_policy_class(config.type).from_pretrained(folder, config=config)
    preprocess, _ = make_pre_post_processors(config, pretrained_path=str(folder))
    return policy.eval(), preprocess


def observations(dataset: LeRobotDataset, start: int, length: int) -> list[dict[str, Any]]:
    """Returns the observations of steps, as a robot gives them: without a batch dimension."""
    names = [name for name in dataset.features if name.startswith("observation.")]
    return [{name: dataset[start + i][name] for name in names} for i in range(length)]


def last_action(policy: Any, preprocess: Any, steps: list[dict[str, Any]]) -> torch.Tensor:
    """Returns the action after the last of some steps, taken one by one."""
    policy.reset()
    for step in steps:
        action = policy.select_action(preprocess(dict(step)))
    return action


def moved(step: dict[str, Any], key: str) -> dict[str, Any]:
    """Returns an observation whose touch is larger by 1,000."""
    return {**step, key: step[key] + 1000}


def action_moves(policy: Any, preprocess: Any, steps: list[dict[str, Any]], key: str) -> float:
    """Returns the largest change of the action when all readings grow by 1,000."""
    before = last_action(policy, preprocess, steps)
    after = last_action(policy, preprocess, [moved(step, key) for step in steps])
    return float((after - before).abs().max())


def check_act_ignores_touch() -> None:
    """Compares the actions of ACT on touch beside the features that it reads."""
    sizes = {"observation.tactile": NUM_TAXELS * CHANNELS, "observation.state": 2, ENVIRONMENT: 2}
    types = {ENVIRONMENT: FeatureType.ENV}  # LeRobot gives all other observations that of a state
    features = {
        name: PolicyFeature(types.get(name, FeatureType.STATE), (size,))
        for name, size in sizes.items()
    }
    action = PolicyFeature(FeatureType.ACTION, (2,))
    config = ACTConfig(input_features=features, output_features={"action": action}, device="cpu")
    policy = ACTPolicy(config).eval()
    step = {name: torch.randn(1, size) for name, size in sizes.items()}
    change = policy.predict_action_chunk(step) - policy.predict_action_chunk(
        moved(step, "observation.tactile")
    )
    report("ACT: the action ignores 'observation.tactile'", not change.any())


def check_act(folder: Path) -> None:
    """Trains ACT on touch as the state of the environment."""
    root = folder / "act"
    write_lerobot(demonstrations(), root, FPS, fill=0.0, key=ENVIRONMENT)
    checkpoint, _ = train(root, folder / "train_act", "--policy.type=act")
    policy, preprocess = load(checkpoint)
    steps = observations(LeRobotDataset("local/act", root=root), 0, 1)
    change = action_moves(policy, preprocess, steps, ENVIRONMENT)
    report(f"ACT: the action moves with touch as '{ENVIRONMENT}' (by {change:.3g})", change > 0)


def check_touch_act(folder: Path, **options: Any) -> None:
    """Trains the policy of this package, and compares streams with windows."""
    key = "observation.tactile_frames" if options.get("every_frame") else "observation.tactile"
    root = folder / key.rpartition(".")[2]
    write_lerobot(demonstrations(), root, FPS, **options)
    checkpoint, loss = train(
        root,
        folder / f"train_{root.name}",
        *("--policy.type=touch_act", f"--policy.layout={LAYOUT}", f"--policy.touch_key={key}"),
        f"--policy.touch_channels={CHANNELS}",
    )
    report(f"touch_act, '{key}': {STEPS} steps of lerobot-train (loss {loss})", isfinite(loss))
    policy, preprocess = load(checkpoint)
    offsets = [offset / FPS for offset in policy.config.observation_delta_indices]
    names = list(policy.config.input_features)
    windows = LeRobotDataset(
        f"local/{root.name}", root=root, delta_timestamps=dict.fromkeys(names, offsets)
    )
    steps = observations(LeRobotDataset(f"local/{root.name}", root=root), 0, 12)
    change = action_moves(policy, preprocess, steps, key)
    report(f"touch_act, '{key}': the action moves with touch (by {change:.3g})", change > 0)
    differences = []
    for end in (0, 3, 11):
        batch = preprocess(default_collate([windows[end]]))
        window = policy.predict_action_chunk(batch)[:, 0]
        stream = last_action(policy, preprocess, steps[: end + 1])
        differences.append(float((window - stream).abs().max()))
    largest = max(differences)
    report(
        f"touch_act, '{key}': a stream gives the actions of windows (within {largest:.1g})",
        largest < 1e-5,
    )


def check_layout_file(folder: Path) -> None:
    """Trains with a layout file on actions of one number, and loads without the file."""
    root, layout = folder / "one_action", folder / "layout.json"
    write_lerobot(demonstrations(num_actions=1), root, FPS)
    stock_layout(LAYOUT).save(layout)
    options = ("--policy.type=touch_act", f"--policy.layout={layout}")
    checkpoint, loss = train(root, folder / "train_one_action", *options)
    report(f"touch_act: trains on actions of one number (loss {loss})", isfinite(loss))
    layout.unlink()
    policy, preprocess = load(checkpoint)
    steps = observations(LeRobotDataset("local/one_action", root=root), 0, 1)
    action = last_action(policy, preprocess, steps)
    report("touch_act: a checkpoint needs no layout file", action.shape == (1, 1))


def main(folder: Path) -> int:
    """Runs all checks in a folder, and returns the exit status."""
    folder.mkdir(parents=True)
    versions = [f"{name} {importlib.metadata.version(name)}" for name in ("lerobot", "torch")]
    print(f"{', '.join(versions)}, Python {sys.version.split()[0]}")
    register_third_party_plugins()
    check_act_ignores_touch()
    check_act(folder)
    check_touch_act(folder)
    check_touch_act(folder, every_frame=True)
    check_layout_file(folder)
    return bool(failures)


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    sys.exit(main(Path(sys.argv[1]).resolve()))
