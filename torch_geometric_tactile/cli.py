r"""The ``tactile`` command. Large packages are imported only after the arguments are parsed."""

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
from torch_geometric_tactile._checks import GroupedError
from torch_geometric_tactile._removed import removal_message
from torch_geometric_tactile._texts import printable
from torch_geometric_tactile.commands import COMMANDS
from torch_geometric_tactile.commands._paths import check_paths

_MAX_LISTED_ERRORS = 20

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

'tactile COMMAND --help' shows the options and more examples.

Data sets are read from $TACTILE_DATA, which has one folder per data set. If it is not set, they
are downloaded to a folder in the user's cache.
"""


def _is_installed_example(line: str) -> bool:
    words = line.split()
    return words[:1] != ["tactile"] or words[1] in COMMANDS


def build_parser() -> argparse.ArgumentParser:
    r"""Returns the parser of the command line."""
    parser = argparse.ArgumentParser(
        prog="tactile",
        description="Machine learning for robot touch with PyTorch Geometric.",
        epilog="\n".join(line for line in _EXAMPLES.split("\n") if _is_installed_example(line)),
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="version", version=f"tactile {__version__}")
    commands = parser.add_subparsers(dest="command", metavar="COMMAND", required=True)
    for name in COMMANDS:
        command = _load_command(name)
        if hasattr(command, "run_raw"):
            commands.add_parser(name, help=command.HELP, add_help=False)
            continue
        command.add_arguments(
            commands.add_parser(name, help=command.HELP, **_parser_texts(command))
        )
    return parser


def _parser_texts(command: ModuleType) -> dict[str, Any]:
    return {
        "description": command.DESCRIPTION,
        "epilog": command.EXAMPLES,
        "formatter_class": argparse.RawDescriptionHelpFormatter,
    }


def _load_command(name: str) -> ModuleType:
    return import_module(f"torch_geometric_tactile.commands.{name}")


def _run(argv: list[str]) -> int:
    if argv and argv[0] in COMMANDS and hasattr(_load_command(argv[0]), "run_raw"):
        return int(_load_command(argv[0]).run_raw(argv[1:]))
    if not argv or argv[0] not in COMMANDS:
        parser = build_parser()
        _check_removed(parser, argv[:1])
        parser.parse_args(argv)  # help, the version, or an error
    command_words, command = argv[:1], _load_command(argv[0])
    if argv[1:] and argv[1] in getattr(command, "KINDS", {}):
        command_words, command = argv[:2], _load_command(command.KINDS[argv[1]])
    parser = argparse.ArgumentParser(
        prog=" ".join(["tactile", *command_words]), **_parser_texts(command)
    )
    command.add_arguments(parser)
    _check_removed(parser, argv)
    arguments = parser.parse_args(argv[len(command_words) :])
    return int(command.run(check_paths(arguments, getattr(command, "list_outputs", None))))


def _check_removed(parser: argparse.ArgumentParser, argv: list[str]) -> None:
    options = [f"{argv[0]} {word.partition('=')[0]}" for word in argv[1:]]
    for name in (*argv[:1], *options):
        if message := removal_message(f"tactile {name}"):
            parser.error(message)


def main(argv: Sequence[str] | None = None) -> int:
    r"""Runs the command line and returns its exit status."""
    if argv is None and isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")  # file names may be invalid text
    if (
        logging.lastResort is not None
    ):  # shows warnings, and notes that reading a data set takes a long time
        logging.lastResort.setFormatter(_SingleLineFormatter())
        logging.lastResort.setLevel(logging.INFO)
        logging.getLogger("torch_geometric_tactile.datasets").setLevel(logging.INFO)
    try:
        status = _run(list(sys.argv[1:] if argv is None else argv))
        if sys.stdout is not None:
            sys.stdout.flush()  # at exit, an error of the output would be a traceback
        return status
    except (ImportError, MemoryError, OSError, ValueError) as error:
        if isinstance(error, BrokenPipeError) and _is_output_closed():
            return 0  # the reader of the output, such as `head`, has closed the pipe
        if os.environ.get("TACTILE_TRACEBACK"):
            raise
        if isinstance(error, GroupedError):
            _print_error(f"error: {error.summary}:", [str(item) for item in error.errors])
            return 1
        message = "not enough memory" if isinstance(error, MemoryError) else str(error)
        if isinstance(error, ModuleNotFoundError):
            message = _missing_package_text(error, sys.argv[1:] if argv is None else argv)
        _print_error(f"error: {message or type(error).__name__}")
        return 1
    except KeyboardInterrupt as stop:
        _print_error(str(stop) or "stopped")
        return 130


def _missing_package_text(error: ModuleNotFoundError, argv: Sequence[str]) -> str:
    if error.name and error.name.startswith("torch_geometric_tactile."):
        return (
            f"'{error.name}' is not in tactile-live: pip install \"torch-geometric-tactile[live]\""
        )
    extras = (
        getattr(_load_command(argv[0]), "EXTRAS", None) if argv and argv[0] in COMMANDS else None
    )
    if extras is None or ("pip install" in str(error) and "[train]" not in str(error)):
        return str(error)
    return (
        f"'tactile {argv[0]}' needs the package '{error.name}': "
        f'pip install "torch-geometric-tactile[{extras}]"'
    )


class _SingleLineFormatter(logging.Formatter):
    def format(self, record: logging.LogRecord) -> str:
        return printable(super().format(record))


def _print_error(text: str, items: Sequence[str] = ()) -> None:
    # Prints the text and each item on one line, because names of files may contain line breaks.
    hint = "(set TACTILE_TRACEBACK=1 for the traceback)\n" if text.startswith("error:") else ""
    lines = [f"tactile: {text}", *(f"- {item}" for item in items[:_MAX_LISTED_ERRORS])]
    if len(items) > _MAX_LISTED_ERRORS:
        lines.append(f"- and {len(items) - _MAX_LISTED_ERRORS} more")
    with suppress(OSError, ValueError, AttributeError):  # the error output is closed
        sys.stderr.write("".join(f"{printable(' '.join(line.split()))}\n" for line in lines) + hint)


def _is_output_closed() -> bool:
    # If the output is closed, redirects it, because flushing its buffer at exit would fail again.
    try:
        sys.stdout.flush()
        poll = select.poll()
        poll.register(sys.stdout.fileno(), 0)
        is_closed = any(event & (select.POLLERR | select.POLLHUP) for _, event in poll.poll(0))
    except BrokenPipeError:
        is_closed = True
    except (AttributeError, OSError, ValueError):  # no output, a full disk, or no pipe (Windows)
        is_closed = False
    if is_closed:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    return is_closed
