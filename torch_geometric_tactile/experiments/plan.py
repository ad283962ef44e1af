r"""A table resolved into its experiments, once: what is run, stored, counted and written about."""

import json
import warnings
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

from torch_geometric_tactile._checks import Argument, ArgumentError
from torch_geometric_tactile.data._shared_samples import describe_shared
from torch_geometric_tactile.experiments._experiment import Experiment
from torch_geometric_tactile.experiments.source import DataFacts, DataSource
from torch_geometric_tactile.experiments.tables import Cell, Table, TableProtocol

_ACCELERATORS = ("cpu", "gpu")


@dataclass(frozen=True)
class Settings:
    r"""How the experiments of a table are run.

    Args:
        seeds (int, optional): Runs of each experiment, with the seeds 0, 1, ... of split and
            training; the table's number if left out.
        epochs (int, optional): Epochs, instead of those of the configurations.
        folds (int, optional): Number of folds of the protocols with folds, instead of theirs.
        protocols (tuple of str, optional): Only these protocols of the table.
        accelerator (str): :obj:`"cpu"` or :obj:`"gpu"`.
        threads (int): Threads of each run.

    Raises:
        ValueError: If a number is too small, or a name is unknown.
    """

    seeds: int | None = None
    epochs: int | None = None
    folds: int | None = None
    protocols: tuple[str, ...] | None = None
    accelerator: str = "cpu"
    threads: int = 1

    def __post_init__(self) -> None:
        for name, least in (("seeds", 1), ("epochs", 1), ("folds", 2), ("threads", 1)):
            number = getattr(self, name)
            if number is not None and number < least:
                raise ArgumentError(Argument(name), f" must be at least {least} (got {number})")
        if self.accelerator not in _ACCELERATORS:
            raise ArgumentError(
                Argument("accelerator"),
                f" must be one of {list(_ACCELERATORS)} (got '{self.accelerator}')",
            )


@dataclass(frozen=True)
class Plan:
    r"""A table resolved into its experiments.

    Args:
        table (Table): The table.
        protocols (tuple of TableProtocol): Those of its protocols that are run.
        seeds (int): Runs of each experiment.
        data (DataSource): The samples, with fingerprint and caption.
        facts (DataFacts): What they hold.
        experiments (tuple of Experiment): All that is to be run: the first seed of all models
            first, so that a run that is stopped has something of every model.
    """

    table: Table
    protocols: tuple[TableProtocol, ...]
    seeds: int
    data: DataSource
    facts: DataFacts
    experiments: tuple[Experiment, ...]

    @cached_property
    def shared(self) -> tuple[str, ...]:
        r"""The samples that parts of its splits share, which make scores too high: trials of given
        parts, and copies of recordings. A sentence for each; usually none.
        """
        sentences: dict[str, None] = {}
        drafts = {e.protocol_name: e for e in reversed(self.experiments)}
        for name, draft in drafts.items():
            dataset, protocol = draft.data.load(), draft.protocol
            if protocol.by == "frame" and dataset.column("trial") is not None:
                continue  # frames of one trial are in several parts: that is what was asked for
            splits = {(e.seed, e.fold) for e in self.experiments if e.protocol_name == name}
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # of classes with few units, which were told before
                parts = [protocol.split(dataset, seed, fold) for seed, fold in sorted(splits)]
            found = describe_shared(dataset, parts, with_units=protocol.by == "given")
            sentences.update(dict.fromkeys(found))
        return tuple(sentences)

    def of_cell(self, cell: Cell) -> Experiment:
        r"""Returns the first experiment of a cell, for facts that all of them share.

        Args:
            cell (Cell): The cell.
        """
        return next(e for e in self.experiments if e.name == cell.experiment)


