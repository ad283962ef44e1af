r"""The experiments of a table: on many processes, finished ones kept, and the table at the end."""

import os
from collections.abc import Callable, Container, Generator, Iterable, Sequence
from contextlib import closing
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

from torch_geometric_tactile.experiments.experiment import Experiment
from torch_geometric_tactile.experiments.recordings import Recordings, describe_recordings
from torch_geometric_tactile.experiments.run_store import RunStore
from torch_geometric_tactile.experiments.tables import PublishedTable, load_table
from torch_geometric_tactile.experiments.worker import close_process, run_in_process
from torch_geometric_tactile.parallel import Backend, check_backend, run_parallel
from torch_geometric_tactile.training.config import expand_template
from torch_geometric_tactile.typing import PathLike

SPLITS = ("trial", "frame")
ACCELERATORS = ("cpu", "gpu")


@dataclass(frozen=True)
class Settings:
    r"""How the experiments of a table are run.

    Args:
        seeds (int): Runs of each experiment, with the seeds 0, 1, ... of split and training.
        epochs (int, optional): Epochs, instead of those of the configurations.
        stride (int): Only every :obj:`stride`-th frame of each trial.
        phases (sequence of str, optional): Only frames in these phases of the grasp.
        split_by (sequence of str): :obj:`"trial"`, :obj:`"frame"` or both.
        accelerator (str): :obj:`"cpu"` or :obj:`"gpu"`.
        threads (int): Threads of each run.

    Raises:
        ValueError: If a number is below one, or a name is unknown.
    """

    seeds: int = 5
    epochs: int | None = None
    stride: int = 1
    phases: Sequence[str] | None = None
    split_by: Sequence[str] = SPLITS
    accelerator: str = "cpu"
    threads: int = 1

    def __post_init__(self) -> None:
        numbers = {"seeds": self.seeds, "stride": self.stride, "threads": self.threads}
        if self.epochs is not None:
            numbers["epochs"] = self.epochs
        for name, number in numbers.items():
            if number < 1:
                raise ValueError(f"'{name}' must be at least 1 (got {number})")
        if not self.split_by or not set(self.split_by) <= set(SPLITS):
            raise ValueError(
                f"'split_by' must be some of {list(SPLITS)} (got {list(self.split_by)})"
            )
        if self.accelerator not in ACCELERATORS:
            raise ValueError(
                f"'accelerator' must be one of {list(ACCELERATORS)} (got '{self.accelerator}')"
            )


class TableRun(NamedTuple):
    r"""What became of a table: its finished experiments and their results, how many of them were
    :obj:`kept` from before, what :obj:`failed` and why, and how many are :obj:`missing`.
    """

    table: PublishedTable
    settings: Settings
    recordings: Recordings
    results: list[tuple[Experiment, dict[str, Any]]]
    kept: int
    failed: dict[str, str]
    missing: int

    def describe(self) -> str:
        r"""Returns what became of it in one line."""
        total = len(self.results) + self.missing
        kept = f" ({self.kept} kept from before)" if self.kept else ""
        missing = f", {self.missing} missing" if self.missing else ""
        return f"{self.table.name}: {len(self.results)} of {total} runs finished{kept}{missing}"


def list_experiments(
    table: PublishedTable, recordings: Recordings, settings: Settings
) -> list[Experiment]:
    r"""Returns all experiments of a table, the first seed of all models first, so that a run that
    is stopped has something of every model.

    Args:
        table (PublishedTable): The table.
        recordings (Recordings): The data.
        settings (Settings): How they are run.
    """
    configs = expand_template(table.template)
    return [
        Experiment(
            name=cell.experiment,
            config=configs[cell.experiment],
            root=recordings.root,
            data=recordings.fingerprint,
            seed=seed,
            split_by=split_by,
            epochs=settings.epochs or configs[cell.experiment]["trainer"]["max_epochs"],
            stride=settings.stride,
            phases=None if settings.phases is None else tuple(settings.phases),
            accelerator=settings.accelerator,
            threads=settings.threads,
        )
        for seed in range(settings.seeds)
        for split_by in dict.fromkeys(settings.split_by)
        for cell in table.cells
    ]


