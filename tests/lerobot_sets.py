"""LeRobot data sets of others."""

from collections.abc import Sequence
from pathlib import Path

from torch_geometric_tactile.data import Recording
from torch_geometric_tactile.io import write_lerobot


def write_without_touch(recordings: Sequence[Recording], root: Path, fps: int) -> None:
    """Writes a data set whose readings have another name, without our file."""
    write_lerobot(recordings, root, fps=fps, task="pick", key="observation.other")
    (Path(root) / "meta/tactile.json").unlink()
