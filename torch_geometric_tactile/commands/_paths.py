r"""Types of arguments that name files, and a check that protects inputs and files of other kinds
from being overwritten.

A command declares each argument by its :mod:`argparse` type: :func:`input_path`,
:func:`input_setting`, :func:`input_source`, :class:`OutputFile` or :class:`OutputFolder`, or
:class:`str` for a text that is not a path. :func:`check_paths` runs before the command.
"""

import argparse
import os
import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import unquote

from torch_geometric_tactile._checks import need
from torch_geometric_tactile.commands._file_kinds import RECORDING, FileKind

# Suffixes of files that data sets of recordings read.
_RECORDING_SUFFIXES = (
    ".h5",
    ".hdf5",
    ".npz",
    ".mcap",
    ".csv",
    ".json",
    ".jsonl",
    ".ndjson",
    ".txt",
)


class InputPath(str):
    r"""A text that names a file or folder to read, or something else, such as a shipped layout."""

    path: str

    def __new__(cls, text: str, path: str) -> "InputPath":
        r"""Returns the text of an argument with the path that it contains."""
        instance = super().__new__(cls, text)
        instance.path = path
        return instance


class OutputPath(str):
    r"""The path of a file, or of a folder with files, that a command writes."""

    argument: str
    kind: FileKind | None  # None: a folder

    def __new__(cls, path: str, argument: str, kind: FileKind | None) -> "OutputPath":
        r"""Returns a path with the argument that names it and the kind of the file."""
        instance = super().__new__(cls, path)
        instance.argument, instance.kind = argument, kind
        return instance


def input_path(text: str) -> InputPath:
    r"""Reads an argument that may name a file or folder to read."""
    path = os.path.expanduser(text)
    return InputPath(path, path)


def input_setting(text: str) -> InputPath:
    r"""Reads an argument :obj:`KEY=VALUE` whose value may name a file or folder to read."""
    key, equals, value = text.partition("=")
    value = os.path.expanduser(value)
    return InputPath(f"{key}{equals}{value}", value)


def input_source(text: str) -> InputPath:
    r"""Reads the address of a source. The address of a recording is its path, or
    :obj:`file:PATH?speed=2`.
    """
    scheme, address = ("file:", text[5:]) if text.startswith("file:") else ("", text)
    address = os.path.expanduser(address)
    path = address if os.path.exists(address) else unquote(address.partition("?")[0])
    return InputPath(scheme + address, path)


@dataclass(frozen=True)
class OutputFile:
    r"""Reads an argument that names the file to write.

    Args:
        argument (str): Name of the argument in messages, such as :obj:`"--out"`.
        kind (FileKind): The kind of the file.
    """

    argument: str
    kind: FileKind

    def __call__(self, text: str) -> OutputPath:
        r"""Returns the path."""
        return OutputPath(os.path.expanduser(text), self.argument, self.kind)


@dataclass(frozen=True)
class OutputFolder:
    r"""Reads an argument that names the folder to write to.

    Args:
        argument (str): Name of the argument in messages, such as :obj:`"--out"`.
    """

    argument: str

    def __call__(self, text: str) -> OutputPath:
        r"""Returns the path."""
        return OutputPath(os.path.expanduser(text), self.argument, None)


def expand_home(argument: str) -> str:
    r"""Returns an argument of a command line, :obj:`PATH` or :obj:`--option=PATH`, with the user's
    home folder in place of :obj:`~`.
    """
    option, equals, value = argument.partition("=")
    if option.startswith("-") and equals:
        return f"{option}={os.path.expanduser(value)}"
    return os.path.expanduser(argument)


def files_in_folder(folder: str, kinds: Mapping[str, FileKind]) -> list[OutputPath]:
    r"""Returns the files that a command writes to a folder, given their names and kinds."""
    argument = getattr(folder, "argument", "--out")
    return [OutputPath(os.path.join(folder, name), argument, kind) for name, kind in kinds.items()]