def make_plan(
    table: Table,
    settings: Settings | None = None,
    *,
    data: Mapping[str, Any] | None = None,
    selection: Mapping[str, Any] | None = None,
) -> Plan:
    r"""Resolves a table: loads its data, which is downloaded or processed if that was not done
    before, and lists its experiments.

    Args:
        table (Table): The table.
        settings (Settings, optional): How the experiments are run.
        data (Mapping, optional): Arguments of the data set, such as :obj:`root`, laid over the
            table's.
        selection (Mapping, optional): Arguments of the data set that only choose among the samples,
            such as :obj:`stride`; see :class:`DataSource`.

    Raises:
        FileNotFoundError: If there is no data or no configuration.
        ValueError: If an argument is wrong, the samples cannot be split as the table says, or its
            models are for fewer classes.
    """
    settings = settings or Settings()
    protocols = table.select_protocols(settings.protocols, settings.folds)
    source, facts = table.data.with_arguments(data or {}, selection).resolve()
    return list_experiments(table, protocols, settings, source, facts)


def list_experiments(
    table: Table,
    protocols: tuple[TableProtocol, ...],
    settings: Settings,
    data: DataSource,
    facts: DataFacts,
) -> Plan:
    r"""Lists the experiments of a table, whose data set is loaded."""
    models = {cell.experiment: _model(cell, settings, table) for cell in table.cells}
    resolved: dict[str, DataSource] = {}
    drafts = {}
    for protocol in protocols:
        for cell in table.cells:
            over = {**cell.data, **protocol.data}
            key = json.dumps(over, sort_keys=True)
            if key not in resolved:
                resolved[key] = data.with_arguments(over).resolve()[0] if over else data
            drafts[cell.experiment, protocol.name] = Experiment(
                name=cell.experiment,
                data=resolved[key],
                protocol=protocol.protocol,
                protocol_name=protocol.name,
                accelerator=settings.accelerator,
                threads=settings.threads,
                choice=cell.choice,
                **models[cell.experiment],
            )
    _check_classes(table, drafts.values(), data, facts)
    seeds, first = settings.seeds or table.seeds, table.cells[0].experiment
    folds = {  # what cannot be split is found before anything is trained
        name: drafts[first, name].data.resolve(protocol)[1].num_folds
        for name, protocol in ((entry.name, entry.protocol) for entry in protocols)
    }
    experiments = tuple(
        replace(
            drafts[cell.experiment, protocol.name],
            seed=seed,
            fold=fold,
            studies=[] if seed or fold else cell.studies,
        )
        for seed in range(seeds)
        for protocol in protocols
        for fold in range(folds[protocol.name])
        for cell in table.cells
    )
    return Plan(table, protocols, seeds, data, facts, experiments)


def _model(cell: Cell, settings: Settings, table: Table) -> dict[str, Any]:
    # What a cell tells of its experiments, whatever their protocol.
    if cell.estimator is not None:
        return {
            "model": cell.estimator,
            "transform": cell.transform,
            "threshold": cell.threshold,
        }
    config = cell.configuration
    if config["model"].get("task") == "regression" and cell.choice is None:
        raise ValueError(f"'task' of '{cell.config}' must be one of classes (got 'regression')")
    trainer = dict(config.get("trainer") or {})
    epochs = trainer.pop("max_epochs", None)
    if settings.epochs is None and epochs is None:
        raise ValueError(f"'max_epochs' of '{cell.config}' must be given (got none)")
    of_data = config.get("data") or {}
    model, threshold = dict(config["model"]), cell.threshold
    if isinstance(model.get("threshold"), str):  # chosen by the experiment, which has the parts
        threshold = model.pop("threshold")
    return {
        "model": model,
        "threshold": threshold,
        "transform": cell.transform or of_data.get("transform"),
        "train_transform": of_data.get("train_transform"),
        "epochs": settings.epochs or epochs,
        "batch_size": of_data.get("batch_size", 128),
        "trainer": trainer,
        "measure_memory": table.measure_memory,
    }


def _check_classes(table: Table, drafts: Any, source: DataSource, facts: DataFacts) -> None:
    for draft in drafts:
        known = draft.model.get("num_classes")
        if known is not None and facts.num_classes > known:
            raise ValueError(
                f"the models of {table.name} tell {known} classes apart (got {facts.num_classes} "
                f"in '{source.arguments.get('root') or source.class_path}')"
            )
