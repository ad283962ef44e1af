"""What a command line says it reads and writes, without running it."""

import argparse
from importlib import import_module

from torch_geometric_tactile.commands import COMMANDS

PACKAGE = "torch_geometric_tactile.commands"


def command_modules():
    """The modules of the commands that argparse reads, by what users type."""
    modules = {name: import_module(f"{PACKAGE}.{name}") for name in COMMANDS}
    for name, module in [*modules.items()]:
        for word, kind in getattr(module, "KINDS", {}).items():
            modules[f"{name} {word}"] = import_module(f"{PACKAGE}.{kind}")
    return {name: m for name, m in modules.items() if not hasattr(m, "run_raw")}


def parser_of(module):
    parser = argparse.ArgumentParser()
    module.add_arguments(parser)
    return parser


def listed_outputs(argv):
    """The files that a command line says it writes, within folders too."""
    module = import_module(f"{PACKAGE}.{argv[0]}")
    return module.list_outputs(parser_of(module).parse_args([str(word) for word in argv[1:]]))


def check_listed(argv, folder, but=()):
    """Every file directly in a folder, but those of some suffixes, was listed and is told by its
    content.
    """
    kinds = {str(output): output.kind for output in listed_outputs(argv)}
    files = [path for path in folder.iterdir() if path.is_file() and path.suffix not in but]
    assert files
    for path in files:
        assert str(path) in kinds, f"{path} is written and not listed"
        assert kinds[str(path)].matches(path), f"{path} is not told to be {kinds[str(path)].name}"
