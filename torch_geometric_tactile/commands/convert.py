r"""``tactile convert``: a recording in another format."""

import argparse

_READABLE = ".h5, .hdf5, .npz, .csv, .json, .jsonl, .ndjson or .txt"
_WRITABLE = ".h5, .hdf5, .npz, .csv, .jsonl or .ndjson"
HELP = "write a recording in another format"
DESCRIPTION = """\
Reads a recording and writes it in the format of the other suffix. What that format cannot
hold is named in a warning.
"""
EXAMPLES = """\
examples:
  tactile convert messages.jsonl recording.h5    messages of XELA's server as HDF5
  tactile convert log.csv recording.npz --forces
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    r"""Adds the arguments of the verb.

    Args:
        parser (argparse.ArgumentParser): The parser of the verb.
    """
    parser.add_argument("source", metavar="IN", help=f"the recording ({_READABLE})")
    parser.add_argument("target", metavar="OUT", help=f"the file to write ({_WRITABLE})")
    parser.add_argument(
        "--forces", action="store_true", help="forces in newtons instead of counts, from XELA files"
    )


def run(arguments: argparse.Namespace) -> int:
    r"""Runs the verb and returns the exit status.

    Args:
        arguments (argparse.Namespace): The arguments.
    """
    from torch_geometric_tactile.io import read_recording, write_recording

    options = {"forces": True} if arguments.forces else {}
    recording = read_recording(arguments.source, **options)
    write_recording(recording, arguments.target)
    print(f"{arguments.target}: {recording}")
    return 0
