r"""``tactile ports``: the serial ports of this machine."""

import argparse
import json

HELP = "list the serial ports of this machine"
DESCRIPTION = """\
Lists the serial ports of this machine: path, USB vendor and product (VID:PID), serial number
and description. A tactile sensor is read as serial:PATH?protocol=NAME.
"""
EXAMPLES = """\
examples:
  tactile ports                                  a line a port
  tactile ports --json                           for programs
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    r"""Adds the arguments of the verb.

    Args:
        parser (argparse.ArgumentParser): The parser of the verb.
    """
    parser.add_argument("--json", action="store_true", help="print a JSON list")


def run(arguments: argparse.Namespace) -> int:
    r"""Runs the verb and returns the exit status.

    Args:
        arguments (argparse.Namespace): The arguments.
    """
    from dataclasses import asdict

    from torch_geometric_tactile.live import list_ports
    from torch_geometric_tactile.texts import printable

    ports = list_ports()
    if arguments.json:
        print(json.dumps([asdict(port) for port in ports], indent=1))
    elif not ports:
        print("there is no serial port on this machine")
    else:
        for port in ports:
            print(printable(port))
    return 0
