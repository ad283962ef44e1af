r"""``tactile convert``: writes a recording in another format, or recordings as a data set."""

import argparse
from pathlib import Path

from torch_geometric_tactile.commands import _convert_lerobot as convert_lerobot
from torch_geometric_tactile.commands._arguments import READABLE
from torch_geometric_tactile.commands._paths import OutputPath, input_path, recording_file
from torch_geometric_tactile.commands._reading import add_reading_options, reading_options

_WRITABLE = ".h5, .hdf5, .npz, .mcap, .csv, .jsonl, .ndjson"
HELP = "Convert a recording to another format"
DESCRIPTION = """\
Reads a recording and writes it in another format; the suffixes select the formats. A
warning names all content that the new format cannot hold. If OUT ends in .lerobot, it is the
folder of a LeRobot data set, and IN may be several recordings or folders with recordings,
each recording an episode. `tactile convert bigs IN... OUT_DIR` imports grasps of the BiGS
data set and has its own options: `tactile convert bigs --help`.
"""
EXAMPLES = """\
examples:
  tactile convert messages.jsonl recording.h5    messages of XELA's server to HDF5
  tactile convert log.csv recording.npz --forces
  tactile convert glove.csv recording.h5 --tactile 'pad_.*' --joint bend_1 --joint bend_2 \\
      --label grasp --unit count                 a CSV file with your own column names
  tactile convert numbers.csv recording.h5 --num-taxels 24 --num-joints 0
                                                 a CSV file without column names
  tactile convert grasps/ grasps.lerobot --fps 30 --every-frame
                                                 recordings as a LeRobot data set
  tactile convert skin_*.h5 touch.lerobot --add-to datasets/cups
                                                 the same, added to a copy of a data set
  tactile convert bigs grasps/*.h5 bigs/         grasps of the BiGS data set
"""
# First arguments that select another parser, with the module of the parser.
KINDS = {"bigs": "_convert_bigs"}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    r"""Adds the arguments of the command to a parser."""
    parser.add_argument(
        "source",
        metavar="IN",
        nargs="+",
        type=input_path,
        help=f"the recording ({READABLE})",
    )
    parser.add_argument(
        "target",
        metavar="OUT",
        type=_target,
        help=f"the file to write ({_WRITABLE}), or a folder (.lerobot)",
    )
    add_reading_options(parser)
    convert_lerobot.add_lerobot_options(parser)


def _target(text: str) -> OutputPath:
    path = recording_file("OUT")(text)
    is_folder = Path(path).suffix.lower() == convert_lerobot.SUFFIX
    return OutputPath(path, path.argument, None) if is_folder else path


def run(arguments: argparse.Namespace) -> int:
    r"""Runs the command and returns the exit status."""
    from torch_geometric_tactile.io import read_recording, write_recording

    if Path(arguments.target).suffix.lower() == convert_lerobot.SUFFIX:
        return convert_lerobot.run(arguments, reading_options(arguments))
    option_names = [*convert_lerobot.lerobot_options(arguments)]
    if option_names:
        raise ValueError(
            f"'OUT' must end in {convert_lerobot.SUFFIX} with "
            f"'--{option_names[0].replace('_', '-')}' (got '{arguments.target}')"
        )
    if len(arguments.source) > 1:
        raise ValueError(
            f"'IN' must be one recording unless 'OUT' ends in {convert_lerobot.SUFFIX} "
            f"(got {len(arguments.source)})"
        )
    recording = read_recording(arguments.source[0], **reading_options(arguments))
    write_recording(recording, arguments.target)
    print(f"{arguments.target}: {recording}")
    return 0
