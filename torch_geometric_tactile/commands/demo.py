r"""``tactile demo``: from data to judged models and a report."""

import argparse
import os

from torch_geometric_tactile.commands._arguments import positive, small_count
from torch_geometric_tactile.commands._runs import exit_status, options_named, run_with_bar

HELP = "Train and compare grasp stability models on real grasps, and write a report"
EXTRAS = "train,viz"
DESCRIPTION = """\
Trains TaxelNet with and without edges, GCN-DF, an LSTM, an SVM and a majority baseline on
the BioTac SP grasp stability set, with three preprocessings: common mode removed, scaled
by session, and raw. Tests each with random folds, with unseen objects, with unseen objects
of an unseen session, and on the official test set of unseen objects. Writes report.html
with figures, metrics.json and a checkpoint of TaxelNet. Needs the extras 'train' and 'viz'.
"""
EXAMPLES = """\
examples:
  tactile demo                                   real data; generated data without a network
  tactile demo --generated --seeds 1 --folds 2 --epochs 1
                                                 a quick check of an installation
  tactile demo --root recordings --seeds 1 --epochs 3

Each finished run (a model, a protocol, a seed, a fold) is a file in DIR/runs: the same
command resumes an interrupted one. The same runs as a table: tactile table bts3
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    r"""Adds the arguments of the verb."""
    parser.add_argument(
        "--root",
        metavar="DIR",
        default=os.environ.get("TACTILE_DATA"),
        help="folder with the six CSV files of the data set, or its parent folder (default: "
        "$TACTILE_DATA, else a download; without a network, generated data)",
    )
    parser.add_argument(
        "--out", metavar="DIR", default="report", help="folder for the report (default: report)"
    )
    parser.add_argument(
        "--seeds", metavar="N", type=small_count, default=3, help="seeds per model (default: 3)"
    )
    parser.add_argument(
        "--folds",
        metavar="N",
        type=small_count,
        default=5,
        help="number of folds, at least 2 (default: 5)",
    )
    parser.add_argument(
        "--epochs", metavar="N", type=positive, help="epochs (default: the configurations')"
    )
    parser.add_argument(
        "--jobs",
        metavar="N",
        type=small_count,
        default=os.cpu_count() or 1,
        help="runs in parallel (default: one per core)",
    )
    parser.add_argument(
        "--generated", action="store_true", help="use generated data even if the real data is there"
    )


def run(arguments: argparse.Namespace) -> int:
    r"""Runs the verb and returns the exit status."""
    with options_named(arguments):
        return _run(arguments)


def _run(arguments: argparse.Namespace) -> int:
    import time
    from pathlib import Path

    from torch_geometric_tactile._texts import printable
    from torch_geometric_tactile.experiments._run_experiment import run_experiment
    from torch_geometric_tactile.experiments.plan import Settings, make_plan
    from torch_geometric_tactile.papers import _grasp_report as grasp
    from torch_geometric_tactile.papers._grasp_table import grasp_table
    from torch_geometric_tactile.visualization._style import new_figure

    new_figure(1.0, 1.0)  # a missing matplotlib is an error before the long run
    start = time.perf_counter()
    settings = Settings(seeds=arguments.seeds, epochs=arguments.epochs, folds=arguments.folds)
    table = grasp_table(arguments.root, arguments.generated)
    print(printable(table.data.caption), flush=True)
    plan = make_plan(table, settings)
    out = Path(arguments.out)
    finished = run_with_bar(plan, arguments.out, arguments.jobs, "Train and judge", "model")
    if finished.failed:
        return exit_status(finished)
    main = next(
        e for e in plan.experiments if (e.name, e.protocol.by, e.seed) == (grasp.MAIN, "given", 0)
    )
    result = run_experiment(main, checkpoint=out / grasp.CHECKPOINT)
    report = grasp.write_grasp_report(finished, result, out, time.perf_counter() - start)
    seconds = report.content["seconds"]
    print(f"\n{report.text}\n\nReport: {printable(out / 'report.html')} ({seconds:.0f} s)")
    return 0
