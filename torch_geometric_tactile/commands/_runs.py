r"""Shared parts of the commands that run experiments: options, their names in error messages, a
progress bar and printed summaries.
"""

import argparse
import sys
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from torch_geometric_tactile._checks import ArgumentError, GroupedError
from torch_geometric_tactile.commands._arguments import positive, small_count

if TYPE_CHECKING:
    from torch_geometric_tactile.experiments._experiment import Experiment
    from torch_geometric_tactile.experiments.plan import Plan, PlanRun


@contextmanager
def option_names_in_errors(
    arguments: argparse.Namespace, excluded: Collection[str] = (), **renamed: str
) -> Iterator[None]:
    r"""Replaces names of Python arguments by names of options in error messages.

    Args:
        arguments (argparse.Namespace): The options, each named like its Python argument.
        excluded (collection of str): Names to keep, such as names of data set arguments.
        **renamed (str): Names of options that differ from the names of the Python arguments.

    Raises:
        ValueError: The error about an argument, with its option named in the message.
    """
    options = _option_names(arguments) | renamed
    options = {name: option for name, option in options.items() if name not in excluded}
    try:
        yield
    except ArgumentError as error:
        raise ValueError(error.renamed(options)) from error
    except GroupedError as error:
        raise error.renamed(options) from error


def option_text(error: Exception, arguments: argparse.Namespace) -> str:
    r"""Returns the message of an error with option names in place of Python argument names."""
    if isinstance(error, ArgumentError):
        return error.renamed(_option_names(arguments))
    return str(error)


def _option_names(arguments: argparse.Namespace) -> dict[str, str]:
    return {name: f"--{name.replace('_', '-')}" for name in vars(arguments)}


def add_rest(group: Any) -> None:
    r"""Adds the option for the number of frames at rest."""
    group.add_argument(
        "--rest",
        metavar="N",
        type=positive,
        help="subtract the mean of the first N frames of each trial, in which nothing touches the "
        "sensor",
    )


def add_workers(parser: argparse.ArgumentParser) -> None:
    r"""Adds the options for processes, threads and the accelerator."""
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
        help="device to train on (default: cpu); parallel runs take turns on a GPU",
    )


def run_with_bar(
    plan: "Plan", out: str, jobs: int | None, title: str, unit: str = "run", **options: Any
) -> "PlanRun":
    r"""Runs a plan and shows a progress bar if there is a terminal. Ctrl-C removes the bar."""
    from tqdm import tqdm

    from torch_geometric_tactile.experiments.run_plan import run_plan

    with tqdm(desc=title, unit=unit, disable=None, leave=False) as bar:

        def update_bar(experiment: "Experiment", num_ended: int, num_runs: int) -> None:
            bar.total = num_runs
            bar.set_postfix_str(experiment.label, refresh=False)
            bar.update(num_ended - bar.n)

        return run_plan(plan, out, jobs, on_progress=update_bar, **options)


def report_failures(run: "PlanRun") -> int:
    r"""Prints an error for each failed run, and returns the exit status of the command."""
    from torch_geometric_tactile._texts import printable

    for name, reason in run.failed.items():
        print(printable(f"tactile: error: {name}: {reason}"), file=sys.stderr)
    return 1 if run.failed else 0


def describe_plan(plan: "Plan", jobs: int | None, seconds: dict[str, float]) -> str:
    r"""Returns a line with the samples, the protocol and the models of a plan, and the estimated
    time of its runs.

    Args:
        plan (Plan): A plan of one protocol.
        jobs (int, optional): Number of runs in parallel.
        seconds (dict): Estimated computing time in seconds by name of the model; empty if all runs
            are finished.
    """
    from joblib import effective_n_jobs

    (protocol,) = plan.protocols
    facts, num_jobs = plan.facts, effective_n_jobs(jobs)
    models = [cell.experiment for cell in plan.table.cells]
    num_runs = len({(e.seed, e.fold) for e in plan.experiments})
    unit = "seed" if protocol.protocol.by == "given" else "split"
    unit += "s" * (num_runs > 1)
    text = (
        f"{facts.num_samples:,} samples"
        + (f" of {facts.num_frames} frames" if facts.num_frames else "")
        + (f", {facts.num_trials:,} trials" if facts.num_trials else "")
        + facts.part_note
        + f"; {protocol.protocol.describe()}; {len(models)} models x {num_runs} {unit}"
    )
    if not seconds:
        return f"{text}; all runs are finished"
    # Parallel runs share the computing time about equally.
    longest = sorted(seconds, key=lambda name: seconds[name], reverse=True)[:3]
    parts = ", ".join(f"{name} {_format_duration(seconds[name] / num_jobs)}" for name in longest)
    total = _format_duration(sum(seconds.values()) / num_jobs)
    return f"{text}; about {total} ({parts}); Ctrl-C keeps finished runs"


def _format_duration(seconds: float) -> str:
    for unit, length in (("h", 3600), ("min", 60)):
        if seconds >= 2 * length:
            return f"{seconds / length:.0f} {unit}"
    return f"{max(1, round(seconds))} s"


def print_line(text: str, as_json: bool = False) -> None:
    r"""Prints a line above the progress bar, to standard error if standard output holds JSON."""
    from tqdm import tqdm

    file = sys.stderr if as_json else sys.stdout
    tqdm.write(text, file=file)
    file.flush()
