r"""``tactile ports``: lists the serial ports of this machine."""

import argparse
import json

HELP = "List the serial ports of this machine"
DESCRIPTION = """\
Lists the serial ports of this machine: path, USB vendor and product (VID:PID), serial number
and description. Read a tactile sensor at one of them as "serial:PATH?protocol=NAME", or as
serial:PATH if it sends lines of numbers.
"""
EXAMPLES = """\
examples:
  tactile ports                                  one line per port
  tactile ports --json                           for programs
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    r"""Adds the arguments of the command to a parser."""
    parser.add_argument("--json", action="store_true", help="print JSON")


def run(arguments: argparse.Namespace) -> int:
    r"""Runs the command and returns the exit status."""
    from dataclasses import asdict

    from torch_geometric_tactile._texts import printable
    from torch_geometric_tactile.live._serial_port import list_ports

    ports = list_ports()
    if arguments.json:
        print(json.dumps([asdict(port) for port in ports], indent=1))
    elif not ports:
        print("no serial ports found")
    else:
        for port in ports:
            print(printable(port))
    return 0
