"""Runs the code blocks of a Markdown page as its reader would, in order and in one folder."""

import argparse
import ast
import re
import shlex
import subprocess
import sys
import tomllib
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path

from torch_geometric_tactile.cli import build_parser, main
from torch_geometric_tactile.commands import COMMANDS

ROOT = Path(__file__).parents[1]
SECTIONS = ("start", "data", "models", "evaluation", "papers", "robot", "about", "reference")
FOLDERS = ("docs", "docs/results", *(f"docs/{section}" for section in SECTIONS))
_BLOCK = re.compile(
    r"(?:^<!-- not run: (?P<reason>[^\n]*?) -->\n+)?^(?P<fence>`{3,})(?P<language>[\w{}-]*)[^\n]*\n"
    r"(?P<code>.*?)^(?P=fence) *$",
    flags=re.DOTALL | re.MULTILINE,
)
_MARKER = re.compile(r"<!-- *not run")
_FILE = re.compile(r"`([\w./-]+)`:\s*$")
_CONFIGURATION = "grasp_gcn_df"  # in place of a configuration that the reader writes
_RAW = ("fit", "validate", "test")  # verbs whose arguments Lightning reads
_NEVER = ("pip", "make", "git", "ssh", "cd", "export", "colcon", "ros2", "conda", "source", ".")
_NEVER += ("huggingface-cli", "lerobot-train")


@dataclass(frozen=True)
class Block:
    """A block of code, the number of its first line, and why it is not run."""

    language: str
    code: str
    line: int
    reason: str | None
    file: str | None  # what the sentence before a block of YAML calls it


def all_pages():
    """All pages that are written by hand, by their path from the root."""
    paths = [ROOT / "README.md", ROOT / "CONTRIBUTING.md"]
    for folder in FOLDERS:
        paths += sorted((ROOT / folder).glob("*.md"))
    return [path.relative_to(ROOT).as_posix() for path in paths]


def pages():
    """Those that have code."""
    return [name for name in all_pages() if blocks_of(ROOT / name)]


def blocks_of(path):
    """The Python, shell and YAML blocks of a page, in order."""
    text = Path(path).read_text(encoding="utf-8")
    found = []
    for match in _BLOCK.finditer(text):
        if match["language"] in ("python", "sh", "yaml"):
            line = text.count("\n", 0, match.start("code")) + 1
            before = _FILE.search(text[: match.start()])
            file = before[1] if before and match["language"] == "yaml" else None
            found.append(Block(match["language"], match["code"], line, match["reason"], file))
    return found


def prose_of(path):
    """The text of a page without its blocks of code."""
    return _BLOCK.sub("", Path(path).read_text(encoding="utf-8"))


def dangling_markers(path):
    """The lines of markers that no block follows."""
    text = Path(path).read_text(encoding="utf-8")
    used = sum(block.reason is not None for block in blocks_of(path))
    lines = [text.count("\n", 0, match.start()) + 1 for match in _MARKER.finditer(text)]
    return [] if len(lines) == used else lines


def run_page(path, names):
    """Runs the blocks of a page in the working directory; blocks that are not run are checked."""
    for block in blocks_of(path):
        try:
            run_block(path, block, names)
        except BaseException as error:
            error.add_note(f"in the block at line {block.line} of {path}")
            raise


def run_block(path, block, names):
    """Runs or checks one block."""
    if block.language == "yaml":
        if block.file is not None:
            Path(block.file).write_text(block.code, encoding="utf-8")
    elif block.language == "python":
        tree = ast.parse(block.code)
        if block.reason is not None:
            check_imports(tree)
            return
        # The lines of the page, for tracebacks.
        exec(compile("\n" * (block.line - 1) + block.code, str(path), "exec"), names)
    else:
        for words in commands(block.code):
            (run_command if block.reason is None else check_command)(words)


