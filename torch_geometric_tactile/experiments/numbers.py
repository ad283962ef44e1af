r"""The numbers of a table: what is published, and what our runs gave."""

import math
import statistics
from collections import defaultdict
from collections.abc import Iterator
from typing import Any, NamedTuple

from torch_geometric_tactile.experiments.experiment import Experiment
from torch_geometric_tactile.experiments.tables import PublishedTable

_PERCENT = ("accuracy", "label_accuracy", "f1")
_PUBLISHED = {"accuracy": "accuracy", "auc": "auroc", "memory": "peak_memory_mb"}
ALL = "all runs"


class Number(NamedTuple):
    r"""A number of a table: :obj:`source` is :obj:`"published"`, :obj:`"by trial"`,
    :obj:`"by frame"` or, for what a split does not change, :obj:`"all runs"`; :obj:`spread` is the
    standard deviation over the seeds, NaN for less than two runs, or what the paper prints.
    """

    experiment: str
    source: str
    metric: str
    mean: float
    spread: float
    runs: int


def table_numbers(
    table: PublishedTable, results: list[tuple[Experiment, dict[str, Any]]]
) -> list[Number]:
    r"""Returns all numbers of a table, in the order of its cells. Accuracies and F1 scores are in
    percent.

    Args:
        table (PublishedTable): The table.
        results (list): The finished runs and their results.
    """
    measured: dict[tuple[str, str], dict[str, list[float]]] = defaultdict(lambda: defaultdict(list))
    for experiment, result in results:
        for metric, value in _values(result):
            measured[experiment.name, f"by {experiment.split_by}"][metric].append(value)
        for metric in ("peak_memory_mb", "frames_per_second", "num_parameters", "train_seconds"):
            if result[metric] is not None:
                measured[experiment.name, ALL][metric].append(result[metric])
    numbers = []
    for cell in table.cells:
        for key, metric in _PUBLISHED.items():
            if key in cell.published:
                spread = cell.published.get("spread", math.nan) if key == "accuracy" else math.nan
                value = cell.published[key]
                numbers.append(Number(cell.experiment, "published", metric, value, spread, 0))
        for source in ("by trial", "by frame", ALL):
            for metric, values in measured.get((cell.experiment, source), {}).items():
                spread = statistics.stdev(values) if len(values) > 1 else math.nan
                mean = statistics.fmean(values)
                numbers.append(Number(cell.experiment, source, metric, mean, spread, len(values)))
    return numbers


def _values(result: dict[str, Any]) -> Iterator[tuple[str, float]]:
    names = result["label_names"] or []
    for metric, value in result["metrics"].items():
        if value is None:
            continue
        stem, _, number = metric.rpartition("_")
        if stem == "label_accuracy" and number.isdigit():
            yield f"label_accuracy: {names[int(number)]}", 100 * value
        else:
            yield metric, 100 * value if metric in _PERCENT else value
