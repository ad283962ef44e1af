r"""Imports the user's modules, including modules in the working directory."""

import importlib
import sys
from collections.abc import Iterable
from pathlib import Path
from types import ModuleType


def import_user_module(name: str) -> ModuleType:
    r"""Imports an installed module, or a module in the working directory, by its name.

    The working directory is searched only if the name was not found elsewhere, so that its files
    never shadow installed modules.

    Args:
        name (str): Name of the module, such as :obj:`"my_nets"`.

    Raises:
        ImportError: If the module does not exist or cannot be imported.
    """
    try:
        return importlib.import_module(name)
    except ModuleNotFoundError as error:
        if error.name != name.partition(".")[0]:
            raise
    add_working_directory()
    return importlib.import_module(name)


def add_working_directory() -> None:
    r"""Appends the working directory to the search path of modules."""
    append_to_search_path([str(Path.cwd())])


def append_to_search_path(folders: Iterable[str]) -> None:
    r"""Appends missing folders to the search path of modules."""
    sys.path += [folder for folder in folders if folder not in sys.path]
    importlib.invalidate_caches()
