r"""The ``tactile`` command. Nothing heavy is imported before the arguments are known."""

import argparse
import io
import logging
import os
import select
import sys
from collections.abc import Sequence
from contextlib import suppress
from importlib import import_module
from types import ModuleType
from typing import Any

from torch_geometric_tactile import __version__
from torch_geometric_tactile.commands import VERBS
from torch_geometric_tactile.texts import printable

_EXAMPLES = """\
examples:
  tactile demo                                   from data to a judged model and a report
  tactile fit --config grasp_gcn_df              train GCN-DF on the BioTac SP stability set
  tactile fit --config grasp_gcn_df --ckpt_path runs/grasp_gcn_df/version_0/checkpoints/last.ckpt
                                                 go on where that training was stopped
  tactile test --config grasp_gcn_df --ckpt_path CHECKPOINT
  tactile fit --help                             every option of fit
  tactile predict CHECKPOINT recording.h5        probabilities of each frame, as a CSV table
  tactile export CHECKPOINT model.onnx           one graph from readings to label, for a robot
  tactile analyze CHECKPOINT --out analysis      what a checkpoint has learnt, in pictures
  tactile inspect recording.h5                   the facts of a recording, and a picture of it
  tactile convert messages.jsonl recording.h5    another format, by the suffix
  tactile convert bigs grasps/*.h5 bigs/         grasps of the BiGS data set, see its own --help
  tactile simulate --out grasps --trials 2 --preview
                                                 grasps of a simulated Allegro hand, with pictures
  tactile ports                                  the serial ports that there are
  tactile live ws://127.0.0.1:5000 --model model.onnx --view
                                                 a sensor: judged, shown, and recorded if wanted
  tactile view grasp.h5                          a recording or a sensor, in the browser
  tactile record ws://127.0.0.1:5000 grasp.mcap  what a sensor sends, until Ctrl-C
  tactile replay grasp.mcap --serve ws           a double of XELA's server, of a recording
  tactile compare touches.npz --grid 28x50       which model to take for data of your own
  tactile table p1-table2 --root grasps          the models of a paper, beside its published numbers

Data sets are read from $TACTILE_DATA (a folder with one folder for each data set), or
from a folder in the user's cache, where they are downloaded if missing.
"""


def build_parser() -> argparse.ArgumentParser:
    r"""Returns the parser of the command line."""
    parser = argparse.ArgumentParser(
        prog="tactile",
        description="Machine learning on robot touch with PyTorch Geometric.",
        epilog=_EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="version", version=f"tactile {__version__}")
    commands = parser.add_subparsers(dest="command", metavar="COMMAND", required=True)
    for name in VERBS:
        verb = _verb(name)
        if hasattr(verb, "run_raw"):
            commands.add_parser(name, help=verb.HELP, add_help=False)
            continue
        verb.add_arguments(commands.add_parser(name, help=verb.HELP, **_texts(verb)))
    return parser


def _texts(verb: ModuleType) -> dict[str, Any]:
    return {
        "description": verb.DESCRIPTION,
        "epilog": verb.EXAMPLES,
        "formatter_class": argparse.RawDescriptionHelpFormatter,
    }


def _verb(name: str) -> ModuleType:
    return import_module(f"torch_geometric_tactile.commands.{name}")


def _run(argv: list[str]) -> int:
    if argv and argv[0] in VERBS and hasattr(_verb(argv[0]), "run_raw"):
        return int(_verb(argv[0]).run_raw(argv[1:]))
    kinds = getattr(_verb(argv[0]), "KINDS", {}) if argv and argv[0] in VERBS else {}
    if argv[1:] and argv[1] in kinds:
        kind = _verb(kinds[argv[1]])
        parser = argparse.ArgumentParser(prog=f"tactile {argv[0]} {argv[1]}", **_texts(kind))
        kind.add_arguments(parser)
        return int(kind.run(parser.parse_args(argv[2:])))
    arguments = build_parser().parse_args(argv)
    return int(_verb(arguments.command).run(arguments))


def main(argv: Sequence[str] | None = None) -> int:
    r"""Runs the command line.

    Args:
        argv (list of str, optional): The arguments; those of the process if left out.

    Returns:
        int: The exit status: 0, 1 for an error that was explained, 130 for Ctrl-C.
    """
    if argv is None and isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")  # for names of files that are no text
    if logging.lastResort is not None:  # prints our warnings
        logging.lastResort.setFormatter(_OneLine())
    try:
        status = _run(list(sys.argv[1:] if argv is None else argv))
        if sys.stdout is not None:
            sys.stdout.flush()  # here, where an error can still be explained
        return status
    except (ImportError, MemoryError, OSError, ValueError) as error:
        if isinstance(error, BrokenPipeError) and _is_unread():
            return 0  # the reader of the output, such as `head`, has what it wanted
        if os.environ.get("TACTILE_TRACEBACK"):
            raise
        text = "not enough memory" if isinstance(error, MemoryError) else str(error)
        _tell(f"error: {text or type(error).__name__}")
        return 1
    except KeyboardInterrupt as stop:
        _tell(str(stop) or "stopped")
        return 130


class _OneLine(logging.Formatter):
    def format(self, record: logging.LogRecord) -> str:
        return printable(super().format(record))


def _tell(text: str) -> None:
    # One line, whatever a file or a name put into it.
    hint = "(TACTILE_TRACEBACK=1 shows where it came from)\n" if text.startswith("error:") else ""
    with suppress(OSError, ValueError, AttributeError):  # nobody listens any more
        sys.stderr.write(f"tactile: {printable(' '.join(text.split()))}\n{hint}")


def _is_unread() -> bool:
    # Whether nobody reads the output any more. What is left of it would fail again at the exit.
    try:
        sys.stdout.flush()
        poll = select.poll()
        poll.register(sys.stdout.fileno(), 0)
        gone = any(event & (select.POLLERR | select.POLLHUP) for _, event in poll.poll(0))
    except BrokenPipeError:
        gone = True
    except (AttributeError, OSError, ValueError):  # no output, a full disk, or no pipe (Windows)
        gone = False
    if gone:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    return gone
