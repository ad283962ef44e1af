r"""``tactile table``: the models of a table of the papers, beside its published numbers."""

import argparse
import sys

from torch_geometric_tactile.commands.arguments import add_workers, few, positive, rest

# The names in `experiments`, which is too heavy to import for them.
TABLES = ("p1-table2", "p1-table3", "p2-table2", "p2-table4", "p3", "p3-k", "p4", "p5", "bts3")
_OF_TABLE = object()  # what the table says
_HEADERS = {
    "accuracy": "accuracy (%)",
    "spread": "±",
    "variance": "variance (%²)",
    "auc": "ROC",
    "memory": "memory (MB)",
}

HELP = "train the models of a table, and write it beside the published numbers"
DESCRIPTION = """\
Trains and tests the models of a table and writes DIR/NAME.md, NAME.csv and NAME.png. The tables
of P1 and P2 are on recordings of an Allegro hand with 384 taxels, held out by trial and by frame,
those of P3 on grasps of three fingers with 19 electrodes each, that of P4 on an Allegro hand with
240 taxels that squeezes, that of P5 on letters pressed on an array, beside the published numbers.
Needs the extras 'train' and 'viz', and 'baselines' for p5.

tables:
  p1-table2   object properties by inputs: 36 GCNs, CNNs and FNNs, with and without joint angles
  p1-table3   object properties by adjacency: the best of them on four graphs
  p2-table2   objects by segmentation of the hand: 18 GCNs (and their ROC values, Table III)
  p2-table4   memory that training these 18 takes
  p3          grasp stability over time: SVM, LSTM and GCN on one or three fingers, beside ours
  p3-k        the GCNs of three fingers by the number of neighbours in their graph
  p4          twenty objects by the MS-CNN's seven patterns, with one force or three, filters shared
              or not, beside an FNN and ours
  p5          letters pressed on an array: CNN, BMF-CNN, fused layers, SIFT and SURF, beside ours
  bts3        grasp stability on real grasps: what 'tactile demo' reports
  FILE.yaml   your own, on any data set (see the page on experiments in the documentation)
"""
EXAMPLES = """\
examples:
  tactile simulate --out sim --jobs 2                    recordings to train on, if you have none
  tactile table p2-table2 --list                         the experiments and the published numbers
  tactile table p2-table2 --root sim --stride 200 --epochs 1 --seeds 1
                                                         a first look, in minutes
  tactile table p1-table2 --root sim --stride 20 --epochs 30 --jobs 2
  tactile table p1-table2 --root sim --stride 20 --epochs 30 --only '*gcn_te*'
                                                         only some models; the table has the rest
                                                         where it was trained before
  tactile table p1-table2 --root mine --tare 0.5         recordings without a phase 'hover', at rest
                                                         in the first half second of each trial
  tactile simulate --objects bigs --out bigs --jobs 2    grasps for P3, if you have none
  tactile table p3 --root bigs --seeds 1 --protocols random
                                                         the paper's protocol, once
  tactile simulate --objects twenty --motion squeeze --trials 30 --spread wide --seconds 10 \\
    --preset ci --max-attempts 40 --out twenty --jobs 2  squeezes for P4, if you have none
  tactile table p4 --root twenty --seeds 1 --epochs 20   a first look at all seven patterns
  tactile simulate --objects letters --presses 100 --out letters --jobs 2
  tactile table p5 --root letters --epochs 20 --protocols press --jobs 2
                                                         letters with whole presses held out
  tactile table p1-table2 --root sim --stride 20 --backend dask --scheduler tcp://host:8786

Each run (a model, a seed, a protocol) is a file in DIR/runs when it is finished. The same command
goes on where it was stopped or killed. Tables of one DIR share their runs. Nothing is chosen by
the test part: the number of epochs is fixed, and the model is tested once, at the end.
One experiment alone: tactile fit --config p1_table2/mt_gcn_te_joint
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    r"""Adds the arguments of the verb.

    Args:
        parser (argparse.ArgumentParser): The parser of the verb.
    """
    parser.add_argument(
        "name",
        metavar="TABLE",
        type=_table_name,
        help=f"{', '.join(TABLES)}, or a file of your own that ends with .yaml",
    )
    parser.add_argument(
        "--list", action="store_true", help="print the experiments with their published numbers"
    )
    parser.add_argument(
        "--root",
        metavar="DIR",
        help="folder of the data; by default $TACTILE_DATA with the name of the data set, such as "
        "AllegroUSkin, or a folder in the user's cache",
    )
    parser.add_argument(
        "--out", metavar="DIR", default="tables", help="folder of table and runs (default: tables)"
    )
    parser.add_argument(
        "--seeds",
        metavar="N",
        type=few,
        help="runs of each experiment; a seed decides split and training (default: the table's, 5 "
        "for those of P1, P2 and P4, 10 for those of P3, 1 for p5, 3 for bts3)",
    )
    parser.add_argument(
        "--epochs",
        metavar="N",
        type=positive,
        help="epochs, instead of those of the configurations",
    )
    parser.add_argument(
        "--stride",
        metavar="N",
        type=positive,
        help="use every N-th frame of each trial (default: all)",
    )
    parser.add_argument(
        "--phases",
        metavar="PHASE",
        nargs="+",
        help="use only frames in these phases of the grasp, such as: squeeze lift hold",
    )
    parser.add_argument(
        "--tare",
        metavar="REST",
        type=rest,
        default=_OF_TABLE,
        help="the frames at rest of each trial, whose mean is subtracted from its readings: a "
        "phase, seconds at the beginning of a trial, or none (default: the table's; those of the "
        "papers: hover)",
    )
    parser.add_argument(
        "--protocols",
        "--split-by",
        metavar="PROTOCOL",
        nargs="+",
        help="what is held out, of what the table names, as --list prints: for P1 and P2 whole "
        "trials (trial) or random frames of all trials (frame); for P3 random grasps (random), "
        "grasps of each object (grasp), an object (object) or sessions (session) (default: all, "
        "one after the other, never mixed)",
    )
    parser.add_argument(
        "--folds", metavar="N", type=few, help="folds of protocols that have some, at least 2"
    )
    parser.add_argument(
        "--only", metavar="GLOB", nargs="+", help="train only experiments with such names"
    )
    parser.add_argument(
        "--no-train", action="store_true", help="train nothing: the table of the finished runs"
    )
    add_workers(parser)


def _table_name(text: str) -> str:
    if text not in TABLES and not text.endswith((".yaml", ".yml")):
        raise argparse.ArgumentTypeError(
            f"invalid choice: '{text}' (choose from {', '.join(TABLES)}, or give a .yaml file)"
        )
    return text


def run(arguments: argparse.Namespace) -> int:
    r"""Runs the verb and returns the exit status.

    Args:
        arguments (argparse.Namespace): The arguments.
    """
    if arguments.list:
        print(_listed(arguments.name))
        return 0
    from torch_geometric_tactile.commands.progress import progress
    from torch_geometric_tactile.experiments.plan import Settings, make_plan
    from torch_geometric_tactile.experiments.run_plan import Workers, run_plan
    from torch_geometric_tactile.experiments.tables import load_table
    from torch_geometric_tactile.reports.table import write_table
    from torch_geometric_tactile.texts import printable
    from torch_geometric_tactile.visualization.figure import new_figure

    new_figure(1.0, 1.0)  # tells before a long run whether its picture can be drawn
    table = load_table(arguments.name)
    table.select(arguments.only)  # a wrong pattern is found before the data is read
    workers = Workers(arguments.jobs, arguments.backend, arguments.scheduler)
    settings = Settings(
        seeds=arguments.seeds,
        epochs=arguments.epochs,
        folds=arguments.folds,
        protocols=arguments.protocols and tuple(arguments.protocols),
        accelerator=arguments.accelerator,
        threads=arguments.threads,
    )
    data = {} if arguments.root is None else {"root": arguments.root}
    if arguments.tare is not _OF_TABLE:
        data["tare"] = arguments.tare
    chosen = {"stride": arguments.stride, "phases": arguments.phases}
    plan = make_plan(
        table,
        settings,
        data=data,
        selection={name: value for name, value in chosen.items() if value is not None},
    )
    try:
        with progress(table.name, "run") as show:
            finished = run_plan(
                plan,
                arguments.out,
                workers,
                only=arguments.only,
                train=not arguments.no_train,
                on_progress=show,
            )
    except KeyboardInterrupt as stop:
        more = ", and with --no-train it writes the table of those" if str(stop) else ""
        raise KeyboardInterrupt(f"{stop}{more}") from None
    paths = write_table(finished, arguments.out)
    print(printable(finished.describe()), flush=True)
    for path in paths:
        print(printable(f"wrote {path}"), flush=True)
    for name, reason in finished.failed.items():
        print(printable(f"tactile: error: {name}: {reason}"), file=sys.stderr)
    return 1 if finished.failed else 0


def _listed(name: str) -> str:
    from tabulate import tabulate

    from torch_geometric_tactile.experiments.tables import load_table
    from torch_geometric_tactile.texts import printable

    table = load_table(name)
    keys = [key for key in _HEADERS if any(key in cell.published for cell in table.cells)]
    rows = [
        [cell.experiment, cell.row, cell.column, cell.section]
        + [cell.published.get(key) for key in keys]
        for cell in table.cells
    ]
    headers = ["experiment", "model", "inputs", "", *(_HEADERS[key] for key in keys)]
    published = (
        f"; published numbers ({table.place}), of a {table.measured_on} with private recordings"
        if table.is_published
        else ""
    )
    protocols = "; ".join(f"{p.name} ({p.protocol.describe()})" for p in table.protocols)
    text = f"{table.title}\n{len(rows)} experiments{published}:\n\n{tabulate(rows, headers)}\n\n"
    text += f"Held out: {protocols}"
    alone = next((cell.config for cell in table.cells if cell.config is not None), None)
    text = text if alone is None else f"{text}\nOne of them alone: tactile fit --config {alone}"
    return "\n".join(map(printable, text.split("\n")))
