r"""Tables of models with their data, protocols and published numbers."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from fnmatch import fnmatchcase
from functools import cached_property
from pathlib import Path
from typing import Any, Self

from torch_geometric_tactile._checks import Argument, ArgumentError, need, need_argument
from torch_geometric_tactile._texts import short_repr
from torch_geometric_tactile._typing import PathLike, ThresholdMetric
from torch_geometric_tactile.data import Protocol
from torch_geometric_tactile.experiments._experiment import Choice
from torch_geometric_tactile.experiments._sample_draws import Draws
from torch_geometric_tactile.experiments.source import DataSource
from torch_geometric_tactile.training._config import load_config
from torch_geometric_tactile.training._config_files import read_yaml
from torch_geometric_tactile.training._threshold import THRESHOLD_METRICS

_SHOWN_METRICS = ("accuracy", "memory")
_PUBLISHED_KEYS = ("accuracy", "spread", "variance", "f1", "auc", "memory", "milliseconds")


@dataclass(frozen=True)
class Cell:
    r"""One cell of a table: a model with its configuration and published numbers.

    Args:
        row (str): Name of the row: the model.
        column (str): Name of the column, such as the inputs of the model.
        experiment (str): Name of the experiment.
        section (str): The section of the table, such as :obj:`"with joint angles"`; may be empty.
        config (str or dict, optional): The configuration: the name of a built-in configuration, a
            file, or its contents.
        estimator (dict, optional): A scikit-learn classifier as :obj:`{"class_path",
            "init_args"}`, instead of :obj:`config`.
        transform (dict, optional): The transform of all batches. It replaces the transform in the
            configuration.
        data (dict): Arguments of the data set for this cell only.
        choice (Choice, optional): The selection of settings on validation parts. By default,
            nothing is selected.
        published (dict): Numbers from the paper: :obj:`accuracy` in percent and its :obj:`spread`
            or, over draws of test samples, its :obj:`variance` in squared percent; :obj:`f1` of
            class 1 in percent; :obj:`auc`; :obj:`memory` in MB; and :obj:`milliseconds` per frame.
        threshold (str, optional): As in
            :class:`~torch_geometric_tactile.experiments._experiment.Experiment`.
        layers (dict): Published accuracies of single layers in percent.
        studies (list of dict): Studies of the model with the first seed and fold, as in
            :class:`~torch_geometric_tactile.experiments._experiment.Experiment`.

    Raises:
        ValueError: If not exactly one of :obj:`config` and :obj:`estimator` is given, or
            :obj:`threshold` is unknown.
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
        r"""The contents of :obj:`config`, which is loaded if it is a name or a file."""
        return self.config if isinstance(self.config, dict) else load_config(str(self.config))


@dataclass(frozen=True)
class Ordering:
    r"""A claim of a paper, or a hypothesis, that some models are better than others.

    Args:
        name (str): The ordering in words, such as :obj:`"GCN above LSTM"`.
        pairs (tuple of tuple): Pairs of experiments, with the better one first.

    Raises:
        ValueError: If there is no pair.
    """

    name: str
    pairs: tuple[tuple[str, str], ...]

    def __post_init__(self) -> None:
        object.__setattr__(self, "pairs", tuple((better, worse) for better, worse in self.pairs))
        need(self.pairs, f"'pairs' of '{self.name}' must hold at least one pair (got none)")


@dataclass(frozen=True)
class TableProtocol:
    r"""A protocol that splits the data of a table.

    Args:
        name (str): Name of the protocol in the table, such as :obj:`"by trial"`.
        protocol (Protocol): The splits.
        data (dict): Arguments of the data set for this protocol only.
        note (str): A sentence that explains the meaning of the scores; may be empty.
    """

    name: str
    protocol: Protocol
    data: dict[str, Any] = field(default_factory=dict)
    note: str = ""

    def with_folds(self, folds: int | None) -> Self:
        r"""Returns the protocol with another number of folds. A protocol without folds is returned
        unchanged.

        Args:
            folds (int, optional): The number of folds. If :obj:`None`, the number is unchanged.
        """
        if folds is None or self.protocol.folds is None:
            return self
        return replace(self, protocol=replace(self.protocol, folds=folds))


