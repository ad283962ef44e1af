r"""``tactile board``: compares all models on all real data sets."""

import argparse
from functools import partial
from typing import TYPE_CHECKING

from torch_geometric_tactile.commands._arguments import positive
from torch_geometric_tactile.commands._file_kinds import text_kind
from torch_geometric_tactile.commands._paths import (
    OutputFolder,
    OutputPath,
    files_in_folder,
    input_path,
)
from torch_geometric_tactile.commands._runs import (
    add_workers,
    describe_plan,
    option_names_in_errors,
    print_line,
    run_with_bar,
)

if TYPE_CHECKING:
    from torch_geometric_tactile.experiments.plan import Plan

HELP = "Compare all models on all real data sets"
EXTRAS = "train"
DESCRIPTION = """\
Runs 'tactile compare' with the default models on each real data set, with one fixed protocol per
data set. Writes the accuracy and the rank of each model to DIR/board.md and board.json. --own adds
your own model. The comparison takes hours on two cores. Finished runs are kept: the same command
resumes an interrupted one. Missing data sets are downloaded where possible and skipped otherwise.
"""
EXAMPLES = """\
examples:
  tactile board --data DIR --jobs 2               DIR has one folder per data set: DIR/BioTacSP
  tactile board --data DIR --own my_nets.MyNet    the same, with your own model
  tactile board --sets digits,mat --epochs 3      a first look at two data sets
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    r"""Adds the arguments of the command to a parser."""
    parser.add_argument(
        "--data",
        metavar="DIR",
        type=input_path,
        help="folder with one folder per data set, named like its class (default: $TACTILE_DATA, "
        "or the user's cache)",
    )
    parser.add_argument(
        "--out",
        metavar="DIR",
        type=OutputFolder("--out"),
        default="board",
        help="folder for the results (default: board)",
    )
    parser.add_argument(
        "--own",
        metavar="PATH",
        type=str,
        action="append",
        default=[],
        help="import path of your own model, as in 'tactile compare'; may be repeated",
    )
    parser.add_argument(
        "--sets",
        metavar="NAME,NAME",
        type=str,
        help="data sets to compare on (default: all)",
    )
    parser.add_argument(
        "--epochs", metavar="N", type=positive, help="epochs per network (default: 15 to 60)"
    )
    parser.add_argument(
        "--no-train", action="store_true", help="train nothing; write the finished runs"
    )
    add_workers(parser)


def list_outputs(arguments: argparse.Namespace) -> list[OutputPath]:
    r"""Returns the files that the command writes."""
    kinds = {
        "board.md": text_kind("a page of 'tactile board'", "# The board\n"),
        "board.json": text_kind("the numbers of 'tactile board'", r'\{\s*"accuracy": \{'),
    }
    return files_in_folder(arguments.out, kinds)


def run(arguments: argparse.Namespace) -> int:
    r"""Runs the command and returns the exit status."""
    with option_names_in_errors(arguments, names="--sets", models="--own"):
        return _run(arguments)


def _run(arguments: argparse.Namespace) -> int:
    from tabulate import tabulate

    from torch_geometric_tactile._texts import printable
    from torch_geometric_tactile.commands._runs import report_failures
    from torch_geometric_tactile.experiments._board import BoardColumn, board_plans
    from torch_geometric_tactile.experiments.comparison import summarize
    from torch_geometric_tactile.reports._board import board_rows, write_board

    columns, status, seconds = [], 0, 0.0
    for board_set, plans in board_plans(
        arguments.data,
        arguments.own,
        None if arguments.sets is None else arguments.sets.split(","),
        epochs=arguments.epochs,
        accelerator=arguments.accelerator,
        threads=arguments.threads,
    ):
        runs = [
            run_with_bar(
                plan,
                arguments.out,
                arguments.jobs,
                board_set.name,
                train=not arguments.no_train,
                on_estimate=partial(_print_plan, board_set.name, plan, arguments.jobs),
            )
            for plan in plans
        ]
        status = max(status, *map(report_failures, runs))
        column = BoardColumn(board_set, [summarize(run) for run in runs])
        seconds += sum(
            result["choose_seconds"] + result["train_seconds"] + result["predict_seconds"]
            for run in runs
            for _, result in run.results
        )
        if not column.results:
            continue
        columns.append(column)
        best = next(iter(column.results))
        print(printable(f"{board_set.name}: {len(column.results)} models, the best is {best}"))
    if not columns:
        raise FileNotFoundError("no data set of the board has results: see the messages above")
    header, rows = board_rows(columns)
    print(tabulate(rows, header, disable_numparse=True), end="\n\n")
    for path in write_board(columns, arguments.out, _describe_machine(), seconds / 3600):
        print(printable(f"wrote {path}"))
    return status


def _print_plan(name: str, plan: "Plan", jobs: int | None, seconds: dict[str, float]) -> None:
    print_line(f"{name}: {describe_plan(plan, jobs, seconds)}")


def _describe_machine() -> str:
    import os
    import platform

    return f"{platform.system()} {platform.machine()}, {os.cpu_count()} CPUs"
