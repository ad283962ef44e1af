"""LeRobot data sets of others."""

from collections.abc import Sequence
from pathlib import Path

import pytest

from torch_geometric_tactile.data import Recording
from torch_geometric_tactile.io import _lerobot_steps as lerobot_steps
from torch_geometric_tactile.io import write_lerobot


def write_without_touch(recordings: Sequence[Recording], root: Path, fps: int) -> None:
    """Writes a data set whose readings have another name, without our file."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(lerobot_steps, "TACTILE", "observation.other")
        write_lerobot(recordings, root, fps=fps, task="pick")
    (Path(root) / "meta/tactile.json").unlink()
