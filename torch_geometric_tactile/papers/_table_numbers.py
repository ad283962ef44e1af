r"""The numbers in a table: published numbers and results of our runs."""

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
ALL_RUNS = "all runs"
_PERCENT_METRICS = (
    "accuracy",
    "label_accuracy",
    "f1",
    "f1_positive",
    "precision_positive",
    "recall_positive",
)
# The metric for each key of published numbers.
_PUBLISHED_METRICS = {
    "accuracy": "accuracy",
    "variance": "draws_variance",
    "f1": "f1_positive",
    "auc": "auroc",
    "memory": "peak_memory_mb",
}
_COST_METRICS = ("peak_memory_mb", "frames_per_second", "num_parameters", "train_seconds")


class Number(NamedTuple):
    r"""A number in a table.

    :obj:`source` is :obj:`"published"`, the name of a protocol, or :obj:`"all runs"` for costs,
    which do not depend on the protocol. :obj:`spread` is the standard deviation over the seeds, or
    over the folds if there is one seed (NaN for fewer than two values). For a published number, it
    is the published spread. :obj:`runs` is the number of seeds in the mean or, for :obj:`"all
    runs"`, the number of runs.
    """

    experiment: str
    source: str
    metric: str
    mean: float
    spread: float
    runs: int


class SeedRuns(NamedTuple):
    r"""The folds of one experiment with one protocol and one seed."""

    experiment: str
    protocol: str
    seed: int


def finished_parts(run: PlanRun) -> dict[SeedRuns, list[dict[str, Any]]]:
    r"""Returns the results of all folds of each part. Parts with a missing fold are left out."""
    planned = Counter(
        SeedRuns(experiment.name, experiment.protocol_name, experiment.seed)
        for experiment in run.plan.experiments
    )
    results_by_part: dict[SeedRuns, list[dict[str, Any]]] = defaultdict(list)
    for experiment, result in run.results:
        results_by_part[
            SeedRuns(experiment.name, experiment.protocol_name, experiment.seed)
        ].append(result)
    return {
        part: results for part, results in results_by_part.items() if len(results) == planned[part]
    }


def pooled_predictions(results: list[dict[str, Any]]) -> Predictions:
    r"""Returns the joined predictions of all folds of a part. Every test sample occurs once."""
    return Predictions.join([Predictions.from_dict(result["predictions"]) for result in results])


def table_numbers(run: PlanRun) -> list[Number]:
    r"""Returns all numbers of a table, in the order of its cells. Accuracies and F1 scores are in
    percent. The predictions of all folds are pooled before scoring.
    """
    measured: dict[tuple[str, str], dict[str, list[float]]] = defaultdict(lambda: defaultdict(list))
    folds: dict[tuple[str, str, str], list[float]] = defaultdict(list)
    for part, results in finished_parts(run).items():
        for metric, value in _metric_values(results, run.plan.table.draws):
            measured[part.experiment, part.protocol][metric].append(value)
        if has_areas(run.plan.table):
            area = _decision_auroc(pooled_predictions(results))
            measured[part.experiment, part.protocol]["decided_auroc"].append(area)
        if run.plan.seeds == 1:
            for result in results:
                for metric, value in _metric_values([result]):
                    folds[part.experiment, part.protocol, metric].append(value)
    for experiment, result in run.results:
        for metric in _COST_METRICS:
            if result[metric] is not None:
                measured[experiment.name, ALL_RUNS][metric].append(result[metric])
    sources = [*(protocol.name for protocol in run.plan.protocols), ALL_RUNS]
    numbers = []
    for cell in run.plan.table.cells:
        for key, metric in _PUBLISHED_METRICS.items():
            if key in cell.published:
                spread = cell.published.get("spread", math.nan) if key == "accuracy" else math.nan
                value = cell.published[key]
                name = metric if key != "variance" or run.plan.table.draws else key  # over runs
                numbers.append(Number(cell.experiment, PUBLISHED, name, value, spread, 0))
        for source in sources:
            for metric, values in measured.get((cell.experiment, source), {}).items():
                spread_values = folds.get((cell.experiment, source, metric), values)
                spread = statistics.stdev(spread_values) if len(spread_values) > 1 else math.nan
                mean = statistics.fmean(values)
                numbers.append(Number(cell.experiment, source, metric, mean, spread, len(values)))
    return numbers


def run_rows(run: PlanRun) -> list[dict[str, Any]]:
    r"""Returns the metrics and costs of all runs, one row per run, in the order of the models."""
    names = dict.fromkeys(experiment.name for experiment in run.plan.experiments)
    order = {name: i for i, name in enumerate(names)}
    return [
        {
            "experiment": experiment.name,
            "protocol": experiment.protocol_name,
            "seed": experiment.seed,
            "fold": experiment.fold,
            "num_train": result["num_train"],
            "num_test": result["num_test"],
            **dict(_metric_values([result], run.plan.table.draws)),
            **{metric: result[metric] for metric in _COST_METRICS if result[metric] is not None},
        }
        for experiment, result in sorted(run.results, key=lambda entry: order[entry[0].name])
    ]


def has_areas(table: Table) -> bool:
    r"""Returns whether a table shows areas under the ROC curve. This requires published areas."""
    return table.shows == "accuracy" and any("auc" in cell.published for cell in table.cells)


def _decision_auroc(predictions: Predictions) -> float:
    # Returns the mean over the classes of the area under the ROC curve for decisions. The curve has
    # one corner, so its area is the balanced accuracy.
    areas = [
        balanced_accuracy_score(predictions.y == label, predictions.prediction == label)
        for label in np.unique(predictions.y)
    ]
    return float(np.mean(areas))


def _metric_values(
    results: list[dict[str, Any]], draws: Draws | None = None
) -> Iterator[tuple[str, float]]:
    metrics = results[0]["metrics"] if len(results) == 1 else pooled_predictions(results).metrics()
    if draws is not None:
        draw_metrics = draws.metrics(pooled_predictions(results))
        yield "draws_accuracy", 100 * draw_metrics["draws_accuracy"]
        yield "draws_variance", 100**2 * draw_metrics["draws_variance"]
    names = results[0]["label_names"] or []
    for metric, value in metrics.items():
        if value is None or math.isnan(value):
            continue
        stem, _, number = metric.rpartition("_")
        if stem == "label_accuracy" and number.isdigit():
            yield f"label_accuracy: {names[int(number)]}", 100 * value
        else:
            yield metric, 100 * value if metric in _PERCENT_METRICS else value
