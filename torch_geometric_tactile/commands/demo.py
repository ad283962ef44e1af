r"""``tactile demo``: compares models on real grasps with four kinds of test data, in a report."""

import argparse
import os

from torch_geometric_tactile.commands._arguments import positive, small_count
from torch_geometric_tactile.commands._file_kinds import PICTURE, text_kind
from torch_geometric_tactile.commands._paths import (
    OutputFolder,
    OutputPath,
    files_in_folder,
    input_path,
)
from torch_geometric_tactile.commands._runs import (
    option_names_in_errors,
    report_failures,
    run_with_bar,
)

HELP = "Compare models on real grasps with four kinds of test data, and write a report"
EXTRAS = "train,viz"
DESCRIPTION = """\
Runs 'tactile compare' on the BioTac SP grasp stability set, with raw readings and with readings
whose common mode is subtracted. There are four kinds of test grasps: random grasps, new objects, a
new recording session, and the official test with new objects in new sessions. Writes report.html
with a table, pictures and a conclusion, and comparisons.json. Needs the extras 'train' and 'viz'.
"""
EXAMPLES = """\
examples:
  tactile demo                                   real data; without internet access, generated data
  tactile demo --generated --folds 2 --epochs 1 --jobs 1
                                                 a quick check of an installation
  tactile demo --root recordings --seeds 3 --epochs 24

Each finished run (a model on a split) is a file in DIR/runs: the same command resumes an
interrupted demo. 'tactile compare' does the same with your data.
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    r"""Adds the arguments of the command to a parser."""
    parser.add_argument(
        "--root",
        metavar="DIR",
        type=input_path,
        default=os.environ.get("TACTILE_DATA"),
        help="folder with the six CSV files of the data set, or its parent folder (default: "
        "$TACTILE_DATA, else a download; without internet access, generated data)",
    )
    parser.add_argument(
        "--out",
        metavar="DIR",
        type=OutputFolder("--out"),
        default="report",
        help="folder for the report (default: report)",
    )
    parser.add_argument(
        "--seeds",
        metavar="N",
        type=small_count,
        default=1,
        help="random draws of the folds (default: 1)",
    )
    parser.add_argument(
        "--folds",
        metavar="N",
        type=small_count,
        default=3,
        help="number of folds, and of training runs for the official test, at least 2 (default: 3)",
    )
    parser.add_argument(
        "--epochs",
        metavar="N",
        type=positive,
        default=5,
        help="epochs per network (default: 5, for speed; 'tactile compare' trains 24 on this data)",
    )
    parser.add_argument(
        "--jobs",
        metavar="N",
        type=small_count,
        default=os.cpu_count() or 1,
        help="runs in parallel (default: one per core)",
    )
    parser.add_argument(
        "--generated", action="store_true", help="use generated data even if real data is available"
    )


def list_outputs(arguments: argparse.Namespace) -> list[OutputPath]:
    r"""Returns the files that the command writes."""
    title = "Will it slip\\? Grasp stability from touch"
    kinds = {
        "report.html": text_kind("a report of 'tactile demo'", f"(?s)<!DOCTYPE html>.*{title}"),
        "comparisons.json": text_kind("the results of 'tactile demo'", r'\[\s*\{\s*"readings": '),
        **{f"{name}.png": PICTURE for name in ("protocols", "grasps", "confusion")},
    }
    return files_in_folder(arguments.out, kinds)


def run(arguments: argparse.Namespace) -> int:
    r"""Runs the command and returns the exit status."""
    with option_names_in_errors(arguments):
        return _run(arguments)


def _run(arguments: argparse.Namespace) -> int:
    from tabulate import tabulate

    from torch_geometric_tactile._texts import printable
    from torch_geometric_tactile.experiments._demo import (
        COMMON_MODE,
        OFFICIAL_TEST,
        demo_data,
        demo_plans,
    )
    from torch_geometric_tactile.experiments.advice import advice
    from torch_geometric_tactile.experiments.comparison import Comparison, summarize
    from torch_geometric_tactile.reports._demo import demo_conclusion, demo_rows, write_demo
    from torch_geometric_tactile.visualization._style import new_figure

    new_figure(1.0, 1.0)  # a missing matplotlib must fail before the long run
    source = demo_data(arguments.root, arguments.generated)
    print(printable(source.caption), flush=True)
    comparisons: dict[str, dict[str, Comparison]] = {}
    for readings, held_out, plan in demo_plans(
        source, arguments.folds, arguments.seeds, arguments.epochs
    ):
        title = f"{readings}: {held_out}"
        plan_run = run_with_bar(plan, arguments.out, arguments.jobs, title)
        if plan_run.failed:
            return report_failures(plan_run)
        comparisons.setdefault(readings, {})[held_out] = summarize(plan_run)
    paths = write_demo(comparisons, arguments.out)
    header, rows = demo_rows(comparisons)
    print(f"\nAccuracy in %\n{tabulate(rows, header, disable_numparse=True)}\n")
    verdict = advice(comparisons[COMMON_MODE][OFFICIAL_TEST])
    has_recommendation = any(row[0].startswith("*") for row in rows)
    texts = [
        f"* recommended on the {OFFICIAL_TEST}" if has_recommendation else "",
        demo_conclusion(comparisons),
        f"Verdict of 'tactile compare' on the {OFFICIAL_TEST}: {verdict}",
    ]
    print(*map(printable, filter(None, texts)), sep="\n\n", end="\n\n")
    for path in paths:
        print(printable(f"wrote {path}"))
    return 0
