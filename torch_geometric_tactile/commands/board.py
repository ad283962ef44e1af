r"""``tactile board``: all models on all real data sets."""

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
    intention,
    options_named,
    run_with_bar,
    tell,
)

if TYPE_CHECKING:
    from torch_geometric_tactile.experiments.plan import Plan

HELP = "Compare all models on all real data sets"
EXTRAS = "train"
DESCRIPTION = """\
Runs 'tactile compare' with the default models on each real data set, by one fixed protocol for
each, and writes DIR/board.md and board.json: accuracy, and the place of each model. With --own, a
model of yours is compared as well. It takes hours on two cores; finished runs are kept, and the
same command goes on. A data set whose files are missing is left out, or downloaded where it can be.
"""
EXAMPLES = """\
examples:
  tactile board --data DIR --jobs 2               DIR has a folder for each data set: DIR/BioTacSP
  tactile board --data DIR --own my_nets.MyNet    and a model of your own, which finds its place
  tactile board --sets digits,mat --epochs 3      a first look at two of them
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    r"""Adds the arguments of the verb."""
    parser.add_argument(
        "--data",
        metavar="DIR",
        type=input_path,
        help="folder with a folder for each data set, named like its class (default: "
        "$TACTILE_DATA, or the user's cache)",
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
        help="import path of a model of your own, as in 'tactile compare'; may be repeated",
    )
    parser.add_argument(
        "--sets",
        metavar="NAME,NAME",
        type=str,
        help="some of the data sets (default: all)",
    )
    parser.add_argument(
        "--epochs", metavar="N", type=positive, help="epochs per network (default: 15 to 60)"
    )
    parser.add_argument(
        "--no-train", action="store_true", help="train nothing; write the finished runs"
    )
    add_workers(parser)


def list_outputs(arguments: argparse.Namespace) -> list[OutputPath]:
    r"""Returns the files that are written."""
    kinds = {
        "board.md": text_kind("a page of 'tactile board'", "# The board\n"),
        "board.json": text_kind("the numbers of 'tactile board'", r'\{\s*"accuracy": \{'),
    }
    return files_in_folder(arguments.out, kinds)


def run(arguments: argparse.Namespace) -> int:
    r"""Runs the verb and returns the exit status."""
    with options_named(arguments, names="--sets", models="--own"):
        return _run(arguments)


def _run(arguments: argparse.Namespace) -> int:
    from tabulate import tabulate

    from torch_geometric_tactile._texts import printable
    from torch_geometric_tactile.commands._runs import exit_status
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
                on_estimate=partial(_tell_time, board_set.name, plan, arguments.jobs),
            )
            for plan in plans
        ]
        status = max(status, *map(exit_status, runs))
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
        raise FileNotFoundError("no data set of the board has a result: see the lines above")
    header, rows = board_rows(columns)
    print(tabulate(rows, header, disable_numparse=True), end="\n\n")
    for path in write_board(columns, arguments.out, _machine(), seconds / 3600):
        print(printable(f"wrote {path}"))
    return status


def _tell_time(name: str, plan: "Plan", jobs: int | None, seconds: dict[str, float]) -> None:
    tell(f"{name}: {intention(plan, jobs, seconds)}")


def _machine() -> str:
    import os
    import platform

    return f"{platform.system()} {platform.machine()}, {os.cpu_count()} CPUs"
