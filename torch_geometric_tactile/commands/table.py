r"""``tactile table``: reproduces a table of a paper, beside its published numbers."""

import argparse
import glob
import re
from pathlib import Path
from typing import TYPE_CHECKING

from torch_geometric_tactile.commands._arguments import positive, rest, small_count
from torch_geometric_tactile.commands._file_kinds import PICTURE, text_kind
from torch_geometric_tactile.commands._paths import (
    InputPath,
    OutputFolder,
    OutputPath,
    files_in_folder,
    input_path,
)
from torch_geometric_tactile.commands._runs import (
    add_workers,
    option_names_in_errors,
    report_failures,
    run_with_bar,
)

if TYPE_CHECKING:
    from torch_geometric_tactile.experiments.tables import Cell, Table

# Repeats the names in `papers`, which is too slow to import for the help.
TABLES = (
    *("p1-table2", "p1-scaling", "p1-table3", "p2-table2", "p2-scaling", "p2-table4"),
    *("p2-picks", "p2-icub"),
    *("p3", "p3-k", "p3-picks", "p4"),
    *("p5", "p5-digits", "p5-mnist", "p5-arrays", "bts3", "sparsh-p1", "sparsh-p2"),
)
_TABLE_DEFAULT = object()  # option absent: the setting of the table applies
_HEADERS = {
    "accuracy": "accuracy (%)",
    "spread": "±",
    "variance": "variance (%²)",
    "auc": "ROC",
    "memory": "memory (MB)",
}