def check_imports(tree):
    """Checks that what a block imports from this package is there."""
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith(
            "torch_geometric_tactile"
        ):
            module = import_module(node.module)
            for alias in node.names:
                assert hasattr(module, alias.name), f"'{node.module}' has no '{alias.name}'"


def commands(code):
    """The words of each command of a shell block."""
    lines = code.replace("\\\n", " ").splitlines()
    found = [words for line in lines if (words := shlex.split(line, comments=True))]
    return [words[: words.index(">")] if ">" in words else words for words in found]


def run_command(words):
    """Runs a command of the page in this process."""
    if words[0] == "tactile":
        try:
            status = main(_expanded(words[1:]))
        except SystemExit as stop:  # such as of --help
            status = stop.code
        assert not status, f"{words} failed"
    elif words[:2] == ["python", "-c"]:
        subprocess.run([sys.executable, *words[1:]], check=True)
    else:
        raise AssertionError(f"{words} cannot be run: mark the block '<!-- not run: reason -->'")


def _expanded(words):
    return [
        name
        for word in words
        for name in (sorted(map(str, Path().glob(word))) if "*." in word else None) or [word]
    ]


def check_command(words):
    """Checks that a command of the page exists, with its options and the files of the repository.

    Raises:
        AssertionError: If a verb, option, target, script or extra does not exist.
    """
    if words[0] == "tactile":
        check_tactile(words[1:])
    elif words[0] == "make":
        targets = re.findall(r"^([\w-]+):", (ROOT / "Makefile").read_text(), flags=re.MULTILINE)
        assert set(words[1:]) <= set(targets), f"{words}: the targets are {targets}"
    elif words[0] in ("python", ".venv/bin/python") and words[1].endswith(".py"):
        assert (ROOT / words[1]).is_file(), f"there is no {words[1]}"
    elif words[0] == "pip":
        check_extras(words)
    else:
        is_module = words[0].startswith("python") and words[1] in ("-m", "-c")
        known = words[0] in _NEVER or is_module
        assert known, f"{words[0]!r} is no command that pages use"


def check_extras(words):
    """Checks the extras of this package in an installation."""
    known = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    for word in words:
        match = re.search(r"(?:^\.|tactile)\[([\w,]+)\]", word)
        missing = set(match[1].split(",")) - set(known) if match else set()
        assert not missing, f"no extra {sorted(missing)} (got {sorted(known)})"


def check_tactile(words):
    """Checks a verb and its options, without running it."""
    if words[0].startswith("-"):
        _parse(build_parser(), words)
        return
    assert words[0] in COMMANDS, f"'tactile {words[0]}' does not exist"
    if words[0] in _RAW:
        _check_lightning(words)
        return
    kinds = getattr(import_module(f"torch_geometric_tactile.commands.{words[0]}"), "KINDS", {})
    if len(words) > 1 and words[1] in kinds:
        parser = argparse.ArgumentParser()
        import_module(f"torch_geometric_tactile.commands.{kinds[words[1]]}").add_arguments(parser)
        _parse(parser, words[2:])
    else:
        _parse(build_parser(), words)


def _parse(parser, words):
    try:
        parser.parse_args(words)
    except SystemExit as stop:
        if stop.code:
            raise AssertionError(f"'tactile {shlex.join(words)}' is refused") from stop


def _check_lightning(words):
    # Printing a configuration reads and checks all options, and trains nothing.
    place = words.index("--config") + 1
    is_file = words[place].endswith(".yaml") and not Path(words[place]).is_file()
    words = [*words[:place], _CONFIGURATION if is_file else words[place], *words[place + 1 :]]
    words = [word for word in words if not word.startswith("--print_config")]
    if "--ckpt_path" in words:
        del words[words.index("--ckpt_path") : words.index("--ckpt_path") + 2]
    try:
        status = main([*words, "--print_config"])
    except SystemExit as stop:
        status = stop.code
    assert not status, f"'tactile {shlex.join(words)}' is refused"
