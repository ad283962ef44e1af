r"""The part of a table's page on the studies of its models, with their pictures."""

import math
import statistics
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
import torch

from torch_geometric_tactile._texts import markdown_table, markdown_text
from torch_geometric_tactile.analysis import class_confusion
from torch_geometric_tactile.experiments.plan import PlanRun
from torch_geometric_tactile.experiments.predictions import Predictions
from torch_geometric_tactile.experiments.tables import Cell
from torch_geometric_tactile.papers._table_caption import NOTHING
from torch_geometric_tactile.papers._table_numbers import finished_parts, pooled_predictions
from torch_geometric_tactile.visualization import (
    LearningCurves,
    plot_confusion,
    plot_curves,
    plot_feature_maps,
    plot_sample_embeddings,
    plot_training,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_WORST = 3


def study_lines(run: PlanRun) -> list[str]:
    r"""Returns the sections on studies, line by line; nothing for a table without any."""
    found = _studies(run)
    if not found:
        return []
    lines = [
        "## Studies",
        "",
        "Of the models of the first seed and fold, after the test.",
        "",
    ]
    for section in (_probe_lines, _time_lines, _dead_lines):
        lines += section(run, found)
    return lines + _confusion_lines(run, found) + _picture_lines(run, found)


def study_pictures(run: PlanRun) -> dict[str, "Figure"]:
    r"""Returns the pictures of studies, by what their files are called after the table's name."""
    return {name: draw() for name, draw in _drawings(run, _studies(run)).items()}


def _drawings(run: PlanRun, found: "_Found") -> dict[str, Callable[[], "Figure"]]:
    where = f"{run.plan.data.kind}, {run.plan.protocols[0].name}, seed 0, first fold"
    drawings: dict[str, Callable[[], Figure]] = {}
    learnt = {
        _name(cell): LearningCurves(**entry) for cell, entry in _of(run, found, "TrainingHistory")
    }
    if learnt:
        title = f"How the networks learnt ({where}); nothing was chosen by what was held out"
        drawings["training"] = partial(plot_training, learnt, title)
    places = {
        f"{_name(cell)}: {entry['what']}": (entry["place"], entry["label"])
        for cell, entry in _of(run, found, "FeatureEmbedding")
    }
    if places:
        title = f"t-SNE of samples that were held out ({where})"
        drawings["t-sne"] = partial(plot_sample_embeddings, places, title)
    for cell, entry in _of(run, found, "FeatureMaps"):
        maps = {"maps with the largest activations": entry["maps"]}
        if "bilinear" in entry:
            maps["their bilinear features"] = entry["bilinear"]
        title = f"Feature maps of {_name(cell)} ({where})"
        drawings[f"maps-{cell.experiment}"] = partial(
            plot_feature_maps, entry["image"], maps, title
        )
    for cell, entry in _of(run, found, "Confusion"):
        predicted = _predictions(run, cell)
        if predicted is not None:
            title = (
                f"{_name(cell)}: percent of each class ({run.plan.data.kind}, all folds, seed 0)"
            )
            drawings[f"confusion-{cell.experiment}"] = partial(
                plot_confusion, _counts(predicted, entry), entry["class_names"], title
            )
    dead = _dead_curves(run, found)
    if dead:
        title = f"Accuracy where rows of the array are dead ({where}); not trained on such"
        drawings["dead-rows"] = partial(plot_curves, dead, "dead rows", "Accuracy in %", title)
    return drawings


_Found = Mapping[str, Mapping[str, Any]]


def _studies(run: PlanRun) -> _Found:
    # What was found by experiment and study, of the first protocol.
    first = run.plan.protocols[0].name
    return {
        e.name: result["studies"]
        for e, result in run.results
        if "studies" in result and e.protocol_name == first
    }


def _of(run: PlanRun, found: _Found, study: str) -> Iterator[tuple[Cell, Any]]:
    seen = set()
    for cell in run.plan.table.cells:
        entry = found.get(cell.experiment, {}).get(study)
        code = run.plan.cell_experiment(cell).code
        if entry is not None and code not in seen:  # two places may be of one configuration
            seen.add(code)
            yield cell, entry


def _name(cell: Cell) -> str:
    return f"{cell.row}: {cell.column}" if cell.column else cell.row


def _probe_lines(run: PlanRun, found: _Found) -> list[str]:
    entries = list(_of(run, found, "LayerProbes"))
    if not entries:
        return []
    layers = list(dict.fromkeys(name for _, entry in entries for name in entry["accuracy"]))
    rows = []
    for cell, entry in entries:
        if cell.layers:
            printed = [f"{cell.layers[n]:.1f}" if n in cell.layers else "" for n in layers]
            rows.append([markdown_text(_name(cell)), "published", *printed])
        accuracy = entry["accuracy"]
        ours = [f"{100 * accuracy[n]:.1f}" if n in accuracy else "" for n in layers]
        rows.append(["" if cell.layers else markdown_text(_name(cell)), "ours", *ours])
    number = max(entry["num_samples"] for _, entry in entries)
    return [
        "### Accuracy of single layers in %",
        "",
        "Multinomial logistic regressions on the frozen features of one layer, each sample divided "
        f"by its L2 norm, fitted on {number:,} samples of the training part. The paper does "
        "not describe its probes.",
        "",
        *markdown_table(["model", "", *layers], rows),
        "",
    ]


def _time_lines(run: PlanRun, found: _Found) -> list[str]:
    entries = list(_of(run, found, "FrameTime"))
    if not entries:
        return []
    rows = []
    for cell, entry in entries:
        mean, spread = _over_folds(run, cell)
        milliseconds = cell.published.get("milliseconds")
        rows.append(
            [
                markdown_text(_name(cell)),
                _accuracy(mean, spread),
                f"{entry['milliseconds']:.2f}",
                "" if milliseconds is None else f"{milliseconds:g}",
            ]
        )
    return [
        "### Time of one sample",
        "",
        "Median time from readings to a class, one sample at a time on one thread, with other runs "
        "on the machine. Networks run in eager mode. Accuracy as mean ± standard deviation over "
        "the runs (seeds and folds).",
        "",
        *markdown_table(["model", "accuracy (%)", "ms", "published ms"], rows),
        "",
    ]


def _accuracy(mean: float, spread: float) -> str:
    if math.isnan(mean):
        return NOTHING
    return f"{mean:.1f}" if math.isnan(spread) else f"{mean:.1f} ± {spread:.1f}"


def _over_folds(run: PlanRun, cell: Cell) -> tuple[float, float]:
    first = run.plan.protocols[0].name
    values = [
        100 * result["metrics"]["accuracy"]
        for e, result in run.results
        if e.name == cell.experiment and e.protocol_name == first
    ]
    if not values:
        return math.nan, math.nan
    return statistics.fmean(values), statistics.stdev(values) if len(values) > 1 else math.nan


def _dead_lines(run: PlanRun, found: _Found) -> list[str]:
    entries = list(_of(run, found, "DeadRows"))
    if not entries:
        return []
    numbers = entries[0][1]["num_rows"]
    rows = [
        [markdown_text(_name(cell)), *(f"{100 * value:.1f}" for value in entry["accuracy"])]
        for cell, entry in entries
    ]
    return [
        "### Accuracy in % with dead rows",
        "",
        "The given number of rows of each sample, drawn at random, have the reading at rest. No "
        "model was trained on such samples.",
        "",
        *markdown_table(["model", *(f"{number} dead" for number in numbers)], rows),
        "",
    ]


def _dead_curves(run: PlanRun, found: _Found) -> dict[str, list[tuple[float, float, float]]]:
    return {
        _name(cell): [
            (float(number), 100 * value, math.nan)
            for number, value in zip(entry["num_rows"], entry["accuracy"], strict=True)
        ]
        for cell, entry in _of(run, found, "DeadRows")
    }


def _predictions(run: PlanRun, cell: Cell) -> Predictions | None:
    # Of the first seed, if all its folds are there.
    first = run.plan.protocols[0].name
    for part, results in finished_parts(run).items():
        if (part.experiment, part.protocol, part.seed) == (cell.experiment, first, 0):
            return pooled_predictions(results)
    return None


def _counts(predicted: Predictions, entry: Mapping[str, Any]) -> Any:
    y, said = torch.from_numpy(predicted.y.copy()), torch.from_numpy(predicted.prediction.copy())
    return class_confusion(y, said, len(entry["class_names"])).numpy()


def _confusion_lines(run: PlanRun, found: _Found) -> list[str]:
    lines = []
    for cell, entry in _of(run, found, "Confusion"):
        predicted = _predictions(run, cell)
        if predicted is None:
            continue
        counts, names = _counts(predicted, entry), entry["class_names"]
        recall = counts.diagonal() / counts.sum(axis=1).clip(min=1)
        order = recall.argsort()
        best = ", ".join(f"{names[i]} {100 * recall[i]:.1f}" for i in order[::-1][:_WORST])
        worst = ", ".join(f"{names[i]} {100 * recall[i]:.1f}" for i in order[:_WORST])
        wrong = counts - np.diag(counts.diagonal())
        pairs = [
            f"{names[i // len(names)]} predicted as {names[i % len(names)]} ({wrong.flat[i]} times)"
            for i in wrong.ravel().argsort()[::-1][:_WORST]
            if wrong.flat[i]
        ]
        lines.append(
            markdown_text(
                f"{_name(cell)}, accuracy of a class in %: best {best}; worst {worst}"
                + (f"; most frequent errors: {', '.join(pairs)}." if pairs else ".")
            )
        )
    return ["### Confusion", "", *(f"* {line}" for line in lines), ""] if lines else []


def _picture_lines(run: PlanRun, found: _Found) -> list[str]:
    name = run.plan.table.name
    names = [f"`{name}-{suffix}.png`" for suffix in _drawings(run, found)]
    return [f"Pictures: {', '.join(names)}.", ""] if names else []
