"""Writes touch for the policies of LeRobot, in the environment of this package.

``read_exports.py make FOLDER`` makes the data set of a robot first, and ``read_exports.py read
FOLDER`` reads what is written here; both run where LeRobot is installed.
"""

import sys
from pathlib import Path

import numpy as np

from torch_geometric_tactile.data import Recording
from torch_geometric_tactile.io import add_to_lerobot, read_lerobot, write_lerobot

FPS, RATE, STEPS = 10, 100, 20
KEYS = {
    "tactile": "observation.tactile",
    "environment": "observation.environment_state",
    "state": "observation.state",
    "skin": "observation.skin",
}


def demonstrations() -> list[Recording]:
    """Two demonstrations with touch, joint angles and actions; a dead taxel and lost readings."""
    draw = np.random.default_rng(0)
    frames = STEPS * RATE // FPS
    recordings = []
    for label in ("mug", "box"):
        tactile = draw.normal(size=(frames, 16, 3)).astype(np.float32)
        tactile[:, 5] = np.nan
        tactile[40:60, 2] = np.nan
        recordings.append(
            Recording(
                np.arange(frames) / RATE,
                tactile,
                joint=draw.uniform(-1, 1, size=(frames, 3)),
                label=label,
                meta={"unit": "newton", "action_names": ["squeeze", "lift"]},
                action=draw.normal(size=(frames, 2)),
            )
        )
    return recordings


def write(folder: Path) -> None:
    """Writes each data set, and compares what is read from it."""
    recordings = demonstrations()
    for name, key in KEYS.items():
        add_to_lerobot(folder / "arm", recordings, folder / name, key=key, fill=0.0)
    key = KEYS["environment"]
    add_to_lerobot(folder / "arm", recordings, folder / "nan", key=key)
    # No camera: a demonstration of touch, joint angles and actions.
    write_lerobot(
        recordings, folder / "touch_only", FPS, key=key, fill=0.0, every_frame=True, task="lift"
    )
    for name in (*KEYS, "nan", "touch_only"):
        found = read_lerobot(folder / name)
        for one, recording in zip(found, recordings, strict=True):
            frames = np.arange(one.num_frames) * (RATE // FPS)
            # With all frames, the last step comes after the last frame.
            expected = recording.tactile[np.minimum(frames, recording.num_frames - 1)]
            expected = expected if name == "nan" else np.nan_to_num(expected)
            assert np.array_equal(one.tactile, expected, equal_nan=True), name
            assert one.num_joints == 3, name
            assert one.num_actions == 2, name
        print(f"{name}: {found[0]}")


if __name__ == "__main__":
    write(Path(sys.argv[1]))
