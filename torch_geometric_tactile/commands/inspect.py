r"""``tactile inspect``: summarises recordings as text, and plots a single recording."""

import argparse
import json
from dataclasses import asdict
from pathlib import Path, PurePath

from torch_geometric_tactile.commands._arguments import READABLE
from torch_geometric_tactile.commands._file_kinds import PICTURE
from torch_geometric_tactile.commands._paths import OutputFile, OutputPath, input_path
from torch_geometric_tactile.commands._reading import add_reading_options, reading_options
from torch_geometric_tactile.commands._runs import option_names_in_errors, option_text

HELP = "Summarise a recording or a folder of recordings, and plot a recording"
DESCRIPTION = """\
Summarises a recording: number of frames, frame rate, taxels, range of the readings, joints,
actions, metadata, and taxels that do not measure (dead, constant, saturated, or equal to another
taxel). Plots readings, contact, joints and actions over time; the plot needs the extra 'viz'.
Reads HDF5, npz, MCAP and CSV files, logs of xela_log and messages of XELA's server.

For a folder, the command summarises all recordings, without a plot: formats, frame rates, taxels,
gaps, the number of recordings per label and per object, and the files in which a taxel does not
measure. Unreadable files are listed with the reason, and the exit status is 1. In a LeRobot data
set, each episode is a recording; --tactile names the features with tactile readings.
"""
EXAMPLES = """\
examples:
  tactile inspect grasp.h5                       summary, and the plot grasp_inspect.png
  tactile inspect messages.jsonl --no-picture    summary only
  tactile inspect glove.csv --out glove.png
  tactile inspect glove.csv --tactile 'pad_.*' --joint 'bend_.*' --label grasp
                                                 a CSV file with your own column names
  tactile inspect grasps/                        all recordings of a folder
  tactile inspect grasps/ --pattern '{person}_{object}_{trial}'
                                                 the same, and the recordings of each person
  tactile inspect grasps/ --json > grasps.json   for programs
  tactile inspect datasets/cups --tactile 'observation.tactile.*'
                                                 the episodes of a LeRobot data set
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    r"""Adds the arguments of the command to a parser."""
    parser.add_argument(
        "file",
        metavar="FILE",
        type=input_path,
        help=f"the recording ({READABLE}), a folder of recordings or a LeRobot data set",
    )
    output = parser.add_mutually_exclusive_group()
    output.add_argument(
        "--out",
        metavar="PNG",
        type=OutputFile("--out", PICTURE),
        help="file of the plot (default: NAME_inspect.png in the current folder)",
    )
    output.add_argument("--no-picture", action="store_true", help="print the summary only")
    output.add_argument(
        "--json",
        action="store_true",
        help="for a folder: print the summary of each recording as JSON",
    )
    parser.add_argument(
        "--pattern",
        metavar="PATTERN",
        type=str,
        help="for a folder: form of the file names without suffix, as in 'tactile compare'; the "
        "summary lists the values of each name; with a '/', subfolders are searched (default: "
        "'{object}_{trial}')",
    )
    add_reading_options(parser)


def list_outputs(arguments: argparse.Namespace) -> list[OutputPath]:
    r"""Returns the files that the command writes."""
    has_picture = not (arguments.no_picture or arguments.json or _is_folder(arguments))
    return [OutputPath(_picture_path(arguments), "--out", PICTURE)] if has_picture else []


def _is_folder(arguments: argparse.Namespace) -> bool:
    # A run of eFlesh's probe is a folder that is one recording.
    from torch_geometric_tactile.io._folder_recordings import is_probe_run

    folder = Path(arguments.file)
    return arguments.file != "" and folder.is_dir() and not is_probe_run(folder)


def _picture_path(arguments: argparse.Namespace) -> str:
    return arguments.out or f"{PurePath(arguments.file).stem}_inspect.png"


def run(arguments: argparse.Namespace) -> int:
    r"""Runs the command and returns the exit status."""
    if _is_folder(arguments):
        return _inspect_folder(arguments)
    option = "--json" if arguments.json else "--pattern" if arguments.pattern else None
    if option is not None:
        raise ValueError(f"'FILE' must be a folder with '{option}' (got '{arguments.file}')")
    from torch_geometric_tactile._texts import printable
    from torch_geometric_tactile.reports._recording import describe_file, draw_recording

    with option_names_in_errors(arguments):
        recording, summary = describe_file(arguments.file, **reading_options(arguments))
    print(summary, flush=True)
    if not arguments.no_picture:
        path = _picture_path(arguments)
        draw_recording(recording, path)
        print(f"{'picture':<13}{printable(path)}")
    return 0


def _inspect_folder(arguments: argparse.Namespace) -> int:
    from torch_geometric_tactile.reports._recording_folder import describe_folder, read_folder

    if arguments.out is not None:
        raise ValueError(
            f"'FILE' must be a recording with '--out' (got the folder '{arguments.file}'): a "
            "folder has no plot"
        )
    with option_names_in_errors(arguments):
        facts = read_folder(
            arguments.file,
            arguments.pattern,
            error_to_text=lambda error: option_text(error, arguments),
            **reading_options(arguments),
        )
    text = json.dumps(asdict(facts), indent=1) if arguments.json else describe_folder(facts)
    print(text, flush=True)
    if facts.unreadable:
        raise ValueError(
            f"'{arguments.file}' must hold files that can be read (got {len(facts.unreadable)} "
            "that cannot): the summary has the reason of each under 'unreadable'"
        )
    return 0
