r"""What the experiments of a table are trained on."""

import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from torch_geometric_tactile.datasets import AllegroUSkin
from torch_geometric_tactile.files import file_sha256
from torch_geometric_tactile.typing import PathLike

_SIMULATION = "simulation.json"


@dataclass(frozen=True)
class Recordings:
    r"""Facts about a folder of recordings.

    Args:
        root (str): The folder.
        fingerprint (str): A code of the content of its files, wherever they lie.
        synthetic (bool): Whether a simulator made any of them.
        num_trials (int): Number of trials.
        num_frames (int): Number of frames in the chosen phases and with the chosen stride.
        num_classes (int): Number of objects or properties.
        simulation (dict, optional): What the simulator says of them.
    """

    root: str
    fingerprint: str
    synthetic: bool
    num_trials: int
    num_frames: int
    num_classes: int
    simulation: dict[str, Any] | None = None

    @property
    def source(self) -> str:
        r"""What the numbers are labelled with, in one word."""
        return "simulated" if self.synthetic else "measured"

    def describe(self) -> str:
        r"""Returns where the recordings come from, as a sentence."""
        if not self.synthetic:
            return f"Recordings of your own: {self.num_trials} trials."
        said = f"**Simulated**, never a real hand's result: {self.num_trials} trials"
        if self.simulation is None:
            return f"{said}."
        preset = self.simulation.get("preset", {})
        return (
            f"{said} of `tactile simulate` (objects `{self.simulation.get('object_set')}`, seed "
            f"{self.simulation.get('seed')}, {preset.get('duration'):g} s at "
            f"{preset.get('rate'):g} Hz, MuJoCo {self.simulation.get('mujoco')})."
        )


def describe_recordings(
    root: PathLike | None, arguments: dict[str, Any], split_by: Sequence[str] = ("trial",)
) -> Recordings:
    r"""Looks at a folder of recordings; processes them, if that was not done before, so that many
    processes can read them at once.

    Args:
        root (str or PathLike, optional): The folder.
        arguments (dict): Of :class:`~torch_geometric_tactile.datasets.AllegroUSkin`, which of the
            frames are used and how they are split.
        split_by (sequence of str): The splits that are wanted.

    Raises:
        FileNotFoundError: If there are no recordings; the message says how to get some.
        ValueError: If they cannot be read, or cannot be split so.
    """
    whole = AllegroUSkin(root, **{**arguments, "split": None})
    for by in split_by:
        for part in ("train", "test"):
            AllegroUSkin(root, **{**arguments, "split": part, "split_by": by})
    files = [Path(name) for name in whole.raw_paths] or [Path(whole.processed_paths[0])]
    code = hashlib.sha256()
    for file in files:
        code.update(f"{file.name} {file_sha256(file)}\n".encode())
    beside = [Path(whole.root) / _SIMULATION, Path(whole.raw_dir) / _SIMULATION]
    found = [path for path in beside if path.is_file()]
    return Recordings(
        root=str(Path(whole.root).resolve()),
        fingerprint=code.hexdigest(),
        synthetic=whole.synthetic,
        num_trials=len(whole.trial_names),
        num_frames=len(whole),
        num_classes=whole.num_classes,
        simulation=json.loads(found[0].read_text(encoding="utf-8")) if found else None,
    )
