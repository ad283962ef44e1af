r"""Options on how a recording is read, shared by the verbs that read one."""

import argparse
from typing import Any

from torch_geometric_tactile.commands._arguments import not_negative, positive

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


def add_reading_options(parser: argparse.ArgumentParser) -> None:
    r"""Adds the options of the readers of recordings."""
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


def reading_options(arguments: argparse.Namespace) -> dict[str, Any]:
    r"""Returns the options that were given, as :func:`~torch_geometric_tactile.io.read_recording`
    takes them.
    """
    given = {name: getattr(arguments, name) for name in _OPTIONS}
    options = {name: value for name, value in given.items() if value is not None}
    for name in ("tactile", "joint"):
        if len(options.get(name, ())) == 1:
            options[name] = options[name][0]
    return options