@dataclass(frozen=True)
class Table:
    r"""A table from a paper, or a table defined by a user.

    Args:
        name (str): Name of the table and of its files.
        title (str): Title of the table.
        data (DataSource): The samples.
        protocols (tuple of TableProtocol): The protocols, in order.
        cells (tuple of Cell): The cells, row by row.
        paper (str): Title of the paper; empty for a table defined by a user.
        place (str): The place in the paper, such as the number of the table.
        task (str): :obj:`"multiclass"`, :obj:`"multilabel"` or :obj:`"regression"`.
        shows (str): The number shown, :obj:`"accuracy"` or :obj:`"memory"`.
        seeds (int): Default number of runs of each experiment.
        measure_memory (bool): If :obj:`True`, each run has a separate process whose memory is
            measured. This is slow for hundreds of small models.
        paper_protocol (str): Name of the protocol used in the paper, if the paper states it.
        positive (str): For two classes, the name of class 1. Its precision, recall and F1 score are
            then shown.
        axis (str): If the columns are numbers, the name of their quantity. The figure then has a
            line for each row.
        orderings (tuple of Ordering): Claims to check against the results.
        measured_on (str): The hardware of the published numbers.
        recordings (str): Availability of the published recordings: :obj:`"private"`,
            :obj:`"public"` or :obj:`"unavailable"`.
        see_also (str): A sentence that points to related results; may be empty.
        draws (Draws, optional): Random draws of test samples over which accuracies are averaged.

    Raises:
        ValueError: If there are no protocols or no cells, if names are not unique, if an ordering
            names an unknown experiment, if columns along an axis are not numbers, or if
            :obj:`see_also` is not a text.
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
        names = {cell.experiment for cell in self.cells}
        for ordering in self.orderings:
            unknown = {name for pair in ordering.pairs for name in pair} - names
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
                    f"the columns of table '{self.name}' must be numbers, because 'axis' is given "
                    f"(got '{cell.column}')"
                ) from None
        need(
            self.shows in _SHOWN_METRICS,
            f"'shows' must be one of {list(_SHOWN_METRICS)} (got '{self.shows}')",
        )
        for argument, entry_names in (
            ("protocols", [protocol.name for protocol in self.protocols]),
            ("cells", [cell.experiment for cell in self.cells]),
        ):
            if not entry_names or len(set(entry_names)) < len(entry_names):
                raise ValueError(
                    f"'{argument}' of table '{self.name}' must have different names, at least one "
                    f"(got {entry_names})"
                )

    @property
    def sections(self) -> list[str]:
        r"""The names of the sections, in order."""
        return list(dict.fromkeys(cell.section for cell in self.cells))

    @property
    def rows(self) -> list[str]:
        r"""The names of the rows, in order."""
        return list(dict.fromkeys(cell.row for cell in self.cells))

    @property
    def is_published(self) -> bool:
        r"""Whether any cell has published numbers."""
        return any(cell.published for cell in self.cells)

    def columns(self, section: str) -> list[str]:
        r"""Returns the columns of a section, in the order of its longest row.

        Args:
            section (str): The section.
        """
        cells = [cell for cell in self.cells if cell.section == section]
        longest_row = max(cells, key=lambda cell: sum(peer.row == cell.row for peer in cells)).row
        first_columns = [cell.column for cell in cells if cell.row == longest_row]
        return list(dict.fromkeys([*first_columns, *(cell.column for cell in cells)]))

    def select(self, patterns: Iterable[str] | None) -> tuple[Cell, ...]:
        r"""Returns the cells whose experiment name matches one of several patterns.

        Args:
            patterns (iterable of str, optional): Patterns such as :obj:`"gcn_*_joint"`. By default,
                all cells are returned.

        Raises:
            ValueError: If a pattern matches no name; the message lists the names.
        """
        if patterns is None:
            return self.cells
        patterns = list(patterns)
        for pattern in patterns:
            if not any(fnmatchcase(cell.experiment, pattern) for cell in self.cells):
                names = ", ".join(cell.experiment for cell in self.cells)
                raise ArgumentError(
                    Argument("only"),
                    f" must match the name of an experiment of {self.name}: {names} "
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
        r"""Returns the protocols with the given names, in the order of the table.

        Args:
            names (iterable of str, optional): Names of the protocols; a leading :obj:`"by"` may be
                omitted. By default, all protocols are returned.
            folds (int, optional): Number of folds, for the protocols with folds.

        Raises:
            ValueError: If a name is unknown; the message lists the names.
        """
        protocol_names = [protocol.name for protocol in self.protocols]
        requested = protocol_names if names is None else list(names)
        for name in requested:
            if not {name, f"by {name}"} & set(protocol_names):
                raise ArgumentError(
                    Argument("protocols"), f" must be some of {protocol_names} (got '{name}')"
                )
        need_argument(requested, "protocols", f"must be some of {protocol_names} (got none)")
        full_names = {*requested, *(f"by {name}" for name in requested)}
        return tuple(p.with_folds(folds) for p in self.protocols if p.name in full_names)


def read_table(path: PathLike) -> Table:
    r"""Reads a table from a file.

    Args:
        path (str or os.PathLike): A YAML file. Paths of configurations in the file are relative to
            its folder.

    Raises:
        ValueError: If the file does not have the format described in ``docs/experiments.md``.
    """
    content = read_yaml(Path(path))
    if not isinstance(content, Mapping):
        raise ValueError(f"'{path}' must hold a table (got {type(content).__name__})")
    try:
        return table_of(Path(path).stem, content, Path(path).parent)
    except ValueError as error:
        raise ValueError(f"'{path}': {error}") from error


def table_of(name: str, content: Mapping[str, Any], folder: PathLike = "") -> Table:
    r"""Builds a table from plain data.

    Args:
        name (str): Name of the table.
        content (Mapping): The content of a YAML file.
        folder (str or os.PathLike): The folder to which paths of configurations are relative.

    Raises:
        ValueError: If the content does not have the format described in ``docs/experiments.md``.
    """
    entries = dict(content)
    try:
        data = dict(entries.pop("data"))
        source = DataSource(arguments=data.pop("init_args", None) or {}, **data)
        protocols = tuple(_parse_protocol(*item) for item in entries.pop("protocols").items())
        template = entries.pop("template", None)
        cells = tuple(_parse_cell(cell, template, Path(folder)) for cell in entries.pop("cells"))
        orderings = tuple(_parse_ordering(item) for item in entries.pop("orderings", None) or ())
        draws = entries.pop("draws", None)
        _check_keys("a table", entries, _TABLE_KEYS)
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


def _parse_protocol(name: str, content: Mapping[str, Any]) -> TableProtocol:
    arguments = dict(content)
    data, note = arguments.pop("data", {}), arguments.pop("note", "")
    return TableProtocol(name, Protocol.from_dict(arguments), data, note)


def _parse_ordering(content: Any) -> Ordering:
    pairs = content.get("pairs") if isinstance(content, Mapping) else None
    is_pair = [
        isinstance(pair, list) and len(pair) == 2 and all(isinstance(name, str) for name in pair)
        for pair in (pairs if isinstance(pairs, list) else [None])
    ]
    need(
        all(is_pair) and {*content} == {"name", "pairs"},
        "an entry of 'orderings' must have a 'name' and 'pairs' of experiments with the better one "
        "first, such as {name: GCN above SVM, pairs: [[GCN, SVM]]}",
        short_repr(content),
    )
    return Ordering(**content)


def _check_keys(what: str, entries: Mapping[str, Any], keys: Sequence[str]) -> None:
    unknown = next((key for key in entries if key not in keys), None)
    if unknown == "epochs":
        raise ValueError(
            f"{what} must not have 'epochs' (got {entries['epochs']!r}): the number is "
            "'max_epochs' in the section 'trainer' of a configuration, or '--epochs' for all cells"
        )
    need(unknown is None, f"a key of {what} must be one of {', '.join(keys)}", f"'{unknown}'")


def _parse_cell(content: Mapping[str, Any], template: str | None, folder: Path) -> Cell:
    _check_keys("a cell", content, _CELL_KEYS)
    arguments = dict(content)
    published = {key: arguments.pop(key) for key in _PUBLISHED_KEYS if key in arguments}
    config = arguments.pop("config", None)
    if config is None and template is not None and "estimator" not in arguments:
        config = f"{template}/{arguments['experiment']}"
    if isinstance(config, str) and (folder / config).is_file():
        config = str(folder / config)
    arguments.setdefault("experiment", arguments["row"])
    arguments["column"] = str(arguments.get("column", ""))
    if "choice" in arguments:
        _check_keys("a 'choice'", arguments["choice"], [item.name for item in fields(Choice)])
        arguments["choice"] = Choice(**arguments["choice"])
    return Cell(config=config, published=published, **arguments)


# The keys that a table and a cell may have in a YAML file.
_TABLE_KEYS = tuple(item.name for item in fields(Table) if item.name != "name")
_CELL_KEYS = (
    *(item.name for item in fields(Cell) if item.name != "published"),
    *_PUBLISHED_KEYS,
)
