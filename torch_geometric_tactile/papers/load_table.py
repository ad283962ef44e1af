r"""The tables of the papers, by name."""

from collections.abc import Iterable, Iterator, Mapping
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any

import yaml

from torch_geometric_tactile._checks import Argument, ArgumentError
from torch_geometric_tactile.experiments.tables import Table, read_table, table_of
from torch_geometric_tactile.training._config_files import expand_template, merged

_PLACE = ("section", "row", "column", "experiment")  # and what else a cell has is published
_LEFT_OUT = ("like", "arguments", "variants", "template")
_OF_PAPER = ("paper", "place")


@cache
def _content() -> dict[str, dict[str, Any]]:
    path = files("torch_geometric_tactile.papers") / "tables.yaml"
    tables: dict[str, dict[str, Any]] = yaml.safe_load(path.read_text(encoding="utf-8"))["tables"]
    return {name: _like(own, tables) if "like" in own else own for name, own in tables.items()}


def _like(own: dict[str, Any], tables: Mapping[str, dict[str, Any]]) -> dict[str, Any]:
    other = tables[own["like"]]
    configs = expand_template(other["template"])
    content = {key: value for key, value in {**other, **own}.items() if key not in _LEFT_OUT}
    if "variants" in own:
        content["cells"] = [
            variant
            for cell in other["cells"]
            for variant in _variants(cell, configs[cell["experiment"]], own["variants"])
        ]
        return content
    # The models of another table, which learn another task on other data.
    task, cells = own.get("task", other["task"]), []
    for cell in other["cells"]:
        config = _with_arguments(configs[cell["experiment"]], own["arguments"])
        place = {key: cell[key] for key in _PLACE}
        cells.append({**place, "config": merged(config, {"model": {"task": task}})})
    content["cells"] = cells
    return {key: value for key, value in content.items() if key not in _OF_PAPER}


def _variants(
    cell: dict[str, Any], config: dict[str, Any], variants: Iterable[Mapping[str, Any]]
) -> Iterator[dict[str, Any]]:
    # A model of another table with other transforms behind some: a row of its own, with a column
    # for each variant. The first is the published one; a model without these has no other.
    first, *alternatives = variants
    row = f"{cell['row']}, {cell['column']}"
    yield {**cell, "row": row, "column": first["column"], "config": config}
    for variant in alternatives:
        transforms = config["data"]["transform"]["init_args"]["transforms"]
        longer = [
            part
            for one in transforms
            for part in (one, variant["behind"].get(one["class_path"]))
            if part is not None
        ]
        if len(longer) > len(transforms):
            data = {"data": {"transform": {"init_args": {"transforms": longer}}}}
            yield {
                "section": cell["section"],
                "row": row,
                "column": variant["column"],
                "experiment": f"{cell['experiment']}_{variant['suffix']}",
                "config": merged(config, data),
            }


def _with_arguments(content: Any, arguments: Mapping[str, Any]) -> Any:
    # Gives the classes that a configuration names further arguments.
    if isinstance(content, list):
        return [_with_arguments(value, arguments) for value in content]
    if not isinstance(content, Mapping):
        return content
    laid = {key: _with_arguments(value, arguments) for key, value in content.items()}
    more = arguments.get(laid.get("class_path", ""))
    return laid if more is None else merged(laid, {"init_args": more})


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
        raise ArgumentError(
            Argument("name"),
            f" must be one of {table_names()}, or a file that ends with .yaml (got '{name}')",
        )
    return read_table(name)
