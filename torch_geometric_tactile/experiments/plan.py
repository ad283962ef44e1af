r"""Plans (tables that are resolved into experiments) and their runs."""

import json
import warnings
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

from torch_geometric_tactile._checks import Argument, ArgumentError
from torch_geometric_tactile.data._shared_samples import describe_shared
from torch_geometric_tactile.experiments._experiment import Experiment
from torch_geometric_tactile.experiments.source import DataFacts, DataSource
from torch_geometric_tactile.experiments.tables import Cell, Table, TableProtocol

_ACCELERATORS = ("cpu", "gpu")


@dataclass(frozen=True)
class Settings:
    r"""Settings of the experiments of a table.

    Args:
        seeds (int, optional): Number of runs of each experiment. Their seeds 0, 1, ... determine
            split and training. Defaults to the number in the table.
        epochs (int, optional): Number of epochs. Defaults to the numbers in the configurations.
        folds (int, optional): Number of folds, for all protocols of the table with folds.
        protocols (tuple of str, optional): Names of the protocols to run. Defaults to all.
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
        for name, minimum in (("seeds", 1), ("epochs", 1), ("folds", 2), ("threads", 1)):
            number = getattr(self, name)
            if number is not None and number < minimum:
                raise ArgumentError(Argument(name), f" must be at least {minimum} (got {number})")
        if self.accelerator not in _ACCELERATORS:
            raise ArgumentError(
                Argument("accelerator"),
                f" must be one of {list(_ACCELERATORS)} (got '{self.accelerator}')",
            )


@dataclass(frozen=True)
class Plan:
    r"""A table that is resolved into its experiments.

    Args:
        table (Table): The table.
        protocols (tuple of TableProtocol): The protocols of the table to run.
        seeds (int): Number of runs of each experiment.
        data (DataSource): The samples, with fingerprint and caption.
        facts (DataFacts): Facts about the samples.
        experiments (tuple of Experiment): All experiments, ordered by seed, so that an interrupted
            run has results for every model.
    """

    table: Table
    protocols: tuple[TableProtocol, ...]
    seeds: int
    data: DataSource
    facts: DataFacts
    experiments: tuple[Experiment, ...]

    @cached_property
    def shared(self) -> tuple[str, ...]:
        r"""Warnings about samples that are in several parts of a split and make scores too high:
        shared trials of given parts, and copies of recordings. Usually empty.
        """
        sentences: dict[str, None] = {}
        drafts = {e.protocol_name: e for e in reversed(self.experiments)}
        for name, draft in drafts.items():
            dataset, protocol = draft.data.load(), draft.protocol
            if protocol.by == "frame" and dataset.column("trial") is not None:
                continue  # splits by frame deliberately put frames of a trial into several parts
            splits = {(e.seed, e.fold) for e in self.experiments if e.protocol_name == name}
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # on classes with few units: the plan has warned
                parts = [protocol.split(dataset, seed, fold) for seed, fold in sorted(splits)]
            shared = describe_shared(dataset, parts, with_units=protocol.by == "given")
            sentences.update(dict.fromkeys(shared))
        return tuple(sentences)

    def cell_experiment(self, cell: Cell) -> Experiment:
        r"""Returns the first experiment of a cell. Use it for properties that all experiments of
        the cell share.

        Args:
            cell (Cell): The cell.
        """
        return next(e for e in self.experiments if e.name == cell.experiment)


class PlanRun(NamedTuple):
    r"""The run of a plan.

    Args:
        plan (Plan): The plan.
        results (list of tuple): The finished experiments with their results.
        kept (int): Number of finished experiments from earlier runs.
        failed (dict): The error message of each failed experiment by its label.
        missing (int): Number of experiments without a result.
    """

    plan: Plan
    results: list[tuple[Experiment, dict[str, Any]]]
    kept: int
    failed: dict[str, str]
    missing: int

    def describe(self) -> str:
        r"""Returns the numbers of finished and missing runs in one line."""
        total = len(self.results) + self.missing
        reused = f" ({self.kept} kept from before)" if self.kept else ""
        missing = f", {self.missing} missing" if self.missing else ""
        num_finished = len(self.results)
        return f"{self.plan.table.name}: {num_finished} of {total} runs finished{reused}{missing}"


def make_plan(
    table: Table,
    settings: Settings | None = None,
    *,
    data: Mapping[str, Any] | None = None,
    selection: Mapping[str, Any] | None = None,
) -> Plan:
    r"""Returns the plan of a table. Loads the data of the table (and downloads and processes it if
    necessary), and lists the experiments.

    Args:
        table (Table): The table.
        settings (Settings, optional): Settings of the experiments.
        data (Mapping, optional): Arguments of the data set, such as :obj:`root`. They replace
            arguments in the table.
        selection (Mapping, optional): Arguments of the data set that only select samples, such as
            :obj:`stride`; see :class:`DataSource`.

    Raises:
        FileNotFoundError: If there is no data or no configuration.
        ValueError: If an argument is invalid, if a protocol of the table cannot split the samples,
            or if the models have fewer classes than the data.
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
    r"""Returns the plan of a table with a resolved data source.

    Args:
        table (Table): The table.
        protocols (tuple of TableProtocol): The protocols to run.
        settings (Settings): Settings of the experiments.
        data (DataSource): The resolved source.
        facts (DataFacts): The facts of the source.
    """
    models = {cell.experiment: _model_arguments(cell, settings, table) for cell in table.cells}
    resolved: dict[str, DataSource] = {}
    drafts = {}
    for protocol in protocols:
        for cell in table.cells:
            arguments = {**cell.data, **protocol.data}
            key = json.dumps(arguments, sort_keys=True)
            if key not in resolved:
                resolved[key] = data.with_arguments(arguments).resolve()[0] if arguments else data
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
    seeds, first_name = settings.seeds or table.seeds, table.cells[0].experiment
    num_folds = {  # invalid splits must raise an error before anything is trained
        name: drafts[first_name, name].data.resolve(protocol)[1].num_folds
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
        for fold in range(num_folds[protocol.name])
        for cell in table.cells
    )
    return Plan(table, protocols, seeds, data, facts, experiments)


def _model_arguments(cell: Cell, settings: Settings, table: Table) -> dict[str, Any]:
    # Returns the arguments of the experiments of a cell that do not depend on the protocol.
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
    data_section = config.get("data") or {}
    model, threshold = dict(config["model"]), cell.threshold
    if isinstance(model.get("threshold"), str):  # a metric: the experiment chooses the threshold
        threshold = model.pop("threshold")
    return {
        "model": model,
        "threshold": threshold,
        "transform": cell.transform or data_section.get("transform"),
        "train_transform": data_section.get("train_transform"),
        "epochs": settings.epochs or epochs,
        "batch_size": data_section.get("batch_size", 128),
        "trainer": trainer,
        "measure_memory": table.measure_memory,
    }


def _check_classes(table: Table, drafts: Any, source: DataSource, facts: DataFacts) -> None:
    for draft in drafts:
        num_classes = draft.model.get("num_classes")
        if num_classes is not None and facts.num_classes > num_classes:
            raise ValueError(
                f"the models of {table.name} distinguish {num_classes} classes (got "
                f"{facts.num_classes} in '{source.arguments.get('root') or source.class_path}')"
            )
