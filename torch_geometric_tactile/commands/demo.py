r"""``tactile demo``: from data to judged models and a report."""

import argparse
import os
import sys

from torch_geometric_tactile.commands.arguments import few, positive

HELP = "train and judge grasp stability models on real grasps, and write a report"
DESCRIPTION = """\
Trains TaxelNet with and without edges, GCN-DF, an LSTM, an SVM and a majority baseline on the
BioTac SP stability set, on readings less the common mode of each finger, scaled by session,
and raw. Judges each with random folds, with objects left out, with objects and a recording
session left out, and on the official test of unseen objects (also by palm pose). Writes
report.html, its pictures, metrics.json and the checkpoint of TaxelNet on the common mode's
readings.
"""
EXAMPLES = """\
examples:
  tactile demo                           downloads the data, or generates some with no network
  tactile demo --root recordings --seeds 1 --epochs 3

Each run (of a model, a protocol, a seed, a fold) is a file in DIR/runs when it is finished:
the same command goes on where it was stopped. The same runs as a plain table: tactile table bts3
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    r"""Adds the arguments of the verb.

    Args:
        parser (argparse.ArgumentParser): The parser of the verb.
    """
    parser.add_argument(
        "--root",
        default=os.environ.get("TACTILE_DATA"),
        help="folder with the six CSV files of the set, or with a folder 'BioTacSP' or 'biotacsp' "
        "that has them; by default $TACTILE_DATA, else they are downloaded, and with no network "
        "the data is generated",
    )
    parser.add_argument(
        "--out", metavar="DIR", default="report", help="folder of the report (default: report)"
    )
    parser.add_argument(
        "--seeds", type=few, default=3, help="trainings of every model (default: 3)"
    )
    parser.add_argument("--folds", type=few, default=5, help="folds, at least 2 (default: 5)")
    parser.add_argument(
        "--epochs", type=positive, help="epochs, instead of the configurations' own"
    )
    parser.add_argument(
        "--jobs",
        type=few,
        default=os.cpu_count() or 1,
        help="processes (default: one for each core)",
    )
    parser.add_argument(
        "--generated", action="store_true", help="use generated data, whatever there is"
    )


def run(arguments: argparse.Namespace) -> int:
    r"""Runs the verb and returns the exit status.

    Args:
        arguments (argparse.Namespace): The arguments.
    """
    import time
    from pathlib import Path

    from torch_geometric_tactile.commands.progress import progress
    from torch_geometric_tactile.experiments.grasp_table import grasp_table
    from torch_geometric_tactile.experiments.plan import Settings, make_plan
    from torch_geometric_tactile.experiments.run import run_experiment
    from torch_geometric_tactile.experiments.run_plan import Workers, run_plan
    from torch_geometric_tactile.reports import grasp
    from torch_geometric_tactile.texts import printable
    from torch_geometric_tactile.visualization.figure import new_figure

    new_figure(1.0, 1.0)  # tells before a long run whether its pictures can be drawn
    start = time.perf_counter()
    settings = Settings(seeds=arguments.seeds, epochs=arguments.epochs, folds=arguments.folds)
    table = grasp_table(arguments.root, arguments.generated)
    print(printable(table.data.caption), flush=True)
    plan = make_plan(table, settings)
    out = Path(arguments.out)
    with progress("Train and judge", "model") as show:
        finished = run_plan(plan, out, Workers(arguments.jobs), on_progress=show)
    if finished.failed:
        for name, reason in finished.failed.items():
            print(printable(f"tactile: error: {name}: {reason}"), file=sys.stderr)
        return 1
    main = next(
        e for e in plan.experiments if (e.name, e.protocol.by, e.seed) == (grasp.MAIN, "given", 0)
    )
    result = run_experiment(main, checkpoint=out / grasp.CHECKPOINT)
    report = grasp.write_grasp_report(finished, result, out, time.perf_counter() - start)
    seconds = report.content["seconds"]
    print(f"\n{report.text}\n\nReport: {printable(out / 'report.html')} ({seconds:.0f} s)")
    return 0
