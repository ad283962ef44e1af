r"""Tables as values: what is compared on which data, by which protocols, beside which published
numbers.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from fnmatch import fnmatchcase
from functools import cached_property
from pathlib import Path
from typing import Any, Self

from torch_geometric_tactile._checks import Argument, ArgumentError, need, need_argument
from torch_geometric_tactile._typing import PathLike, ThresholdMetric
from torch_geometric_tactile.data import Protocol
from torch_geometric_tactile.experiments._experiment import Choice
from torch_geometric_tactile.experiments._sample_draws import Draws
from torch_geometric_tactile.experiments.source import DataSource
from torch_geometric_tactile.training._config_files import read_yaml
from torch_geometric_tactile.training._threshold import THRESHOLD_METRICS
from torch_geometric_tactile.training.config import load_config

_SHOWS = ("accuracy", "memory")
_PUBLISHED = ("accuracy", "spread", "variance", "f1", "auc", "memory", "milliseconds")


@dataclass(frozen=True)
class Cell:
    r"""One place of a table.

    Args:
        row (str): The model.
        column (str): Its inputs, or whatever else tells it from others of its row.
        experiment (str): Name of the experiment.
        section (str): The part of the table, such as :obj:`"with joint angles"`; may be empty.
        config (str or dict, optional): The configuration that it is trained by: a shipped one by
            its name, a file, or its contents.
        estimator (dict, optional): A scikit-learn classifier as :obj:`{"class_path",
            "init_args"}`, instead of :obj:`config`.
        transform (dict, optional): What every batch goes through, instead of what the
            configuration says.
        data (dict): Arguments of the data set that only this place has.
        choice (Choice, optional): What is chosen on a validation part before the test; nothing if
            left out.
        published (dict): What the paper prints: :obj:`accuracy` in percent and its :obj:`spread`
            or, over draws of the samples tested on, its :obj:`variance` in squared percent,
            :obj:`f1` of class 1 in percent, :obj:`auc`, :obj:`memory` in MB, and the
            :obj:`milliseconds` of a frame, where it does.
        threshold (str, optional): As of
            :class:`~torch_geometric_tactile.experiments._experiment.Experiment`.
        layers (dict): The accuracy in percent of single layers that the paper prints.
        studies (list of dict): What else is looked at in the model of the first seed and fold, as
            of :class:`~torch_geometric_tactile.experiments._experiment.Experiment`.
    """

    row: str
    column: str
    experiment: str
    section: str = ""
    config: str | dict[str, Any] | None = None
    estimator: dict[str, Any] | None = None
    transform: dict[str, Any] | None = None
    data: dict[str, Any] = field(default_factory=dict)
    published: dict[str, float] = field(default_factory=dict)
    choice: Choice | None = None
    threshold: ThresholdMetric | None = None
    layers: dict[str, float] = field(default_factory=dict)
    studies: list[dict[str, Any]] = field(default_factory=list)

    def __post_init__(self) -> None:
        if (self.config is None) == (self.estimator is None):
            raise ValueError(
                f"'{self.experiment}' must have either a 'config' or an 'estimator' (got "
                f"{'none' if self.config is None else 'both'})"
            )
        if self.threshold is not None and self.threshold not in THRESHOLD_METRICS:
            raise ValueError(
                f"'threshold' of '{self.experiment}' must be one of {list(THRESHOLD_METRICS)} (got "
                f"{self.threshold!r})"
            )

    @cached_property
    def configuration(self) -> dict[str, Any]:
        r"""What :obj:`config` holds or stands for."""
        return self.config if isinstance(self.config, dict) else load_config(str(self.config))


@dataclass(frozen=True)
class Ordering:
    r"""What a paper found, or what is asked: that some models are better than others.

    Args:
        name (str): The ordering in words, such as :obj:`"GCN above LSTM"`.
        pairs (tuple of tuple): Two experiments each, the better first.

    Raises:
        ValueError: If there is no pair.
    """

    name: str
    pairs: tuple[tuple[str, str], ...]

    def __post_init__(self) -> None:
        object.__setattr__(self, "pairs", tuple((a, b) for a, b in self.pairs))
        need(self.pairs, f"'pairs' of '{self.name}' must hold at least one pair (got none)")


@dataclass(frozen=True)
class TableProtocol:
    r"""What a table holds out of its data.

    Args:
        name (str): What the table calls it, such as :obj:`"by trial"`.
        protocol (Protocol): What is held out.
        data (dict): Arguments of the data set that only this protocol has.
        note (str): What it tells, as a sentence; may be empty.
    """

    name: str
    protocol: Protocol
    data: dict[str, Any] = field(default_factory=dict)
    note: str = ""

    def with_folds(self, folds: int | None) -> Self:
        r"""Returns it with another number of folds, if it has folds and a number is given.

        Args:
            folds (int, optional): The number.
        """
        if folds is None or self.protocol.folds is None:
            return self
        return replace(self, protocol=replace(self.protocol, folds=folds))


@dataclass(frozen=True)
class Table:
    r"""A table, of a paper or a user's own.

    Args:
        name (str): Its name, and that of its files.
        title (str): What it shows.
        data (DataSource): The samples.
        protocols (tuple of TableProtocol): What is held out, one protocol after the other.
        cells (tuple of Cell): Its places, row by row.
        paper (str): Title of the paper, if it is of one.
        place (str): Where in the paper it is.
        task (str): :obj:`"multiclass"`, :obj:`"multilabel"` or :obj:`"regression"`.
        shows (str): :obj:`"accuracy"` or :obj:`"memory"`.
        seeds (int): Runs of each experiment, unless told otherwise.
        measure_memory (bool): Whether every run gets a process whose memory is measured. Not worth
            it for hundreds of small models.
        paper_protocol (str): Which of the protocols the paper used, if it says so.
        positive (str): Of two classes, the name of class 1, whose precision, recall and F1 score
            are shown then.
        axis (str): What the columns are if they are numbers: the picture has a line for each row
            along them.
        orderings (tuple of Ordering): What is looked for in the numbers.
        measured_on (str): What the published numbers were measured on.
        recordings (str): Whether those are :obj:`"private"`, :obj:`"public"` or
            :obj:`"unavailable"`.
        see_also (str): Where there is more of the kind, as a sentence; may be empty.
        draws (Draws, optional): Draws of the samples tested on, over which accuracies are shown.

    Raises:
        ValueError: If there is no protocol or no place, a name stands for two, an ordering names an
            experiment that is not there, columns along an axis are no numbers, or :obj:`see_also`
            is no text.
    """

    name: str
    title: str
    data: DataSource
    protocols: tuple[TableProtocol, ...]
    cells: tuple[Cell, ...]
    paper: str = ""
    place: str = ""
    task: str = "multiclass"
    shows: str = "accuracy"
    seeds: int = 5
    measure_memory: bool = True
    paper_protocol: str = ""
    positive: str = ""
    axis: str = ""
    orderings: tuple[Ordering, ...] = ()
    measured_on: str = "real hand"
    recordings: str = "private"
    see_also: str = ""
    draws: Draws | None = None

    def __post_init__(self) -> None:
        if not isinstance(self.see_also, str):
            raise ValueError(
                f"'see_also' of table '{self.name}' must be a text (got {self.see_also!r})"
            )
        known = {cell.experiment for cell in self.cells}
        for ordering in self.orderings:
            unknown = {name for pair in ordering.pairs for name in pair} - known
            if unknown:
                raise ValueError(
                    f"'{ordering.name}' of table '{self.name}' must be of its experiments (got "
                    f"{sorted(unknown)})"
                )
        for cell in self.cells if self.axis else ():
            try:
                float(cell.column)
            except ValueError:
                raise ValueError(
                    f"the columns of table '{self.name}' must be numbers, as 'axis' is given (got "
                    f"'{cell.column}')"
                ) from None
        need(self.shows in _SHOWS, f"'shows' must be one of {list(_SHOWS)} (got '{self.shows}')")
        for what, names in (
            ("protocols", [protocol.name for protocol in self.protocols]),
            ("cells", [cell.experiment for cell in self.cells]),
        ):
            if not names or len(set(names)) < len(names):
                raise ValueError(
                    f"'{what}' of table '{self.name}' must have different names, at least one "
                    f"(got {names})"
                )

    @property
    def sections(self) -> list[str]:
        r"""Its parts, in order."""
        return list(dict.fromkeys(cell.section for cell in self.cells))

    @property
    def rows(self) -> list[str]:
        r"""Its models, in order."""
        return list(dict.fromkeys(cell.row for cell in self.cells))

    @property
    def is_published(self) -> bool:
        r"""Whether any number of it is published."""
        return any(cell.published for cell in self.cells)

    def columns(self, section: str) -> list[str]:
        r"""Returns the columns of a section, in the order of the row that has most.

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
                raise ArgumentError(
                    Argument("only"),
                    f" must fit the name of an experiment of {self.name}: {names} "
                    f"(got '{pattern}')",
                )
        return tuple(
            cell
            for cell in self.cells
            if any(fnmatchcase(cell.experiment, pattern) for pattern in patterns)
        )

    def select_protocols(
        self, names: Iterable[str] | None, folds: int | None = None
    ) -> tuple[TableProtocol, ...]:
        r"""Returns some of the protocols, in the order of the table.

        Args:
            names (iterable of str, optional): Their names; a leading :obj:`"by"` may be left out.
                All if left out.
            folds (int, optional): Number of folds of those with folds, instead of theirs.

        Raises:
            ValueError: If there is no such protocol; the message lists those there are.
        """
        known = [protocol.name for protocol in self.protocols]
        wanted = known if names is None else list(names)
        for name in wanted:
            if not {name, f"by {name}"} & set(known):
                raise ArgumentError(
                    Argument("protocols"), f" must be some of {known} (got '{name}')"
                )
        need_argument(wanted, "protocols", f"must be some of {known} (got none)")
        chosen = {*wanted, *(f"by {name}" for name in wanted)}
        return tuple(p.with_folds(folds) for p in self.protocols if p.name in chosen)