HELP = "Reproduce a table of a paper, beside its published numbers"
EXTRAS = "train,viz"
DESCRIPTION = """\
Trains and tests all models of a table and writes DIR/NAME.md, NAME.csv and NAME.png with the
published numbers beside ours, NAME-runs.csv with each run, and NAME-orderings.csv with the
difference of each pair of models whose order the paper claims. P1 and P2 use recordings of an
Allegro hand with 384 taxels, P3 grasps of three fingers with 19 electrodes each, P4 an Allegro hand
with 240 taxels that squeezes objects, and P5 letters pressed on an array. Needs the extras 'train'
and 'viz', and 'baselines' for P5.

tables:
  p1-table2   object properties: 36 GCNs, CNNs and FNNs, with and without joint angles
  p1-scaling  the same, with edge features and positions in metres, as in the paper, or scaled
  p1-table3   object properties: the best of these on four adjacency graphs
  p2-table2   objects: 18 GCNs by segmentation of the hand (with their AUC, Table III)
  p2-scaling  the same, with positions in metres, as in the paper, or scaled
  p2-table4   training memory of these 18
  p2-picks    P2 without segments and with one segment per finger, and edge features, on public
              picks with two fingers (USkinPick, which you fetch yourself)
  p2-icub     the first two on public grasps of a hand with five fingertips (ICubGrasp, which you
              fetch yourself)
  p3          grasp stability over time: SVM, LSTM, GCN on one or three fingers, and our models
  p3-k        the GCNs of three fingers by number of neighbours in the graph
  p3-picks    the models of p3 on public picks by a gripper with two fingers (USkinPick, which you
              fetch yourself)
  p4          twenty objects: seven patterns of the MS-CNN, with one or three force components and
              shared or separate filters, an FNN and our models
  p5          letters pressed on an array: CNN, BMF-CNN, fused layers, SIFT, SURF and our models
  p5-digits   the same on real images: the handwritten digits of scikit-learn
  p5-mnist    the same on MNIST, 70,000 images, which is downloaded
  p5-arrays   letters on arrays of any layout, such as hexagonal or thinned: graph models and CNNs
  bts3        grasp stability on real grasps, by what is held out
  sparsh-p1   P1's 36 models on public recordings of a real hand with 368 taxels, by object
              (Sparsh-skin, which you fetch yourself; without its files, an error explains how)
  sparsh-p2   P2's 18 models on the same
  FILE.yaml   your own table, for any data set (see docs/experiments.md)
"""
EXAMPLES = """\
examples:
  tactile simulate --out sim --jobs 2                    simulates recordings, if you have none
  tactile table p2-table2 --list                         the experiments and the published numbers
  tactile table p2-table2 --root sim --stride 200 --epochs 1 --seeds 1
                                                         a first look, in minutes
  tactile table p1-table2 --root sim --stride 20 --epochs 30 --jobs 2
  tactile table p1-table2 --root sim --stride 20 --epochs 30 --only '*gcn_te*'
                                                         trains only these models; earlier
                                                         runs of other models stay in the table
  tactile table p1-table2 --root mine --tare 0.5         your recordings: the first half second
                                                         of each trial is at rest
  tactile simulate --objects bigs --out bigs --jobs 2    simulates grasps for P3
  tactile table p3 --root bigs --seeds 1 --protocols random
                                                         the paper's protocol, once
  tactile simulate --objects twenty --motion squeeze --trials 30 --spread wide --seconds 10 \\
    --preset ci --max-attempts 40 --out twenty --jobs 2  simulates squeezes for P4
  tactile table p4 --root twenty --seeds 1 --epochs 20   a first look at all seven patterns
  tactile simulate --objects letters --presses 100 --out letters --jobs 2
  tactile table p5 --root letters --epochs 20 --protocols press --jobs 2
                                                         tests on unseen presses
  tactile table sparsh-p1 --root sparsh --jobs 2         the published recordings, by episode

Each finished run (a model, a seed, a protocol) is a file in DIR/runs: the same command resumes
an interrupted table, and tables with the same DIR share their runs. Nothing is selected on the
test part: the number of epochs is fixed, and each model is tested once, at the end.
To train a single model: tactile fit --config p1_table2/mt_gcn_te_joint
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    r"""Adds the arguments of the command to a parser."""
    parser.add_argument(
        "name",
        metavar="TABLE",
        type=_table_name,
        help=f"{', '.join(TABLES)}, or your own .yaml file",
    )
    parser.add_argument(
        "--list",
        action="store_true",
        help="print the experiments and their published numbers; train nothing",
    )
    data = parser.add_argument_group("data")
    data.add_argument(
        "--root",
        metavar="DIR",
        type=input_path,
        help="folder of the data (default: $TACTILE_DATA/NAME, such as AllegroUSkin, or a folder "
        "in the user's cache)",
    )
    parser.add_argument(
        "--out",
        metavar="DIR",
        type=OutputFolder("--out"),
        default="tables",
        help="folder for table and runs (default: tables)",
    )
    training = parser.add_argument_group("runs")
    training.add_argument(
        "--seeds",
        metavar="N",
        type=small_count,
        help="seeds per experiment, each with its own split (default: 5 for P1, P2 and P4, 10 for "
        "P3, 1 for P5, whose folds are splits, 3 for bts3)",
    )
    training.add_argument(
        "--epochs",
        metavar="N",
        type=positive,
        help="epochs (default: from the configurations)",
    )
    data.add_argument(
        "--stride",
        metavar="N",
        type=positive,
        help="use every N-th frame of each trial (default: all)",
    )
    data.add_argument(
        "--phases",
        metavar="PHASE",
        type=str,
        nargs="+",
        help="use only these phases of the grasp, such as: squeeze lift hold",
    )
    data.add_argument(
        "--tare",
        metavar="REST",
        type=rest,
        default=_TABLE_DEFAULT,
        help="frames at rest, whose mean is subtracted from each trial: a phase, the number of "
        "seconds at the start of the trial, or none (default: set by the table; hover for the "
        "tables of papers)",
    )
    training.add_argument(
        "--protocols",
        "--split-by",
        metavar="PROTOCOL",
        type=str,
        nargs="+",
        help="how the test part is held out; --list prints the choices. P1 and P2: whole trials "
        "(trial) or random frames (frame); P3: random grasps (random), grasps of each object "
        "(grasp), an object (object) or sessions (session) (default: all, reported separately)",
    )
    training.add_argument(
        "--folds",
        metavar="N",
        type=small_count,
        help="number of folds of cross-validation protocols, at least 2",
    )
    training.add_argument(
        "--only",
        metavar="GLOB",
        type=str,
        nargs="+",
        help="train only the experiments with matching names; the table also contains experiments "
        "with earlier runs",
    )
    training.add_argument(
        "--no-train",
        action="store_true",
        help="train nothing; write the table of the finished runs",
    )
    add_workers(parser)


def _table_name(text: str) -> InputPath:
    if text not in TABLES and not text.endswith((".yaml", ".yml")):
        raise argparse.ArgumentTypeError(
            f"invalid choice: '{text}' (choose from {', '.join(TABLES)}, or give a .yaml file)"
        )
    return input_path(text)


def list_outputs(arguments: argparse.Namespace) -> list[OutputPath]:
    r"""Returns the files that the command writes."""
    if arguments.list:
        return []
    from torch_geometric_tactile._texts import printable
    from torch_geometric_tactile.papers.load_table import load_table

    with option_names_in_errors(arguments, name="NAME"):
        table = load_table(arguments.name)
    title = re.escape(printable(table.title))
    kinds = {
        f"{table.name}.md": text_kind("a page of this table", f"# {title}\n"),
        f"{table.name}.csv": text_kind("the numbers of a table", "section,row,column,experiment,"),
        f"{table.name}-runs.csv": text_kind("the runs of a table", r"experiment,protocol,|\s*\Z"),
        f"{table.name}.png": PICTURE,
    }
    if table.orderings:
        kinds[f"{table.name}-orderings.csv"] = text_kind(
            "the orderings of a table", "ordering,protocol,first,second,"
        )
    # The results of a study determine its pictures, so the existing pictures are listed.
    pictures = Path(arguments.out).glob(f"{glob.escape(table.name)}-*.png")
    kinds |= {path.name: PICTURE for path in pictures}
    return files_in_folder(arguments.out, kinds)


def run(arguments: argparse.Namespace) -> int:
    r"""Runs the command and returns the exit status."""
    from torch_geometric_tactile.papers.load_table import load_table

    with option_names_in_errors(arguments, name="NAME"):
        table = load_table(arguments.name)
        if arguments.list:
            print(_describe_table(table))
            return 0
        return _run(table, arguments)


def _run(table: "Table", arguments: argparse.Namespace) -> int:
    from torch_geometric_tactile._texts import printable
    from torch_geometric_tactile.experiments.plan import Settings, make_plan
    from torch_geometric_tactile.papers._table_part import selected_part
    from torch_geometric_tactile.papers.write_table import write_table
    from torch_geometric_tactile.visualization._style import new_figure

    new_figure(1.0, 1.0)  # a missing matplotlib must fail before the long run
    table.select(arguments.only)  # a pattern without match must fail before the data is read
    settings = Settings(
        seeds=arguments.seeds,
        epochs=arguments.epochs,
        folds=arguments.folds,
        protocols=arguments.protocols and tuple(arguments.protocols),
        accelerator=arguments.accelerator,
        threads=arguments.threads,
    )
    data = {} if arguments.root is None else {"root": arguments.root}
    if arguments.tare is not _TABLE_DEFAULT:
        data["tare"] = arguments.tare
    options = {"stride": arguments.stride, "phases": arguments.phases}
    selection = {name: value for name, value in options.items() if value is not None}
    plan = make_plan(table, settings, data=data, selection=selection)
    train = not arguments.no_train
    try:
        plan_run = run_with_bar(
            plan, arguments.out, arguments.jobs, table.name, only=arguments.only, train=train
        )
    except KeyboardInterrupt as interrupt:
        # The message is empty if no run has started.
        advice = "; --no-train writes the table of finished runs" if str(interrupt) else ""
        raise KeyboardInterrupt(f"{interrupt}{advice}") from None
    paths = write_table(selected_part(plan_run, arguments.only), arguments.out)
    for text in (plan_run.describe(), *(f"wrote {path}" for path in paths)):
        print(printable(text), flush=True)
    return report_failures(plan_run)


def _has_own_configuration(cell: "Cell", table: "Table") -> bool:
    # Returns whether `tactile fit --config` trains the model of a cell on the data of the table.
    if not isinstance(cell.config, str) or cell.data or cell.transform:
        return False
    dataset = (cell.configuration.get("data") or {}).get("dataset") or {}
    return bool(dataset.get("class_path") == table.data.class_path)


def _describe_table(table: "Table") -> str:
    from tabulate import tabulate

    from torch_geometric_tactile._texts import printable

    keys = [key for key in _HEADERS if any(key in cell.published for cell in table.cells)]
    rows = [
        [cell.experiment, cell.row, cell.column, cell.section]
        + [cell.published.get(key) for key in keys]
        for cell in table.cells
    ]
    headers = ["experiment", "model", "inputs", "", *(_HEADERS[key] for key in keys)]
    published = (
        f"; published numbers ({table.place}), of a {table.measured_on}, "
        f"{table.recordings} recordings"
        if table.is_published
        else ""
    )
    protocols = "; ".join(f"{p.name} ({p.protocol.describe()})" for p in table.protocols)
    text = f"{table.title}\n{len(rows)} experiments{published}:\n\n{tabulate(rows, headers)}\n\n"
    text += f"Held out: {protocols}"
    configurations = (
        str(cell.config) for cell in table.cells if _has_own_configuration(cell, table)
    )
    name = next(configurations, None)
    text = text if name is None else f"{text}\nTo train one model: tactile fit --config {name}"
    return "\n".join(map(printable, text.split("\n")))
