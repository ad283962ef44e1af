r"""Runs simulated trials on several processes, with one file per trial. If the file of a trial
exists, the trial is not simulated again.
"""

import json
from abc import ABC, abstractmethod
from collections.abc import Callable, Generator, Mapping, Sequence
from contextlib import closing
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Generic, TypeVar

from torch_geometric_tactile._checks import need
from torch_geometric_tactile._files import atomic_path, remove_leftovers
from torch_geometric_tactile._parallel import run_parallel
from torch_geometric_tactile.io.recording_hdf5 import read_hdf5_head

SUMMARY = "simulation.json"


_Report = TypeVar("_Report")


class SimulatedTrial(ABC, Generic[_Report]):
    r"""A trial to simulate: the arguments that determine its recording, and its file."""

    @property
    @abstractmethod
    def path(self) -> Path:
        r"""The path of the file of the trial."""

    @abstractmethod
    def simulate(self) -> _Report:
        r"""Simulates the trial, writes its file and returns the report."""

    @abstractmethod
    def finished_report(self) -> _Report:
        r"""Returns the report of a trial whose file exists."""

    def is_finished(self) -> bool:
        r"""Returns whether the file exists."""
        return self.path.exists()


def check_run(seed: int, **counts: int) -> None:
    r"""Checks that the seed is not negative and that all counts are positive."""
    for name, number in counts.items():
        need(number >= 1, f"'{name}' must be at least 1", number)
    need(seed >= 0, "'seed' must not be negative", seed)


def require_simulator(feature: str) -> None:
    r"""Checks that MuJoCo and h5py are installed.

    Args:
        feature (str): The feature that needs them. The message names it.

    Raises:
        ImportError: If a package is missing. The message contains the command that installs it.
    """
    for package in ("mujoco", "h5py"):
        if find_spec(package) is None:
            raise ImportError(
                f"{feature} needs {package}: pip install 'torch-geometric-tactile[sim]'"
            )


def run_trials(
    trials: Sequence[SimulatedTrial[_Report]],
    out: Path,
    jobs: int,
    summarize: Callable[[list[_Report]], dict[str, Any]] | None = None,
) -> Generator[_Report, None, None]:
    r"""Simulates the trials whose files are missing and yields the report of each trial. Reports of
    trials with existing files come first.

    Args:
        trials (sequence of SimulatedTrial): The trials.
        out (pathlib.Path): Folder of the files.
        jobs (int): Number of processes.
        summarize (callable, optional): Returns the content of :obj:`simulation.json`, which is
            written at the end.
    """
    out.mkdir(parents=True, exist_ok=True)
    reports, missing = [], []
    for trial in trials:
        if trial.is_finished():
            reports.append(trial.finished_report())
            yield reports[-1]
        else:
            missing.append(trial)
    try:
        with closing(run_parallel(_simulate, missing, jobs)) as new_reports:
            for report in new_reports:
                reports.append(report)
                yield report
    finally:
        # Killed workers of this or an earlier run leave incomplete temporary files.
        for trial in trials:
            remove_leftovers(trial.path)
    if summarize is not None:
        write_summary(out, summarize(reports))


def _simulate(trial: SimulatedTrial[_Report]) -> _Report:
    return trial.simulate()


def finished_metadata(
    path: Path, identity: Mapping[str, Any], defaults: Mapping[str, Any] | None = None
) -> dict[str, Any]:
    r"""Returns the metadata of a finished trial.

    Args:
        path (pathlib.Path): File of the trial.
        identity (dict): The arguments that determine the recording, as metadata.
        defaults (dict, optional): Arguments that files of earlier versions do not contain.

    Raises:
        ValueError: If the file was written with other arguments.
    """
    meta = {**(defaults or {}), **read_hdf5_head(path).meta}
    for key, expected in identity.items():
        if meta.get(key) != expected:
            raise ValueError(
                f"'{path}' was written with another '{key}' ({meta.get(key)}, not {expected}); "
                "choose another folder or delete the file"
            )
    return meta


def write_summary(out: Path, content: Mapping[str, Any]) -> None:
    r"""Writes the description of a run to :obj:`simulation.json`."""
    with atomic_path(out / SUMMARY) as temporary:
        temporary.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