def run_table(
    name: str,
    root: PathLike | None = None,
    out: PathLike = "tables",
    settings: Settings | None = None,
    only: Sequence[str] | None = None,
    jobs: int = 1,
    backend: Backend = "loky",
    scheduler: str | None = None,
    train: bool = True,
    on_progress: Callable[[Experiment, int, int], None] | None = None,
) -> TableRun:
    r"""Trains and tests the models of a table, each seed in a process of its own.

    A finished run is a JSON file in :obj:`out/runs`, whole or absent, and is not run again: a run
    that was stopped or killed goes on where it was. Runs with other settings, recordings or
    versions have other files in the same folder and do not get into the table.

    Args:
        name (str): Name of the table, such as :obj:`"p1-table2"`.
        root (str or PathLike, optional): Folder of the recordings, as of
            :class:`~torch_geometric_tactile.datasets.AllegroUSkin`.
        out (str or PathLike): Folder of the results.
        settings (Settings, optional): How the experiments are run.
        only (sequence of str, optional): Train only experiments with names like these patterns.
        jobs (int): How many runs at a time.
        backend (str): :obj:`"loky"`, :obj:`"dask"` or :obj:`"ray"`.
        scheduler (str, optional): Address of a running cluster of Dask or Ray. Its machines must
            have this package, and the recordings under the same path.
        train (bool): Whether to train what is missing; otherwise the table is of what is there.
        on_progress (callable, optional): Called with each run that ended, how many ended so far,
            and how many are to be run.

    Raises:
        FileNotFoundError: If there are no recordings.
        ImportError: If the package of the backend is missing.
        KeyboardInterrupt: On Ctrl-C; the message tells how many runs are kept.
        ValueError: If an argument is wrong, or a file of a finished run is damaged.
    """
    settings = settings or Settings()
    table = load_table(name)
    chosen = {cell.experiment for cell in table.select(only)}
    if jobs < 1:
        raise ValueError(f"'jobs' must be at least 1 (got {jobs})")
    check_backend(backend, scheduler)
    first = expand_template(table.template)[table.cells[0].experiment]
    arguments = {
        "task": first["data"]["dataset"]["init_args"]["task"],
        "fractions": first["data"]["dataset"]["init_args"]["fractions"],
        "stride": settings.stride,
        "phases": settings.phases,
    }
    recordings = describe_recordings(root, arguments, settings.split_by)
    if recordings.num_classes > first["model"]["num_classes"]:
        raise ValueError(
            f"the models of {name} tell {first['model']['num_classes']} objects apart (got "
            f"{recordings.num_classes} in '{recordings.root}')"
        )
    experiments = list_experiments(table, recordings, settings)
    store = RunStore(Path(out) / "runs")
    # Two names may stand for one configuration, which is trained once.
    different = {experiment.code: experiment for experiment in experiments}
    found = {code: store.read(experiment) for code, experiment in different.items()}
    results = {code: result for code, result in found.items() if result is not None}
    kept = set(results)
    wanted = {experiment.code for experiment in experiments if experiment.name in chosen and train}
    todo = [different[code] for code in different if code in wanted - kept]
    failed: dict[str, str] = {}
    try:
        with closing(_run(todo, jobs, backend, scheduler)) as running:
            for ended, (experiment, result) in enumerate(running, 1):
                if "error" in result:
                    failed[experiment.label] = result["error"]
                else:
                    store.write(experiment, result)
                    results[experiment.code] = result
                if on_progress is not None:
                    on_progress(experiment, ended, len(todo))
    except KeyboardInterrupt:
        raise KeyboardInterrupt(
            f"stopped; {_count(experiments, results)} of {len(experiments)} runs are finished and "
            "kept: the same command goes on, and with --no-train it writes the table of those"
        ) from None
    finally:
        store.clean(todo)
    return TableRun(
        table,
        settings,
        recordings,
        results=[(e, results[e.code]) for e in experiments if e.code in results],
        kept=_count(experiments, kept),
        failed=failed,
        missing=len(experiments) - _count(experiments, results),
    )


def _count(experiments: Iterable[Experiment], codes: Container[str]) -> int:
    return sum(experiment.code in codes for experiment in experiments)


def _run(
    todo: Sequence[Experiment], jobs: int, backend: Backend, scheduler: str | None
) -> Generator[tuple[Experiment, dict[str, Any]], None, None]:
    if not todo:
        return
    # On this machine a worker looks whether this process is there; a cluster sees to that itself.
    work = partial(_numbered, parent=os.getpid() if backend == "loky" else None)
    items = list(enumerate(todo))
    try:
        with closing(run_parallel(work, items, jobs, backend, scheduler)) as running:
            for number, result in running:
                yield todo[number], result
    finally:
        close_process()  # with one job it is ours


def _numbered(item: tuple[int, Experiment], parent: int | None) -> tuple[int, dict[str, Any]]:
    number, experiment = item
    return number, run_in_process(experiment, parent)
