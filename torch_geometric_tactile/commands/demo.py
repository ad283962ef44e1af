r"""``tactile demo``: from data to judged models and a report."""

import argparse
import os

from torch_geometric_tactile.commands.arguments import positive

HELP = "train and judge grasp stability models on real grasps, and write a report"
DESCRIPTION = """\
Trains GCN-DF, GCN-FF, one-finger GCNs, an SVM and a majority baseline on the BioTac SP
stability set, judges each with random folds, with objects left out, and on the official
test of unseen objects (also by palm pose), raw and scaled by session, and writes
report.html, its pictures, metrics.json and the checkpoint of GCN-DF.
"""
EXAMPLES = """\
examples:
  tactile demo                           downloads the data, or generates some with no network
  tactile demo --root recordings --seeds 1 --epochs 3
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
    parser.add_argument("--out", default="report", help="folder of the report (default: report)")
    parser.add_argument(
        "--seeds", type=positive, default=3, help="trainings of every model (default: 3)"
    )
    parser.add_argument("--folds", type=positive, default=5, help="folds, at least 2 (default: 5)")
    parser.add_argument(
        "--epochs", type=positive, help="epochs, instead of the configurations' own"
    )
    parser.add_argument(
        "--jobs",
        type=positive,
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
    from torch_geometric_tactile.reports import grasp

    grasp.main(
        root=arguments.root,
        out=arguments.out,
        seeds=arguments.seeds,
        folds=arguments.folds,
        epochs=arguments.epochs,
        num_processes=arguments.jobs,
        generated=arguments.generated,
    )
    return 0
