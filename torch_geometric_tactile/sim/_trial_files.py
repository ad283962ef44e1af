r"""Many simulated trials, each in a file of its own, on many processes; finished ones are kept."""

import json
import os
import time
from collections.abc import Callable, Generator, Mapping, Sequence
from contextlib import closing
from functools import cache, partial
from importlib.util import find_spec
from pathlib import Path
from threading import Thread
from typing import Any, Protocol, TypeVar

from torch_geometric_tactile._files import atomic_path, remove_leftovers
from torch_geometric_tactile._parallel import run_parallel
from torch_geometric_tactile.io import read_hdf5_head

SUMMARY = "simulation.json"


class FileTask(Protocol):
    r"""What makes a file."""

    @property
    def path(self) -> Path:
        r"""The file."""


class TrialTask(FileTask, Protocol):
    r"""A trial to simulate: all that decides its bits, and its file."""

    def identity(self) -> dict[str, Any]:
        r"""What decides the bits, as JSON values; the metadata of the file holds them too."""


_Task = TypeVar("_Task", bound=FileTask)
_Report = TypeVar("_Report")


def require_simulator(what: str) -> None:
    r"""Raises an :obj:`ImportError` that names the extra if MuJoCo or h5py is missing."""
    for package in ("mujoco", "h5py"):
        if find_spec(package) is None:
            raise ImportError(f"{what} needs {package}: pip install 'torch-geometric-tactile[sim]'")


def _is_there(task: FileTask) -> bool:
    return task.path.exists()


def run_trials(
    tasks: Sequence[_Task],
    out: Path,
    jobs: int,
    kept: Callable[[_Task], _Report],
    simulate: Callable[..., _Report],
    finished: Callable[[_Task], bool] = _is_there,
) -> Generator[_Report, None, list[_Report]]:
    r"""Yields the report of each trial, those of files that are there first, and returns all."""
    out.mkdir(parents=True, exist_ok=True)
    reports, missing = [], []
    for task in tasks:
        if finished(task):
            reports.append(kept(task))
            yield reports[-1]
        else:
            missing.append(task)
    try:
        work = partial(simulate, parent=os.getpid())
        with closing(run_parallel(work, missing, jobs)) as results:
            for report in results:
                reports.append(report)
                yield report
    finally:
        # What workers that were killed, now or in an earlier run, had begun to write.
        for task in tasks:
            remove_leftovers(task.path)
    return reports


def end_without(parent: int) -> None:
    r"""Ends a worker whose run was killed: it would go on with what was dispatched."""
    if parent not in (os.getpid(), os.getppid()):
        os._exit(1)
    if parent != os.getpid():
        _end_with(parent)


@cache
def _end_with(parent: int) -> None:
    # Once a worker: one that has nothing to do would wait for minutes.
    Thread(target=_wait_for_end, args=(parent,), daemon=True).start()


def _wait_for_end(parent: int) -> None:
    while os.getppid() == parent:
        time.sleep(1.0)
    os._exit(1)


def kept_meta(task: TrialTask, before: Mapping[str, Any] | None = None) -> dict[str, Any]:
    r"""Returns the metadata of a finished trial."""
    meta = {**(before or {}), **read_hdf5_head(task.path).meta}
    for key, wanted in task.identity().items():
        if meta.get(key) != wanted:
            raise ValueError(
                f"'{task.path}' was made with another '{key}' ({meta.get(key)}, not {wanted}); "
                "choose another folder or delete the file"
            )
    return meta


def write_summary(out: Path, content: Mapping[str, Any]) -> None:
    r"""Writes what a run did to :obj:`simulation.json`."""
    with atomic_path(out / SUMMARY) as temporary:
        temporary.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
