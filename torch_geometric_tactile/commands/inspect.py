r"""``tactile inspect``: a recording as text and as a picture."""

import argparse
from pathlib import PurePath

_READABLE = ".h5, .hdf5, .npz, .mcap, .csv, .json, .jsonl, .ndjson or .txt"
HELP = "describe and draw a recording"
DESCRIPTION = """\
Reads an HDF5, npz, MCAP or CSV file of a recording, a log of xela_log or messages of
XELA's server, prints frames, rate, taxels, readings, joints, dead taxels and metadata, and draws
readings, contact and joints over time.
"""
EXAMPLES = """\
examples:
  tactile inspect grasp.h5                       the facts, and grasp_inspect.png
  tactile inspect messages.jsonl --no-picture    only the facts
  tactile inspect glove.csv --out glove.png
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    r"""Adds the arguments of the verb.

    Args:
        parser (argparse.ArgumentParser): The parser of the verb.
    """
    parser.add_argument("file", metavar="FILE", help=f"the recording ({_READABLE})")
    picture = parser.add_mutually_exclusive_group()
    picture.add_argument(
        "--out",
        metavar="PICTURE",
        help="PNG file to draw; by default the name of the file with '_inspect.png', in the "
        "current folder",
    )
    picture.add_argument("--no-picture", action="store_true", help="print only")


def run(arguments: argparse.Namespace) -> int:
    r"""Runs the verb and returns the exit status.

    Args:
        arguments (argparse.Namespace): The arguments.
    """
    from torch_geometric_tactile.reports.recording import describe_file, draw_recording
    from torch_geometric_tactile.texts import printable

    recording, facts = describe_file(arguments.file)
    print(facts, flush=True)
    if not arguments.no_picture:
        picture = arguments.out or f"{PurePath(arguments.file).stem}_inspect.png"
        draw_recording(recording, picture)
        print(f"{'picture':<13}{printable(picture)}")
    return 0
