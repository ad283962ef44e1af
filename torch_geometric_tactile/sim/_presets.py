r"""Presets of simulated trials, and the report of a trial."""

from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple


@dataclass(frozen=True)
class Preset:
    r"""Duration, time steps, frame rate and number of simulated trials.

    Args:
        duration (float): Length of a trial in seconds.
        timestep (float): Step of the physics in seconds.
        step (float): Time between targets of the controller in seconds.
        rate (float): Frames recorded per second.
        trials (int): Default number of trials of each object.

    Examples:
        >>> from torch_geometric_tactile.sim import PRESETS
        >>> PRESETS["ci"]
        Preset(duration=5.0, timestep=0.004, step=0.02, rate=50.0, trials=3)
    """

    duration: float
    timestep: float
    step: float
    rate: float
    trials: int


#: Duration, time steps, frame rate and number of trials of :func:`simulate`, by name.
PRESETS = {
    "full": Preset(duration=17.0, timestep=0.002, step=0.01, rate=100.0, trials=10),
    "ci": Preset(duration=5.0, timestep=0.004, step=0.02, rate=50.0, trials=3),
}


class TrialReport(NamedTuple):
    r"""Number of attempts at a simulated trial, and the path of its file.

    :obj:`path` is :obj:`None` if no attempt lifted and held the object, or squeezed it.
    :obj:`kept` is :obj:`True` if the file existed already.

    Examples:
        >>> report = TrialReport("sponge", 0, attempts=2, path=Path("sponge_000.h5"), kept=False)
        >>> report.attempts, report.path.name
        (2, 'sponge_000.h5')
    """

    object_name: str
    trial: int
    attempts: int
    path: Path | None
    kept: bool
