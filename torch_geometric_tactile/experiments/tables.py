r"""The tables of the papers: what they print, and which experiment stands beside each number."""

from collections.abc import Iterable
from dataclasses import dataclass
from fnmatch import fnmatchcase
from functools import cache
from importlib.resources import files
from typing import Any

import yaml


@dataclass(frozen=True)
class Cell:
    r"""One place of a table.

    Args:
        section (str): The part of the table, such as :obj:`"with joint angles"`.
        row (str): The model.
        column (str): Its inputs.
        experiment (str): Name of the experiment in the table's template.
        published (dict): What the paper prints: :obj:`accuracy` in percent and its :obj:`spread`,
            :obj:`auc`, and :obj:`memory` in MB, where it does.
    """

    section: str
    row: str
    column: str
    experiment: str
    published: dict[str, float]


@dataclass(frozen=True)
class PublishedTable:
    r"""A table of a paper.

    Args:
        name (str): Its name on the command line.
        title (str): What it shows.
        paper (str): Title of the paper.
        place (str): Where in the paper it stands.
        template (str): The configurations of its experiments.
        task (str): :obj:`"multiclass"` or :obj:`"multilabel"`.
        shows (str): :obj:`"accuracy"` or :obj:`"memory"`.
        cells (tuple of Cell): Its places, row by row.
    """

    name: str
    title: str
    paper: str
    place: str
    template: str
    task: str
    shows: str
    cells: tuple[Cell, ...]

    @property
    def sections(self) -> list[str]:
        r"""Its parts, in order."""
        return list(dict.fromkeys(cell.section for cell in self.cells))

    @property
    def rows(self) -> list[str]:
        r"""Its models, in order."""
        return list(dict.fromkeys(cell.row for cell in self.cells))

    def columns(self, section: str) -> list[str]:
        r"""Returns the inputs of a section, those with fewer first.

        Args:
            section (str): The section.
        """
        mine = [cell for cell in self.cells if cell.section == section]
        longest = max(mine, key=lambda cell: sum(other.row == cell.row for other in mine)).row
        of_longest = [cell.column for cell in mine if cell.row == longest]
        return list(dict.fromkeys([*of_longest, *(cell.column for cell in mine)]))

    def select(self, patterns: Iterable[str] | None) -> tuple[Cell, ...]:
        r"""Returns the cells whose experiment has a name like one of some patterns.

        Args:
            patterns (iterable of str, optional): Such as :obj:`"gcn_*_joint"`. All if left out.

        Raises:
            ValueError: If a pattern fits none; the message lists the names.
        """
        if patterns is None:
            return self.cells
        patterns = list(patterns)
        for pattern in patterns:
            if not any(fnmatchcase(cell.experiment, pattern) for cell in self.cells):
                names = ", ".join(cell.experiment for cell in self.cells)
                raise ValueError(
                    f"'only' must fit the name of an experiment of {self.name}: {names} "
                    f"(got '{pattern}')"
                )
        return tuple(
            cell
            for cell in self.cells
            if any(fnmatchcase(cell.experiment, pattern) for pattern in patterns)
        )


@cache
def _content() -> dict[str, dict[str, Any]]:
    path = files("torch_geometric_tactile.experiments") / "published.yaml"
    content: dict[str, dict[str, Any]] = yaml.safe_load(path.read_text(encoding="utf-8"))["tables"]
    return content


def table_names() -> list[str]:
    r"""Returns the names of the tables."""
    return list(_content())


def load_table(name: str) -> PublishedTable:
    r"""Returns a table of a paper.

    Args:
        name (str): Its name, such as :obj:`"p1-table2"`.

    Raises:
        ValueError: If there is no such table; the message lists those that there are.
    """
    if name not in _content():
        raise ValueError(f"'name' must be one of {table_names()} (got '{name}')")
    content = dict(_content()[name])
    cells = []
    for entry in content.pop("cells"):
        entry = dict(entry)
        place = {key: entry.pop(key) for key in ("section", "row", "column", "experiment")}
        cells.append(Cell(**place, published=entry))
    return PublishedTable(name=name, cells=tuple(cells), **content)
