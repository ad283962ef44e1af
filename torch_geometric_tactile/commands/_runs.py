r"""What verbs that run experiments share: options, how errors name them, and a progress bar."""

import argparse
import sys
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from torch_geometric_tactile._checks import ArgumentError
from torch_geometric_tactile.commands._arguments import positive, small_count

if TYPE_CHECKING:
    from torch_geometric_tactile.experiments._experiment import Experiment
    from torch_geometric_tactile.experiments.plan import Plan, PlanRun


@contextmanager
def options_named(
    arguments: argparse.Namespace, unnamed: Collection[str] = (), **more: str
) -> Iterator[None]:
    r"""Names the options of a command in the messages of errors about the arguments of Python
    functions that they become. All else in a message stays as it is, and so do the names that are
    :obj:`unnamed`, such as those of the arguments of a data set.
    """
    options = {name: f"--{name.replace('_', '-')}" for name in vars(arguments)} | more
    options = {name: option for name, option in options.items() if name not in unnamed}
    try:
        yield
    except ArgumentError as error:
        raise ValueError(error.renamed(options)) from error


def add_rest(group: Any) -> None:
    r"""Adds the option for frames at rest."""
    group.add_argument(
        "--rest",
        metavar="N",
        type=positive,
        help="subtract the mean of the first N frames of each trial, which are at rest",
    )


def add_workers(parser: argparse.ArgumentParser) -> None:
    r"""Adds the options for processes and threads."""
    workers = parser.add_argument_group("processes")
    workers.add_argument(
        "--jobs", metavar="N", type=small_count, help="runs in parallel (default: 1)"
    )
    workers.add_argument(
        "--threads", metavar="N", type=small_count, default=1, help="threads per run (default: 1)"
    )
    workers.add_argument(
        "--accelerator",
        choices=("cpu", "gpu"),
        default="cpu",
        help="where to train (default: cpu); jobs take turns on a GPU",
    )


def run_with_bar(
    plan: "Plan", out: str, jobs: int | None, title: str, unit: str = "run", **options: Any
) -> "PlanRun":
    r"""Runs a plan below a progress bar. There is none without a terminal, and none stays after
    Ctrl-C.
    """
    from tqdm import tqdm

    from torch_geometric_tactile.experiments.run_plan import run_plan

    with tqdm(desc=title, unit=unit, disable=None, leave=False) as bar:

        def show(experiment: "Experiment", ended: int, all_runs: int) -> None:
            bar.total = all_runs
            bar.set_postfix_str(experiment.label, refresh=False)
            bar.update(ended - bar.n)

        return run_plan(plan, out, jobs, on_progress=show, **options)


def exit_status(run: "PlanRun") -> int:
    r"""Tells which runs failed and why, and returns the status that the verb ends with."""
    from torch_geometric_tactile._texts import printable

    for name, reason in run.failed.items():
        print(printable(f"tactile: error: {name}: {reason}"), file=sys.stderr)
    return 1 if run.failed else 0


def intention(plan: "Plan", jobs: int | None, seconds: dict[str, float]) -> str:
    r"""Returns in words what is run, and about how long each model takes, given the seconds."""
    from joblib import effective_n_jobs

    (protocol,) = plan.protocols
    facts, num_jobs = plan.facts, effective_n_jobs(jobs)
    models = [cell.experiment for cell in plan.table.cells]
    num_runs = len({(e.seed, e.fold) for e in plan.experiments})
    runs = "seed" if protocol.protocol.by == "given" else "split"
    runs += "s" * (num_runs > 1)
    text = (
        f"{facts.num_samples:,} samples"
        + (f" of {facts.num_frames} frames" if facts.num_frames else "")
        + (f", {facts.num_trials:,} trials" if facts.num_trials else "")
        + facts.part_note
        + f"; {protocol.protocol.describe()}; {len(models)} models x {num_runs} {runs}"
    )
    if not seconds:
        return f"{text}; all runs are finished"
    longest = sorted(seconds, key=lambda name: seconds[name], reverse=True)[:3]
    parts = ", ".join(f"{name} {_duration(seconds[name] / num_jobs)}" for name in longest)
    whole = _duration(sum(seconds.values()) / num_jobs)
    return f"{text}; about {whole} ({parts}); Ctrl-C keeps finished runs"


def _duration(seconds: float) -> str:
    for unit, length in (("h", 3600), ("min", 60)):
        if seconds >= 2 * length:
            return f"{seconds / length:.0f} {unit}"
    return f"{max(1, round(seconds))} s"


def tell(text: str, as_json: bool = False) -> None:
    r"""Prints a line apart from a progress bar, beside JSON to the stream of errors."""
    from tqdm import tqdm  # which keeps a line apart from a progress bar

    file = sys.stderr if as_json else sys.stdout
    tqdm.write(text, file=file)
    file.flush()
