r"""The configurations shipped with the package."""

from importlib.resources import files
from pathlib import Path
from typing import Any

import yaml


def config_names() -> list[str]:
    r"""Returns the names of the shipped configurations."""
    return sorted(
        entry.name.removesuffix(".yaml")
        for entry in files("torch_geometric_tactile.configs").iterdir()
        if entry.name.endswith(".yaml")
    )


def find_config(name: str) -> Path:
    r"""Returns the path of a configuration: a file, or a shipped one by its name.

    Args:
        name (str): Path of a file, or name of a shipped configuration.

    Raises:
        FileNotFoundError: If there is neither; the message lists the shipped ones.
    """
    path = Path(name)
    if path.is_file():
        return path
    shipped = Path(str(files("torch_geometric_tactile.configs"))) / f"{name}.yaml"
    if shipped.is_file():
        return shipped
    raise FileNotFoundError(
        f"there is no file '{name}' and no configuration of that name; shipped are: "
        f"{', '.join(config_names())}"
    )


def load_config(name: str) -> dict[str, Any]:
    r"""Reads a configuration.

    Args:
        name (str): Path of a file, or name of a shipped configuration.
    """
    content: dict[str, Any] = yaml.safe_load(find_config(name).read_text(encoding="utf-8"))
    return content
