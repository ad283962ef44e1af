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
from torch_geometric_tactile._removed import removal_message
from torch_geometric_tactile._texts import printable
from torch_geometric_tactile.commands import VERBS
from torch_geometric_tactile.commands._paths import check_paths

_EXAMPLES = """\
examples:
  tactile demo                                   compare models on real grasps
  tactile inspect recording.h5                   summarise and plot a recording
  tactile compare touches.npz --grid 28x50       find the best model for your data
  tactile fit --config grasp_gcn_df              train one model
  tactile predict CHECKPOINT recording.h5        write predictions to a CSV table
  tactile export CHECKPOINT model.onnx           one file for a robot, without PyTorch
  tactile live ws://127.0.0.1:5000 --model model.onnx --view
                                                 run it on a live sensor

'tactile COMMAND --help' has the options and more examples.

Data sets are read from $TACTILE_DATA (with one folder per data set), or else from a folder in
the user's cache, where missing ones are downloaded.
"""


def _is_installed(line: str) -> bool:
    words = line.split()
    return words[:1] != ["tactile"] or words[1] in VERBS


def build_parser() -> argparse.ArgumentParser:
    r"""Returns the parser of the command line."""
    parser = argparse.ArgumentParser(
        prog="tactile",
        description="Machine learning on robot touch with PyTorch Geometric.",
        epilog="\n".join(line for line in _EXAMPLES.split("\n") if _is_installed(line)),
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
    if not argv or argv[0] not in VERBS:
        parser = build_parser()
        _check_removed(parser, argv[:1])
        parser.parse_args(argv)  # help, the version, or an error
    words, verb = argv[:1], _verb(argv[0])
    if argv[1:] and argv[1] in getattr(verb, "KINDS", {}):
        words, verb = argv[:2], _verb(verb.KINDS[argv[1]])
    parser = argparse.ArgumentParser(prog=" ".join(["tactile", *words]), **_texts(verb))
    verb.add_arguments(parser)
    _check_removed(parser, argv)
    arguments = parser.parse_args(argv[len(words) :])
    return int(verb.run(check_paths(arguments, getattr(verb, "list_outputs", None))))


def _check_removed(parser: argparse.ArgumentParser, argv: list[str]) -> None:
    options = [f"{argv[0]} {word.partition('=')[0]}" for word in argv[1:]]
    for name in (*argv[:1], *options):
        if message := removal_message(f"tactile {name}"):
            parser.error(message)


def main(argv: Sequence[str] | None = None) -> int:
    r"""Runs the command line."""
    if argv is None and isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")  # for file names that are not valid text
    if logging.lastResort is not None:  # prints warnings, and that a data set takes long to read
        logging.lastResort.setFormatter(_OneLine())
        logging.lastResort.setLevel(logging.INFO)
        logging.getLogger("torch_geometric_tactile.datasets").setLevel(logging.INFO)
    try:
        status = _run(list(sys.argv[1:] if argv is None else argv))
        if sys.stdout is not None:
            sys.stdout.flush()  # here, where an error can still be explained
        return status
    except (ImportError, MemoryError, OSError, ValueError) as error:
        if isinstance(error, BrokenPipeError) and _is_unread():
            return 0  # the reader of the output, such as `head`, has closed it
        if os.environ.get("TACTILE_TRACEBACK"):
            raise
        text = "not enough memory" if isinstance(error, MemoryError) else str(error)
        if isinstance(error, ModuleNotFoundError):
            text = _with_pip_line(error, sys.argv[1:] if argv is None else argv)
        _tell(f"error: {text or type(error).__name__}")
        return 1
    except KeyboardInterrupt as stop:
        _tell(str(stop) or "stopped")
        return 130


def _with_pip_line(error: ModuleNotFoundError, argv: Sequence[str]) -> str:
    if error.name and error.name.startswith("torch_geometric_tactile."):
        return (
            f"'{error.name}' is not in tactile-live: pip install \"torch-geometric-tactile[live]\""
        )
    extras = getattr(_verb(argv[0]), "EXTRAS", None) if argv and argv[0] in VERBS else None
    if extras is None or ("pip install" in str(error) and "[train]" not in str(error)):
        return str(error)
    return (
        f"'tactile {argv[0]}' needs the package '{error.name}': "
        f'pip install "torch-geometric-tactile[{extras}]"'
    )


class _OneLine(logging.Formatter):
    def format(self, record: logging.LogRecord) -> str:
        return printable(super().format(record))


def _tell(text: str) -> None:
    # One line, whatever a file or a name put into it.
    hint = "(set TACTILE_TRACEBACK=1 for the traceback)\n" if text.startswith("error:") else ""
    with suppress(OSError, ValueError, AttributeError):  # the error output is closed
        sys.stderr.write(f"tactile: {printable(' '.join(text.split()))}\n{hint}")


def _is_unread() -> bool:
    # Whether the output is closed. Flushing the rest would fail again at exit.
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
