r"""Options for reading recordings, shared by the commands that read them."""

import argparse
from typing import Any

from torch_geometric_tactile.commands._arguments import not_negative, positive

# Groups of options by title. An option is named like the argument of the reader.
_OPTIONS: dict[str | None, dict[str, dict[str, Any]]] = {
    None: {
        "forces": {
            "action": "store_true",
            "help": "read forces in newtons instead of counts from XELA files",
        },
        "allow_large": {
            "action": "store_true",
            "help": "read npz files even if their arrays unpack to far more than the file size",
        },
    },
    "CSV files with other column names": {
        "tactile": {
            "action": "append",
            "metavar": "NAME",
            "type": str,
            "help": "a column of readings; repeat the option in the order of the layout, or give "
            "one regular expression (default: all columns without another role)",
        },
        "joint": {
            "action": "append",
            "metavar": "NAME",
            "type": str,
            "help": "a column of joint angles in radians, or in degrees if its name ends in _deg "
            "or (deg); repeat the option, or give one regular expression",
        },
        "time": {"metavar": "NAME", "type": str, "help": "the time column (default: time)"},
        "time_unit": {
            "metavar": "UNIT",
            "type": str,
            "help": "unit of the time column: s, ms, us, ns, min, h or d",
        },
        "label": {"metavar": "NAME", "type": str, "help": "the label column"},
        "extra": {
            "action": "append",
            "metavar": "NAME",
            "type": str,
            "help": "a column of numbers other than readings, such as a force",
        },
        "ignore": {"action": "append", "metavar": "NAME", "type": str, "help": "a column to skip"},
        "unit": {"metavar": "UNIT", "type": str, "help": "unit of the readings: count or newton"},
    },
    "text of CSV files": {
        "separator": {
            "metavar": "SIGN",
            "type": str,
            "help": "the sign between two cells: one character, or comma, semicolon, tab, blank "
            "(default: the sign in the first line)",
        },
        "decimal": {"metavar": "SIGN", "type": str, "help": "the decimal sign: . or ,"},
        "encoding": {
            "metavar": "NAME",
            "type": str,
            "help": "the encoding of the text, such as cp1252 or utf-16 (default: UTF-8)",
        },
        "preamble": {
            "metavar": "N",
            "type": not_negative,
            "help": "number of lines before the header",
        },
        "unit_row": {
            "action": "store_true",
            "help": "the line after the header holds units",
        },
        "time_format": {
            "metavar": "FORMAT",
            "type": str,
            "help": "format of dates, such as '%%d.%%m.%%Y %%H:%%M:%%S,%%f' (not needed for "
            "numbers, ISO 8601 and 10:00:00.25)",
        },
        "missing": {
            "action": "append",
            "metavar": "VALUE",
            "type": str,
            "help": "a text or number that marks a missing reading, such as NA or -1; may be "
            "repeated",
        },
    },
    "CSV files without column names": {
        "num_taxels": {"type": positive, "metavar": "N", "help": "number of taxels"},
        "num_channels": {"type": positive, "metavar": "C", "help": "channels per taxel"},
        "num_joints": {"type": not_negative, "metavar": "J", "help": "number of joints"},
        "header": {"action": "store_false", "help": "treat the first line as data"},
        "rate": {
            "metavar": "HZ",
            "type": float,
            "help": "frames per second, for files without a time column",
        },
    },
}


def add_reading_options(parser: argparse.ArgumentParser) -> None:
    r"""Adds the options of the readers of recordings."""
    for title, options in _OPTIONS.items():
        group = parser if title is None else parser.add_argument_group(title)
        for name, settings in options.items():
            flag = "no-header" if name == "header" else name.replace("_", "-")
            group.add_argument(f"--{flag}", dest=name, default=None, **settings)


def reading_options(arguments: argparse.Namespace) -> dict[str, Any]:
    r"""Returns the options present on the command line as keyword arguments of
    :func:`~torch_geometric_tactile.io.read_recording`.
    """
    names = [name for group_options in _OPTIONS.values() for name in group_options]
    values = {name: getattr(arguments, name) for name in names}
    options = {name: value for name, value in values.items() if value is not None}
    for name in ("tactile", "joint"):
        if len(options.get(name, ())) == 1:  # the reader expects a pattern as a single text
            options[name] = options[name][0]
    return options
