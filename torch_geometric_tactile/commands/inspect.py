r"""``tactile inspect``: summarises a recording as text and as a picture."""

import argparse
from pathlib import PurePath

from torch_geometric_tactile.commands._arguments import READABLE
from torch_geometric_tactile.commands._file_kinds import PICTURE
from torch_geometric_tactile.commands._paths import OutputFile, OutputPath, input_path
from torch_geometric_tactile.commands._reading import add_reading_options, reading_options

HELP = "Summarise and plot a recording"
DESCRIPTION = """\
Prints the number of frames, rate, taxels, range of the readings, joints, actions, dead
taxels and metadata of a recording, and plots readings, contact, joints and actions over
time. Reads HDF5, npz, MCAP and CSV files, logs of xela_log and messages of XELA's server.
The plot needs the extra 'viz'.
"""
EXAMPLES = """\
examples:
  tactile inspect grasp.h5                       summary, and the plot grasp_inspect.png
  tactile inspect messages.jsonl --no-picture    summary only
  tactile inspect glove.csv --out glove.png
  tactile inspect glove.csv --tactile 'pad_.*' --joint 'bend_.*' --label grasp
                                                 a CSV file with your own column names
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    r"""Adds the arguments of the command to a parser."""
    parser.add_argument("file", metavar="FILE", type=input_path, help=f"the recording ({READABLE})")
    picture = parser.add_mutually_exclusive_group()
    picture.add_argument(
        "--out",
        metavar="PNG",
        type=OutputFile("--out", PICTURE),
        help="file of the plot (default: NAME_inspect.png in the current folder)",
    )
    picture.add_argument("--no-picture", action="store_true", help="print the summary only")
    add_reading_options(parser)


def list_outputs(arguments: argparse.Namespace) -> list[OutputPath]:
    r"""Returns the files that the command writes."""
    return [] if arguments.no_picture else [OutputPath(_picture_path(arguments), "--out", PICTURE)]


def _picture_path(arguments: argparse.Namespace) -> str:
    return arguments.out or f"{PurePath(arguments.file).stem}_inspect.png"


def run(arguments: argparse.Namespace) -> int:
    r"""Runs the command and returns the exit status."""
    from torch_geometric_tactile._texts import printable
    from torch_geometric_tactile.reports._recording import describe_file, draw_recording

    recording, summary = describe_file(arguments.file, **reading_options(arguments))
    print(summary, flush=True)
    if not arguments.no_picture:
        path = _picture_path(arguments)
        draw_recording(recording, path)
        print(f"{'picture':<13}{printable(path)}")
    return 0