def read_table(path: PathLike) -> Table:
    r"""Returns a table that a user wrote.

    Args:
        path (str or os.PathLike): A YAML file. Paths of configurations in it are relative to its
            folder.

    Raises:
        ValueError: If the file is not as described on the page on experiments.
    """
    content = read_yaml(Path(path))
    if not isinstance(content, Mapping):
        raise ValueError(f"'{path}' must hold a table (got {type(content).__name__})")
    try:
        return table_of(Path(path).stem, content, Path(path).parent)
    except ValueError as error:
        raise ValueError(f"'{path}': {error}") from error


def table_of(name: str, content: Mapping[str, Any], folder: PathLike = "") -> Table:
    r"""Returns a table from its plain description.

    Args:
        name (str): Its name.
        content (Mapping): As in a YAML file.
        folder (str or os.PathLike): What paths of configurations are relative to.

    Raises:
        ValueError: If it is not as described on the page on experiments.
    """
    entries = dict(content)
    try:
        data = dict(entries.pop("data"))
        source = DataSource(arguments=data.pop("init_args", None) or {}, **data)
        protocols = tuple(_protocol(*item) for item in entries.pop("protocols").items())
        template = entries.pop("template", None)
        cells = tuple(_cell(cell, template, Path(folder)) for cell in entries.pop("cells"))
        orderings = tuple(Ordering(**item) for item in entries.pop("orderings", ()))
        draws = entries.pop("draws", None)
        return Table(
            name=name,
            data=source,
            protocols=protocols,
            cells=cells,
            orderings=orderings,
            draws=None if draws is None else Draws(**draws),
            **entries,
        )
    except KeyError as error:
        raise ValueError(f"table '{name}' must have {error} (got none)") from error
    except (TypeError, AttributeError, ValueError) as error:
        raise ValueError(f"table '{name}' cannot be read: {error}") from error


def _protocol(name: str, content: Mapping[str, Any]) -> TableProtocol:
    values = dict(content)
    data, note = values.pop("data", {}), values.pop("note", "")
    return TableProtocol(name, Protocol.from_dict(values), data, note)


def _cell(content: Mapping[str, Any], template: str | None, folder: Path) -> Cell:
    values = dict(content)
    published = {key: values.pop(key) for key in _PUBLISHED if key in values}
    config = values.pop("config", None)
    if config is None and template is not None and "estimator" not in values:
        config = f"{template}/{values['experiment']}"
    if isinstance(config, str) and (folder / config).is_file():
        config = str(folder / config)
    values.setdefault("experiment", values["row"])
    values["column"] = str(values.get("column", ""))
    if "choice" in values:
        values["choice"] = Choice(**values["choice"])
    return Cell(config=config, published=published, **values)


def cell_config(cell: Cell) -> dict[str, Any]:
    r"""Returns the configuration of a cell.

    Args:
        cell (Cell): The cell, with a :obj:`config`.

    Raises:
        FileNotFoundError: If there is no such configuration.
    """
    return cell.configuration