def check_paths(
    arguments: argparse.Namespace,
    list_outputs: Callable[[argparse.Namespace], Iterable[OutputPath]] | None = None,
) -> argparse.Namespace:
    r"""Checks that the outputs of a command can be written, and that no output replaces an input of
    the command, a file of another kind or a folder.

    Args:
        arguments (argparse.Namespace): The arguments, read by the types of this module.
        list_outputs (callable, optional): Returns further files that the command writes, such as
            files within an output folder.

    Returns:
        The arguments as plain texts.

    Raises:
        ValueError: If an output may not be written; the message names it.
    """
    values = [*_flatten(vars(arguments).values())]
    outputs = [value for value in values if isinstance(value, OutputPath)]
    if list_outputs is not None:
        outputs += list_outputs(arguments)
    if outputs:
        inputs = [Path(v.path) for v in values if isinstance(v, InputPath) and _exists(v.path)]
        inputs += [path for file in inputs for path in _paths_in_configuration(file)]
        for output in outputs:
            _check_output(output, inputs)
    return argparse.Namespace(
        **{name: _paths_to_text(value) for name, value in vars(arguments).items()}
    )


def _flatten(values: Iterable[Any]) -> Iterator[Any]:
    for value in values:
        if isinstance(value, list):
            yield from _flatten(value)
        else:
            yield value


def _paths_to_text(value: Any) -> Any:
    if isinstance(value, list):
        return [_paths_to_text(item) for item in value]
    return str(value) if isinstance(value, InputPath | OutputPath) else value


def _exists(path: str) -> bool:
    try:
        return bool(path) and os.path.exists(path)
    except ValueError:  # a null byte
        return False


def _check_output(output: OutputPath, inputs: Iterable[Path]) -> None:
    path, argument = Path(output), output.argument
    if output.kind is None:
        need(
            not path.exists() or path.is_dir(),
            f"'{argument}' must be a folder (got '{path}', which is a file)",
        )
        _check_writable(path / "file", argument)
        return
    is_new = not path.exists()
    need(
        is_new or path.is_file(),
        f"'{argument}' must be a file (got '{path}', which is a folder, pipe or device)",
    )
    for source in inputs:
        need(
            is_new or not _is_same(path, source),
            f"'{argument}' must not replace an input file: choose another name (got '{path}')",
        )
        is_inside = path.suffix.lower() in _RECORDING_SUFFIXES and _is_same(path.parent, source)
        need(
            not (is_inside and source.is_dir()),
            f"'{argument}' must lie outside of the folder '{source}', whose files are read as "
            f"recordings: choose another folder (got '{path}')",
        )
    need(
        is_new or output.kind.matches(path),
        f"'{argument}' must be a new file, or replace {output.kind.name}: choose another name, or "
        f"remove the file (got '{path}', which is a file of another kind)",
    )
    _check_writable(path, argument)


def _is_same(first: Path, second: Path) -> bool:
    # samefile also recognizes links, and names that differ in case if the file system ignores it.
    try:
        return first.samefile(second)
    except OSError:
        return False


def _check_writable(path: Path, argument: str) -> None:
    # Commands create missing folders, so the nearest existing folder is tested. Only writing a file
    # shows reliably that it is allowed.
    folder = path.absolute().parent
    while not folder.exists() and folder != folder.parent:
        folder = folder.parent
    try:
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise ValueError(
            f"'{argument}' must be in a writable folder (got '{path}': "
            f"{error.strerror} in '{folder}')"
        ) from error


def _paths_in_configuration(path: Path) -> list[Path]:
    # Files and data folders that a configuration, or the configuration beside a checkpoint, names.
    # An unreadable file is reported by the command that reads it.
    if path.suffix == ".ckpt":  # of a run: version_K/checkpoints/last.ckpt
        path = path.absolute().parent.parent / "config.yaml"
    if path.suffix not in (".yaml", ".yml") or not path.is_file():
        return []
    try:
        from torch_geometric_tactile.training._config_files import read_yaml

        content = read_yaml(path)
    except (ImportError, OSError, ValueError):
        return []
    paths = [path]
    pending = [("", content)]
    while pending:
        key, value = pending.pop()
        if isinstance(value, dict):
            pending += [(str(k), v) for k, v in value.items()]
        elif isinstance(value, list):
            pending += [(key, item) for item in value]
        elif isinstance(value, str) and value:
            for folder in (Path(), path.parent):  # paths may be relative to either
                candidate = folder / os.path.expanduser(value)
                if _exists(str(candidate)) and (candidate.is_file() or key == "root"):
                    paths.append(candidate)
    return paths


def recording_file(argument: str) -> OutputFile:
    r"""Returns the argument type of a recording to write."""
    return OutputFile(argument, RECORDING)
