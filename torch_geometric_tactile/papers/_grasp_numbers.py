r"""The numbers of the demo's report."""

import math
import statistics
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

from torch_geometric_tactile.experiments.comparison import Summary
from torch_geometric_tactile.experiments.differences import Difference, run_difference
from torch_geometric_tactile.experiments.predictions import Predictions
from torch_geometric_tactile.experiments.run_plan import PlanRun
from torch_geometric_tactile.papers._table_numbers import finished_parts, pooled_predictions


class Judged(NamedTuple):
    r"""What was judged: a model, by a protocol of the table, with what is done to the readings
    before it sees them, and a seed.
    """

    model: str
    protocol: str
    readings: str
    seed: int


def grasp_predictions(run: PlanRun) -> dict[Judged, Predictions]:
    r"""Returns what every model said, the folds of a protocol joined."""
    cells = {cell.experiment: cell for cell in run.plan.table.cells}
    judged = {}
    for part, results in finished_parts(run).items():
        cell = cells[part.experiment]
        key = Judged(cell.row, part.protocol, cell.column, part.seed)
        judged[key] = pooled_predictions(results)
    return judged


def grasp_records(predictions: dict[Judged, Predictions], run: PlanRun) -> Iterator[dict[str, Any]]:
    r"""Yields a record for each model, protocol, kind of readings and seed, and for each recording
    session of a given test part.
    """
    given = {entry.name for entry in run.plan.protocols if entry.protocol.by == "given"}
    for key, predicted in predictions.items():
        parts = {key.protocol: predicted}
        if key.protocol in given and predicted.session is not None:
            for session in np.unique(predicted.session):
                name = run.plan.facts.session_names[session]
                shown = name.removesuffix("_test").replace("_", " ")
                parts[shown] = predicted.select(predicted.session == session)
        for name, part in parts.items():
            metrics = part.metrics()
            yield {
                "model": key.model,
                "protocol": name,
                "readings": key.readings,
                "seed": key.seed,
                "num_samples": len(part.y),
                **{metric: metrics[metric] for metric in ("accuracy", "f1", "f1_positive")},
            }


def grasp_summary(
    records: list[dict[str, Any]],
) -> dict[str, dict[str, dict[str, dict[str, Summary]]]]:
    r"""Returns the scores by model, protocol, kind of readings and metric."""
    groups: dict[tuple[str, str, str], list[dict[str, Any]]] = {}
    for record in records:
        key = (record["model"], record["protocol"], record["readings"])
        groups.setdefault(key, []).append(record)
    summary: dict[str, dict[str, dict[str, dict[str, Summary]]]] = {}
    for (model, protocol, readings), group in groups.items():
        scores = {
            metric: _score([record[metric] for record in group])
            for metric in ("accuracy", "f1", "f1_positive")
        }
        summary.setdefault(model, {}).setdefault(protocol, {})[readings] = scores
    return summary


def grasp_differences(
    run: PlanRun, readings: str, first: str, second: str
) -> dict[str, Difference]:
    r"""Returns the accuracy of a model less that of another on the same readings, by protocol."""
    names = {cell.row: cell.experiment for cell in run.plan.table.cells if cell.column == readings}
    found = {
        entry.name: run_difference(run, names[first], names[second], entry.name)
        for entry in run.plan.protocols
    }
    return {protocol: difference for protocol, difference in found.items() if difference}


def _score(values: list[float]) -> Summary:
    spread = statistics.stdev(values) if len(values) > 1 else math.nan
    return Summary(statistics.fmean(values), spread)
