r"""The tables of the papers, by name."""

from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any

import yaml

from torch_geometric_tactile.experiments.tables import Table, read_table, table_of


@cache
def _content() -> dict[str, dict[str, Any]]:
    path = files("torch_geometric_tactile.papers") / "tables.yaml"
    content: dict[str, dict[str, Any]] = yaml.safe_load(path.read_text(encoding="utf-8"))["tables"]
    return content


def table_names() -> list[str]:
    r"""Returns the names of the shipped tables."""
    return list(_content())


def load_table(name: str) -> Table:
    r"""Returns a shipped table, or one that a user wrote.

    Args:
        name (str): Its name, such as :obj:`"p1-table2"`, or the path of a YAML file.

    Raises:
        ValueError: If there is no such table, and the message lists those there are; or the file
            is not as described on the page on experiments.
    """
    if name in _content():
        return table_of(name, _content()[name])
    if Path(name).suffix not in (".yaml", ".yml"):
        raise ValueError(
            f"'name' must be one of {table_names()}, or a file that ends with .yaml (got '{name}')"
        )
    return read_table(name)
