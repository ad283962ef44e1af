r"""The numbers of a table: what is published, and what our runs gave."""

import math
import statistics
from collections import Counter, defaultdict
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from sklearn.metrics import balanced_accuracy_score

from torch_geometric_tactile.experiments._sample_draws import Draws
from torch_geometric_tactile.experiments.plan import PlanRun
from torch_geometric_tactile.experiments.predictions import Predictions
from torch_geometric_tactile.experiments.tables import Table

PUBLISHED = "published"
ALL = "all runs"
_PERCENT = (
    "accuracy",
    "label_accuracy",
    "f1",
    "f1_positive",
    "precision_positive",
    "recall_positive",
)
_OF_PAPER = {
    "accuracy": "accuracy",
    "variance": "draws_variance",
    "f1": "f1_positive",
    "auc": "auroc",
    "memory": "peak_memory_mb",
}
_COSTS = ("peak_memory_mb", "frames_per_second", "num_parameters", "train_seconds")


class Number(NamedTuple):
    r"""A number of a table: :obj:`source` is :obj:`"published"`, the name of a protocol, or
    :obj:`"all runs"` for what a protocol does not change; :obj:`spread` is the standard deviation
    over the seeds, over the folds where there is one seed, NaN for less than two, or what the paper
    prints; :obj:`runs` is how many seeds (or runs, for :obj:`"all runs"`) it is the mean of.
    """

    experiment: str
    source: str
    metric: str
    mean: float
    spread: float
    runs: int


class SeedRuns(NamedTuple):
    r"""The folds of one experiment by one protocol with one seed."""

    experiment: str
    protocol: str
    seed: int


def finished_parts(run: PlanRun) -> dict[SeedRuns, list[dict[str, Any]]]:
    r"""Returns the results of all folds of each part, where no fold is missing."""
    planned = Counter(SeedRuns(e.name, e.protocol_name, e.seed) for e in run.plan.experiments)
    found: dict[SeedRuns, list[dict[str, Any]]] = defaultdict(list)
    for e, result in run.results:
        found[SeedRuns(e.name, e.protocol_name, e.seed)].append(result)
    return {part: results for part, results in found.items() if len(results) == planned[part]}


def pooled_predictions(results: list[dict[str, Any]]) -> Predictions:
    r"""Joins the folds of a part, so that every sample is judged once."""
    return Predictions.join([Predictions.from_dict(result["predictions"]) for result in results])


def table_numbers(run: PlanRun) -> list[Number]:
    r"""Returns all numbers of a table, in the order of its cells. Accuracies and F1 scores are in
    percent. Folds are pooled before they are scored.
    """
    measured: dict[tuple[str, str], dict[str, list[float]]] = defaultdict(lambda: defaultdict(list))
    folds: dict[tuple[str, str, str], list[float]] = defaultdict(list)
    for part, results in finished_parts(run).items():
        for metric, value in _values(results, run.plan.table.draws):
            measured[part.experiment, part.protocol][metric].append(value)
        if has_areas(run.plan.table):
            area = _decided_auroc(pooled_predictions(results))
            measured[part.experiment, part.protocol]["decided_auroc"].append(area)
        if run.plan.seeds == 1:
            for result in results:
                for metric, value in _values([result]):
                    folds[part.experiment, part.protocol, metric].append(value)
    for experiment, result in run.results:
        for metric in _COSTS:
            if result[metric] is not None:
                measured[experiment.name, ALL][metric].append(result[metric])
    sources = [*(protocol.name for protocol in run.plan.protocols), ALL]
    numbers = []
    for cell in run.plan.table.cells:
        for key, metric in _OF_PAPER.items():
            if key in cell.published:
                spread = cell.published.get("spread", math.nan) if key == "accuracy" else math.nan
                value = cell.published[key]
                name = metric if key != "variance" or run.plan.table.draws else key  # of runs
                numbers.append(Number(cell.experiment, PUBLISHED, name, value, spread, 0))
        for source in sources:
            for metric, values in measured.get((cell.experiment, source), {}).items():
                several = folds.get((cell.experiment, source, metric), values)
                spread = statistics.stdev(several) if len(several) > 1 else math.nan
                mean = statistics.fmean(values)
                numbers.append(Number(cell.experiment, source, metric, mean, spread, len(values)))
    return numbers


def run_rows(run: PlanRun) -> list[dict[str, Any]]:
    r"""Returns what each run gave, one row a run: from these, every mean and spread follows."""
    names = dict.fromkeys(e.name for e in run.plan.experiments)
    order = {name: i for i, name in enumerate(names)}
    return [
        {
            "experiment": e.name,
            "protocol": e.protocol_name,
            "seed": e.seed,
            "fold": e.fold,
            "num_train": result["num_train"],
            "num_test": result["num_test"],
            **dict(_values([result], run.plan.table.draws)),
            **{metric: result[metric] for metric in _COSTS if result[metric] is not None},
        }
        for e, result in sorted(run.results, key=lambda found: order[found[0].name])
    ]


def has_areas(table: Table) -> bool:
    r"""Whether areas under the ROC curve are shown, beside published ones of decisions."""
    return table.shows == "accuracy" and any("auc" in cell.published for cell in table.cells)


def _decided_auroc(said: Predictions) -> float:
    # The area under the ROC curve of decisions, which has one corner, as the mean over the classes.
    areas = [
        balanced_accuracy_score(said.y == number, said.prediction == number)
        for number in np.unique(said.y)
    ]
    return float(np.mean(areas))


def _values(
    results: list[dict[str, Any]], draws: Draws | None = None
) -> Iterator[tuple[str, float]]:
    metrics = results[0]["metrics"] if len(results) == 1 else pooled_predictions(results).metrics()
    if draws is not None:
        drawn = draws.metrics(pooled_predictions(results))
        yield "draws_accuracy", 100 * drawn["draws_accuracy"]
        yield "draws_variance", 100**2 * drawn["draws_variance"]
    names = results[0]["label_names"] or []
    for metric, value in metrics.items():
        if value is None or math.isnan(value):
            continue
        stem, _, number = metric.rpartition("_")
        if stem == "label_accuracy" and number.isdigit():
            yield f"label_accuracy: {names[int(number)]}", 100 * value
        else:
            yield metric, 100 * value if metric in _PERCENT else value
