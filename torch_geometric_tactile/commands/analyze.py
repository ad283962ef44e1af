r"""``tactile analyze``: what a checkpoint or predictor has learnt."""

import argparse

from torch_geometric_tactile.commands.arguments import add_allow, not_negative, positive

HELP = "draw what a model has learnt: encoder map, embeddings, attribution, errors"
DESCRIPTION = """\
Analyses a checkpoint of 'tactile fit', or a predictor that 'tactile predict --save' wrote,
on the test part of its data, and writes DIR/analysis.md with its pictures: confusion and
ROC, the map of the edge encoder, node features by t-SNE and UMAP, and which taxels and
patches count, each with numbers and beside untrained models.
"""
EXAMPLES = """\
examples:
  tactile analyze runs/mt_gcn/version_0/checkpoints/last.ckpt --out analysis
  tactile analyze last.ckpt --config p1_table2/mt_gcn_te --root grasps --out analysis
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    r"""Adds the arguments of the verb.

    Args:
        parser (argparse.ArgumentParser): The parser of the verb.
    """
    parser.add_argument(
        "model",
        metavar="MODEL",
        help="a checkpoint of 'tactile fit', or a file of 'tactile predict --save'",
    )
    parser.add_argument("--out", metavar="DIR", required=True, help="folder of page and pictures")
    parser.add_argument(
        "--config",
        metavar="CONFIG",
        help="the configuration of its data, a file or a shipped one; by default the config.yaml "
        "that the run has beside its checkpoints",
    )
    parser.add_argument(
        "--root", metavar="DIR", help="folder of the data, instead of the configuration's"
    )
    add_allow(parser)
    parser.add_argument(
        "--frames",
        metavar="N",
        type=positive,
        default=200,
        help="frames of the test part that are embedded and explained (default: 200)",
    )
    parser.add_argument(
        "--seed",
        type=not_negative,
        default=0,
        help="of embeddings and untrained models (default: 0)",
    )


def run(arguments: argparse.Namespace) -> int:
    r"""Runs the verb and returns the exit status.

    Args:
        arguments (argparse.Namespace): The arguments.
    """
    from torch_geometric_tactile.reports import analysis
    from torch_geometric_tactile.texts import printable

    page = analysis.main(
        arguments.model,
        arguments.out,
        config=arguments.config,
        root=arguments.root,
        frames=arguments.frames,
        seed=arguments.seed,
        allow=arguments.allow,
    )
    print(printable(f"analysis: {page}"))
    return 0
