r"""``tactile convert``: a recording in another format."""

import argparse

from torch_geometric_tactile.commands.arguments import READABLE, not_negative, positive

_WRITABLE = ".h5, .hdf5, .npz, .mcap, .csv, .jsonl or .ndjson"
HELP = "Convert a recording to another format"
DESCRIPTION = """\
Reads a recording and writes it in another format; the suffixes select the formats. A
warning names anything that the new format cannot hold. `tactile convert bigs IN... OUT_DIR`
imports grasps of the BiGS data set and has its own options: `tactile convert bigs --help`.
"""
EXAMPLES = """\
examples:
  tactile convert messages.jsonl recording.h5    messages of XELA's server to HDF5
  tactile convert log.csv recording.npz --forces
  tactile convert glove.csv recording.h5 --tactile 'pad_.*' --joint bend_1 --joint bend_2 \\
      --label grasp --unit count                 a CSV file with your own column names
  tactile convert numbers.csv recording.h5 --num-taxels 24 --num-joints 0
                                                 a CSV file without column names
  tactile convert bigs grasps/*.h5 bigs/         grasps of the BiGS data set
"""
# Words in place of IN that select another parser, with its module.
KINDS = {"bigs": "convert_bigs"}
# Arguments that are passed on to the reader of the format, by the same names.
_OPTIONS = (
    "forces",
    "tactile",
    "joint",
    "time",
    "time_unit",
    "label",
    "ignore",
    "unit",
    "rate",
    "num_taxels",
    "num_channels",
    "num_joints",
    "header",
    "allow_large",
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    r"""Adds the arguments of the verb.

    Args:
        parser (argparse.ArgumentParser): The parser of the verb.
    """
    parser.add_argument("source", metavar="IN", help=f"the recording ({READABLE})")
    parser.add_argument("target", metavar="OUT", help=f"the file to write ({_WRITABLE})")
    parser.add_argument(
        "--forces",
        action="store_true",
        default=None,
        help="read forces in newtons instead of counts from XELA files",
    )
    parser.add_argument(
        "--allow-large",
        action="store_true",
        default=None,
        help="read an npz file whose arrays unpack to far more than the size of the file",
    )
    names = parser.add_argument_group("CSV files with other column names")
    names.add_argument(
        "--tactile",
        action="append",
        metavar="NAME",
        help="a column of readings; repeat it in the order of the layout, or give one regular "
        "expression (default: all columns without another role)",
    )
    names.add_argument(
        "--joint", action="append", metavar="NAME", help="a column of joint angles; like --tactile"
    )
    names.add_argument("--time", metavar="NAME", help="the time column (default: time)")
    names.add_argument(
        "--time-unit", metavar="UNIT", help="unit of the time column: s, ms, us or ns"
    )
    names.add_argument("--label", metavar="NAME", help="the label column")
    names.add_argument("--ignore", action="append", metavar="NAME", help="a column to skip")
    names.add_argument("--unit", metavar="UNIT", help="unit of the readings: count or newton")
    sizes = parser.add_argument_group("CSV files without column names")
    sizes.add_argument("--num-taxels", type=positive, metavar="N", help="number of taxels")
    sizes.add_argument("--num-channels", type=positive, metavar="C", help="channels per taxel")
    sizes.add_argument("--num-joints", type=not_negative, metavar="J", help="number of joints")
    sizes.add_argument(
        "--no-header",
        action="store_false",
        dest="header",
        default=None,
        help="treat the first line as data",
    )
    sizes.add_argument(
        "--rate", metavar="HZ", type=float, help="frames per second, for files without time"
    )


def run(arguments: argparse.Namespace) -> int:
    r"""Runs the verb and returns the exit status.

    Args:
        arguments (argparse.Namespace): The arguments.
    """
    from torch_geometric_tactile.io import read_recording, write_recording

    given = {name: getattr(arguments, name) for name in _OPTIONS}
    options = {name: value for name, value in given.items() if value is not None}
    for name in ("tactile", "joint"):
        if len(options.get(name, ())) == 1:
            options[name] = options[name][0]
    recording = read_recording(arguments.source, **options)
    write_recording(recording, arguments.target)
    print(f"{arguments.target}: {recording}")
    return 0
