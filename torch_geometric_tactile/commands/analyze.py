r"""``tactile analyze``: writes a page on the errors, embeddings and attributions of a model."""

import argparse

from torch_geometric_tactile.commands._arguments import add_run_data, not_negative, positive
from torch_geometric_tactile.commands._file_kinds import PICTURE, text_kind
from torch_geometric_tactile.commands._paths import (
    OutputFolder,
    OutputPath,
    files_in_folder,
    input_path,
)

HELP = "Analyse a trained model: errors, embeddings, attribution"
EXTRAS = "train,viz"
DESCRIPTION = """\
Analyses a checkpoint or predictor on the test part of its data and writes DIR/analysis.md
with figures: confusion matrix and ROC, the map of the edge encoder, node features in t-SNE
and UMAP, and the taxels and patches that matter most. Each figure comes with its numbers, and
with numbers from untrained models for comparison. Needs the extras 'train' and 'viz'.
"""
EXAMPLES = """\
examples:
  tactile analyze runs/mt_gcn/version_0/checkpoints/last.ckpt --out analysis
  tactile analyze last.ckpt --config p1_table2/mt_gcn_te --root grasps --out analysis
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    r"""Adds the arguments of the command to a parser."""
    parser.add_argument(
        "model",
        metavar="MODEL",
        type=input_path,
        help="a checkpoint from 'tactile fit', a predictor from 'tactile predict --save', or the "
        "name of a predictor in docs/pretrained.md",
    )
    parser.add_argument(
        "--out",
        metavar="DIR",
        type=OutputFolder("--out"),
        required=True,
        help="folder for the page and its figures",
    )
    add_run_data(parser)
    parser.add_argument(
        "--frames",
        metavar="N",
        type=positive,
        default=200,
        help="test frames to embed and explain (default: 200)",
    )
    parser.add_argument(
        "--seed",
        metavar="N",
        type=not_negative,
        default=0,
        help="seed for the embeddings and the untrained models (default: 0)",
    )


def list_outputs(arguments: argparse.Namespace) -> list[OutputPath]:
    r"""Returns the files that the command writes."""
    embeddings = [f"{method}_{dims}d" for method in ("tsne", "umap") for dims in (2, 3)]
    pictures = ("confusion", "roc", "encoder_map", "attribution", "occlusion", *embeddings)
    page = text_kind("a page of 'tactile analyze'", "# What the model has learnt\n")
    kinds = {"analysis.md": page} | {f"{name}.png": PICTURE for name in pictures}
    return files_in_folder(arguments.out, kinds)


def run(arguments: argparse.Namespace) -> int:
    r"""Runs the command and returns the exit status."""
    from torch_geometric_tactile._texts import printable
    from torch_geometric_tactile.reports import _analysis as analysis

    page = analysis.write_analysis(
        arguments.model,
        arguments.out,
        config=arguments.config,
        root=arguments.root,
        frames=arguments.frames,
        seed=arguments.seed,
    )
    print(printable(f"analysis: {page}"))
    return 0
