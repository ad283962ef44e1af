r"""Many simulated trials, each in a file of its own, on many processes; finished ones are kept."""

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
from torch_geometric_tactile.io import read_hdf5_head

SUMMARY = "simulation.json"


_Report = TypeVar("_Report")


class SimulatedTrial(ABC, Generic[_Report]):
    r"""A trial to simulate: all that decides its bits, and its file."""

    @property
    @abstractmethod
    def path(self) -> Path:
        r"""The file."""

    @abstractmethod
    def simulate(self) -> _Report:
        r"""Simulates the trial, writes its file and returns the report."""

    @abstractmethod
    def kept(self) -> _Report:
        r"""Returns the report of a trial whose file is there."""

    def is_finished(self) -> bool:
        r"""Tells whether the file is there."""
        return self.path.exists()


def check_run(seed: int, **counts: int) -> None:
    r"""Checks the seed and the numbers of a run."""
    for name, number in counts.items():
        need(number >= 1, f"'{name}' must be at least 1", number)
    need(seed >= 0, "'seed' must not be negative", seed)


def require_simulator(what: str) -> None:
    r"""Raises an :obj:`ImportError` that names the extra if MuJoCo or h5py is missing."""
    for package in ("mujoco", "h5py"):
        if find_spec(package) is None:
            raise ImportError(f"{what} needs {package}: pip install 'torch-geometric-tactile[sim]'")


def run_trials(
    trials: Sequence[SimulatedTrial[_Report]],
    out: Path,
    jobs: int,
    sum_up: Callable[[list[_Report]], dict[str, Any]] | None = None,
) -> Generator[_Report, None, None]:
    r"""Yields the report of each trial, those of files that are there first, and writes what they
    sum up to.
    """
    out.mkdir(parents=True, exist_ok=True)
    reports, missing = [], []
    for trial in trials:
        if trial.is_finished():
            reports.append(trial.kept())
            yield reports[-1]
        else:
            missing.append(trial)
    try:
        with closing(run_parallel(_simulate, missing, jobs)) as results:
            for report in results:
                reports.append(report)
                yield report
    finally:
        # What workers that were killed, now or in an earlier run, had begun to write.
        for trial in trials:
            remove_leftovers(trial.path)
    if sum_up is not None:
        write_summary(out, sum_up(reports))


def _simulate(trial: SimulatedTrial[_Report]) -> _Report:
    return trial.simulate()


def kept_meta(
    path: Path, identity: Mapping[str, Any], before: Mapping[str, Any] | None = None
) -> dict[str, Any]:
    r"""Returns the metadata of a finished trial, which hold what decides its bits."""
    meta = {**(before or {}), **read_hdf5_head(path).meta}
    for key, wanted in identity.items():
        if meta.get(key) != wanted:
            raise ValueError(
                f"'{path}' was made with another '{key}' ({meta.get(key)}, not {wanted}); "
                "choose another folder or delete the file"
            )
    return meta


def write_summary(out: Path, content: Mapping[str, Any]) -> None:
    r"""Writes what a run did to :obj:`simulation.json`."""
    with atomic_path(out / SUMMARY) as temporary:
        temporary.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
