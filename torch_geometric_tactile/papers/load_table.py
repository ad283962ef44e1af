r"""Loads the tables of the papers by name."""

from collections.abc import Iterable, Iterator, Mapping
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any

import yaml

from torch_geometric_tactile._checks import Argument, ArgumentError
from torch_geometric_tactile.experiments.tables import Table, read_table, table_of
from torch_geometric_tactile.training._config_files import expand_template, merged

_CELL_KEYS = ("section", "row", "column", "experiment")  # all other keys are published numbers
_DERIVATION_KEYS = ("like", "arguments", "variants", "template")
_PUBLICATION_KEYS = ("paper", "place")


@cache
def _table_contents() -> dict[str, dict[str, Any]]:
    path = files("torch_geometric_tactile.papers") / "tables.yaml"
    tables: dict[str, dict[str, Any]] = yaml.safe_load(path.read_text(encoding="utf-8"))["tables"]
    return {
        name: _derive_table(content, tables) if "like" in content else content
        for name, content in tables.items()
    }


def _derive_table(changes: dict[str, Any], tables: Mapping[str, dict[str, Any]]) -> dict[str, Any]:
    base = tables[changes["like"]]
    configs = expand_template(base["template"])
    content = {
        key: value for key, value in {**base, **changes}.items() if key not in _DERIVATION_KEYS
    }
    if "variants" in changes:
        content["cells"] = [
            variant
            for cell in base["cells"]
            for variant in _variants(cell, configs[cell["experiment"]], changes["variants"])
        ]
        return content
    # Uses the models of the base table with a different task and different data.
    task, cells = changes.get("task", base["task"]), []
    for cell in base["cells"]:
        config = _with_arguments(configs[cell["experiment"]], changes["arguments"])
        identity = {key: cell[key] for key in _CELL_KEYS}
        cells.append({**identity, "config": merged(config, {"model": {"task": task}})})
    content["cells"] = cells
    return {key: value for key, value in content.items() if key not in _PUBLICATION_KEYS}


def _variants(
    cell: dict[str, Any], config: dict[str, Any], variants: Iterable[Mapping[str, Any]]
) -> Iterator[dict[str, Any]]:
    # Yields one row for a model of the base table, with a column for each variant. The first
    # variant is the published model. The other variants insert transforms after certain transforms,
    # and are skipped for models that do not have these.
    original, *alternatives = variants
    row = f"{cell['row']}, {cell['column']}"
    yield {**cell, "row": row, "column": original["column"], "config": config}
    for variant in alternatives:
        transforms = config["data"]["transform"]["init_args"]["transforms"]
        extended = [
            step
            for transform in transforms
            for step in (transform, variant["behind"].get(transform["class_path"]))
            if step is not None
        ]
        if len(extended) > len(transforms):
            data = {"data": {"transform": {"init_args": {"transforms": extended}}}}
            yield {
                "section": cell["section"],
                "row": row,
                "column": variant["column"],
                "experiment": f"{cell['experiment']}_{variant['suffix']}",
                "config": merged(config, data),
            }


def _with_arguments(content: Any, arguments: Mapping[str, Any]) -> Any:
    # Adds arguments to the classes in a configuration.
    if isinstance(content, list):
        return [_with_arguments(value, arguments) for value in content]
    if not isinstance(content, Mapping):
        return content
    config = {key: _with_arguments(value, arguments) for key, value in content.items()}
    init_args = arguments.get(config.get("class_path", ""))
    return config if init_args is None else merged(config, {"init_args": init_args})


def table_names() -> list[str]:
    r"""Returns the names of the tables that are included in the package."""
    return list(_table_contents())


def load_table(name: str) -> Table:
    r"""Returns a table that is included in the package, or a table from a YAML file.

    Args:
        name (str): Name of the table, such as :obj:`"p1-table2"`, or the path of a YAML file.

    Raises:
        ValueError: If there is no such table (the message lists the available tables), or the
            format of the file is invalid (see :doc:`/experiments`).
    """
    if name in _table_contents():
        return table_of(name, _table_contents()[name])
    if Path(name).suffix not in (".yaml", ".yml"):
        raise ArgumentError(
            Argument("name"),
            f" must be one of {table_names()}, or a file that ends with .yaml (got '{name}')",
        )
    return read_table(name)
