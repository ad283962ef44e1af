r"""``tactile convert``: a recording in another format."""

import argparse

_READABLE = ".h5, .hdf5, .npz, .mcap, .csv, .json, .jsonl, .ndjson or .txt"
_WRITABLE = ".h5, .hdf5, .npz, .mcap, .csv, .jsonl or .ndjson"
HELP = "write a recording in another format"
DESCRIPTION = """\
Reads a recording and writes it in the format of the other suffix. What that format cannot
hold is named in a warning. `tactile convert bigs IN... OUT_DIR` brings in grasps of the
BiGS data set and has options of its own: `tactile convert bigs --help`.
"""
EXAMPLES = """\
examples:
  tactile convert messages.jsonl recording.h5    messages of XELA's server as HDF5
  tactile convert log.csv recording.npz --forces
  tactile convert glove.csv recording.h5 --tactile 'pad_.*' --joint bend_1 --joint bend_2 \\
      --label grasp --unit count                 a CSV file with names of its own
  tactile convert numbers.csv recording.h5 --num-taxels 24 --num-joints 0
                                                 a CSV file without names
  tactile convert bigs grasps/*.h5 bigs/         grasps of the BiGS data set
"""
# What stands in the place of a file that has a suffix, with the module of its own arguments.
KINDS = {"bigs": "convert_bigs"}
# The arguments that are options of the readers of these names.
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
    parser.add_argument("source", metavar="IN", help=f"the recording ({_READABLE})")
    parser.add_argument("target", metavar="OUT", help=f"the file to write ({_WRITABLE})")
    parser.add_argument(
        "--forces",
        action="store_true",
        default=None,
        help="forces in newtons instead of counts, from XELA files",
    )
    parser.add_argument(
        "--allow-large",
        action="store_true",
        default=None,
        help="read an npz file whose arrays are absurdly large for the size of the file",
    )
    names = parser.add_argument_group("CSV files with names of their own")
    names.add_argument(
        "--tactile",
        action="append",
        metavar="NAME",
        help="a column of readings, once for each in the order of the layout; or once, a regular "
        "expression (default: all columns that are nothing else)",
    )
    names.add_argument(
        "--joint", action="append", metavar="NAME", help="a column of angles, as --tactile"
    )
    names.add_argument("--time", metavar="NAME", help="the column of the time (default: time)")
    names.add_argument("--time-unit", metavar="UNIT", help="s, ms, us or ns")
    names.add_argument("--label", metavar="NAME", help="the column of the label")
    names.add_argument("--ignore", action="append", metavar="NAME", help="a column to leave out")
    names.add_argument("--unit", metavar="UNIT", help="unit of the readings, count or newton")
    sizes = parser.add_argument_group("CSV files without names, or whose names tell no sizes")
    sizes.add_argument("--num-taxels", type=int, metavar="N", help="number of taxels")
    sizes.add_argument("--num-channels", type=int, metavar="C", help="channels of a taxel")
    sizes.add_argument("--num-joints", type=int, metavar="J", help="number of joints")
    sizes.add_argument(
        "--no-header",
        action="store_false",
        dest="header",
        default=None,
        help="the first line is a frame, whatever is in it",
    )
    sizes.add_argument("--rate", type=float, help="frames per second, for files without time")


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
