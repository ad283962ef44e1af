r"""Modules of the user that are named by an import path."""

import importlib
import sys
from collections.abc import Iterable
from pathlib import Path
from types import ModuleType


def import_own(name: str) -> ModuleType:
    r"""Imports a module by its name: an installed one, or one of the working directory.

    The working directory is searched last, and only after the name was not found elsewhere, so that
    a file in it never takes the place of an installed module.

    Args:
        name (str): Name of the module, such as :obj:`"my_nets"`.

    Raises:
        ImportError: If there is no such module, or it cannot be imported.
    """
    try:
        return importlib.import_module(name)
    except ModuleNotFoundError as error:
        if error.name != name.partition(".")[0]:
            raise
    find_own_modules()
    return importlib.import_module(name)


def find_own_modules() -> None:
    r"""Lets modules of the working directory be imported, behind all others."""
    append_to_search_path([str(Path.cwd())])


def append_to_search_path(folders: Iterable[str]) -> None:
    r"""Appends folders to the search path of modules."""
    sys.path += [folder for folder in folders if folder not in sys.path]
    importlib.invalidate_caches()
