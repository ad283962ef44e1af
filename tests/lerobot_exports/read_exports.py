"""Reads exported touch with LeRobot, and asks its policies whether they read it.

Runs where LeRobot is installed, without this package (0.4.4 and 0.6.1 were tried):

    python read_exports.py make FOLDER     makes the data set of a robot with a camera
    python write_exports.py FOLDER         adds touch to it, where this package is installed
    python read_exports.py read FOLDER     prints a report; the exit status is 1 if it is unexpected
"""

import sys
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import torch
from lerobot.configs.policies import PreTrainedConfig
from lerobot.datasets.factory import resolve_delta_timestamps
from lerobot.datasets.lerobot_dataset import LeRobotDataset
from lerobot.policies.act.configuration_act import ACTConfig
from lerobot.policies.diffusion.configuration_diffusion import DiffusionConfig
from lerobot.policies.factory import make_policy, make_pre_post_processors

FPS, STEPS, JOINTS = 10, 20, 3
ENVIRONMENT, STATE = "observation.environment_state", "observation.state"
# Of each data set: the feature of the readings, the first reading in it, and whether ACT reads it.
SETS = {
    "tactile": ("observation.tactile", 0, False),
    "skin": ("observation.skin", 0, False),
    "environment": (ENVIRONMENT, 0, True),
    "state": (STATE, JOINTS, True),
    "touch_only": (ENVIRONMENT, 0, True),
    "nan": (ENVIRONMENT, 0, True),
}


def make(folder: Path) -> None:
    """Makes a data set with LeRobot: joint angles, actions and images, no touch."""
    names = ["shoulder", "elbow", "gripper"]
    features = {
        STATE: {"dtype": "float32", "shape": (JOINTS,), "names": names},
        "action": {"dtype": "float32", "shape": (2,), "names": ["squeeze", "lift"]},
        "observation.images.front": {
            "dtype": "image",
            "shape": (64, 64, 3),
            "names": ["height", "width", "channels"],
        },
    }
    dataset = LeRobotDataset.create(
        "touch/arm", FPS, features, root=folder / "arm", use_videos=False
    )
    draw = np.random.default_rng(1)
    for task in ("mug", "box"):
        for _ in range(STEPS):
            dataset.add_frame(
                {
                    STATE: draw.normal(size=JOINTS).astype(np.float32),
                    "action": draw.normal(size=2).astype(np.float32),
                    "observation.images.front": draw.integers(0, 256, (64, 64, 3), dtype=np.uint8),
                    "task": task,
                }
            )
        dataset.save_episode()
    if hasattr(dataset, "finalize"):
        dataset.finalize()
    print(f"made {len(dataset)} frames in {folder / 'arm'}")


def act_config() -> PreTrainedConfig:
    """A small ACT."""
    return ACTConfig(
        device="cpu",
        chunk_size=4,
        n_action_steps=4,
        dim_model=32,
        n_heads=2,
        dim_feedforward=64,
        n_encoder_layers=1,
        n_vae_encoder_layers=1,
        pretrained_backbone_weights=None,
        push_to_hub=False,
    )


def diffusion_config() -> PreTrainedConfig:
    """A small diffusion policy."""
    return DiffusionConfig(
        device="cpu",
        n_obs_steps=2,
        horizon=8,
        n_action_steps=4,
        down_dims=(16, 32),
        num_train_timesteps=10,
        crop_shape=None,
        push_to_hub=False,
    )


def difference(root: Path, key: str, first: int, config: PreTrainedConfig) -> tuple[float, float]:
    """The loss of a new policy on a batch, and the change of its action (of its loss, for
    diffusion) with 1,000 added to the readings.
    """
    name = f"touch/{root.name}"
    meta = LeRobotDataset(name, root=root).meta
    torch.manual_seed(0)
    policy = make_policy(config, ds_meta=meta)
    stamps = resolve_delta_timestamps(config, meta)
    dataset = LeRobotDataset(name, root=root, delta_timestamps=stamps)
    batch = next(iter(torch.utils.data.DataLoader(dataset, batch_size=8, shuffle=False)))
    prepare, _ = make_pre_post_processors(config, dataset_stats=meta.stats)
    more = dict(batch)
    more[key] = batch[key].clone()
    more[key][..., first:] += 1000
    batch, more = prepare(batch), prepare(more)
    torch.manual_seed(0)
    loss = float(policy.train()(batch)[0].detach())

    @torch.no_grad()
    def answer(inputs: dict[str, Any]) -> torch.Tensor:
        torch.manual_seed(0)
        policy.eval()
        if isinstance(config, ACTConfig):
            inputs = {k: v for k, v in inputs.items() if k != "action"}
            return policy.predict_action_chunk(inputs)
        return policy(inputs)[0]

    return loss, float((answer(more) - answer(batch)).abs().max())


def read(folder: Path) -> bool:
    """Prints a line for each data set and policy, and returns whether all are as expected."""
    print(
        f"lerobot {version('lerobot')}, torch {torch.__version__}, Python {sys.version.split()[0]}"
    )
    is_expected = True
    for name, (key, first, is_read) in SETS.items():
        dataset = LeRobotDataset(f"touch/{name}", root=folder / name)
        frame = dataset[7]
        touch = frame[key][first:]
        print(
            f"\n{name}: {len(dataset)} frames, {key} {tuple(frame[key].shape)}, of these "
            f"{len(touch)} readings, action {tuple(frame['action'].shape)}, "
            f"{int(torch.isnan(touch).sum())} NaN in a frame"
        )
        is_expected &= len(dataset) == 2 * STEPS or name == "touch_only"
        for config in (act_config(), diffusion_config()):
            if isinstance(config, DiffusionConfig) and find_spec("diffusers") is None:
                print("  diffusion  was not asked: diffusers is not installed")
                continue
            loss, change = difference(folder / name, key, first, config)
            if name == "nan":  # the change is NaN as well
                is_right = np.isnan(loss)
            else:
                is_right = np.isfinite(loss) and (change > 0) == is_read
            is_expected &= is_right
            print(
                f"  {config.type:<10} loss {loss:.4f}, change by 1,000 in the readings "
                f"{change:.4g}{'' if is_right else '   UNEXPECTED'}"
            )
    print("\nas expected" if is_expected else "\nUNEXPECTED")
    return is_expected


if __name__ == "__main__":
    command, path = sys.argv[1], Path(sys.argv[2])
    if command == "make":
        make(path)
    else:
        sys.exit(0 if read(path) else 1)
