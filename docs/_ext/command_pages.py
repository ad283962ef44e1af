"""Writes the page of the command line from the help texts of its verbs."""

import contextlib
import io
import os
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from typing import Any

from repository_links import write_if_changed
from sphinx.application import Sphinx

_WIDTH = "84"
_LONG = 120  # lines of a help text that is folded away
_INTRO = """\
# Commands

What `tactile COMMAND --help` prints, for every command. The guide is
[The command line](../command_line.md).

"""


def command_help(*words: str) -> str:
    """Returns what a command prints with `--help`.

    Args:
        *words (str): The command, such as `"fit"`.
    """
    from torch_geometric_tactile.cli import main

    output = io.StringIO()
    with _environment(COLUMNS=_WIDTH, NO_COLOR="1"), contextlib.redirect_stdout(output):
        try:
            main([*words, "--help"])
        except SystemExit as stop:
            if stop.code:
                raise RuntimeError(f"'tactile {' '.join(words)} --help' fails") from stop
    return output.getvalue()


@contextlib.contextmanager
def _environment(**values: str) -> Iterator[None]:
    before = dict(os.environ)
    os.environ.update(values)
    try:
        yield
    finally:
        os.environ.clear()
        os.environ.update(before)


def _commands() -> Iterator[tuple[tuple[str, ...], str]]:
    from torch_geometric_tactile.commands import COMMANDS

    for name in COMMANDS:
        verb = import_module(f"torch_geometric_tactile.commands.{name}")
        yield (name,), verb.HELP
        for word, module in getattr(verb, "KINDS", {}).items():
            kind = import_module(f"torch_geometric_tactile.commands.{module}")
            yield (name, word), kind.HELP


def commands_page() -> str:
    """Returns the page as Markdown."""
    parts = [_INTRO]
    for words, summary in _commands():
        text = command_help(*words).strip("\n")
        block = f"```text\n{text}\n```\n"
        if text.count("\n") > _LONG:
            block = f"::::{{dropdown}} All options\n{block}::::\n"
        title = " ".join(words)
        parts.append(f"## tactile {title}\n\n{summary[0].upper()}{summary[1:]}.\n\n{block}\n")
    return "".join(parts)


def setup(app: Sphinx) -> dict[str, Any]:
    """Writes the page before Sphinx looks for it."""
    page = Path(app.srcdir) / "generated" / "commands.md"
    app.connect("config-inited", lambda app, config: write_if_changed(page, commands_page()))
    return {"parallel_read_safe": True, "parallel_write_safe": True}
