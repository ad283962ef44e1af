r"""The section on studies of models in the page of a table, and the pictures of the studies."""

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
from torch_geometric_tactile.papers._table_caption import NO_NUMBER
from torch_geometric_tactile.papers._table_numbers import finished_parts, pooled_predictions
from torch_geometric_tactile.visualization import (
    plot_confusion,
    plot_curves,
    plot_feature_maps,
    plot_sample_embeddings,
)
from torch_geometric_tactile.visualization._training_history import LearningCurves, plot_training

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_NUM_LISTED = 3  # number of classes with the best and worst recall, and of most frequent errors


def study_lines(run: PlanRun) -> list[str]:
    r"""Returns the lines of the sections on studies, or an empty list if there are none."""
    studies = _read_studies(run)
    if not studies:
        return []
    lines = [
        "## Studies",
        "",
        "These studies use the models from the first seed and fold. They were run after the test.",
        "",
    ]
    for section in (_probe_lines, _time_lines, _dead_lines):
        lines += section(run, studies)
    return lines + _confusion_lines(run, studies) + _picture_lines(run, studies)


def study_pictures(run: PlanRun) -> dict[str, "Figure"]:
    r"""Returns the pictures of studies, by the suffixes of their file names."""
    return {name: draw() for name, draw in _drawings(run, _read_studies(run)).items()}


def _drawings(run: PlanRun, studies: "_Studies") -> dict[str, Callable[[], "Figure"]]:
    source = f"{run.plan.data.kind}, {run.plan.protocols[0].name}, seed 0, first fold"
    drawings: dict[str, Callable[[], Figure]] = {}
    curves = {
        _cell_name(cell): LearningCurves(**entry)
        for cell, entry in _study_results(run, studies, "TrainingHistory")
    }
    if curves:
        title = f"Training of the networks ({source}); no selection on held-out samples"
        drawings["training"] = partial(plot_training, curves, title)
    embeddings = {
        f"{_cell_name(cell)}: {entry['what']}": (entry["place"], entry["label"])
        for cell, entry in _study_results(run, studies, "FeatureEmbedding")
    }
    if embeddings:
        title = f"t-SNE of held-out samples ({source})"
        drawings["t-sne"] = partial(plot_sample_embeddings, embeddings, title)
    for cell, entry in _study_results(run, studies, "FeatureMaps"):
        maps = {"maps with the largest activations": entry["maps"]}
        if "bilinear" in entry:
            maps["their bilinear features"] = entry["bilinear"]
        title = f"Feature maps of {_cell_name(cell)} ({source})"
        drawings[f"maps-{cell.experiment}"] = partial(
            plot_feature_maps, entry["image"], maps, title
        )
    for cell, entry in _study_results(run, studies, "Confusion"):
        predictions = _first_seed_predictions(run, cell)
        if predictions is not None:
            title = (
                f"{_cell_name(cell)}: percent of each class "
                f"({run.plan.data.kind}, all folds, seed 0)"
            )
            drawings[f"confusion-{cell.experiment}"] = partial(
                plot_confusion, _confusion_counts(predictions, entry), entry["class_names"], title
            )
    dead_curves = _dead_curves(run, studies)
    if dead_curves:
        title = f"Accuracy with dead rows of the array ({source}); trained without dead rows"
        drawings["dead-rows"] = partial(
            plot_curves, dead_curves, "dead rows", "Accuracy in %", title
        )
    return drawings


# The results of studies, by experiment and name of the study.
_Studies = Mapping[str, Mapping[str, Any]]


def _read_studies(run: PlanRun) -> _Studies:
    # Studies are shown only for the first protocol.
    protocol = run.plan.protocols[0].name
    return {
        experiment.name: result["studies"]
        for experiment, result in run.results
        if "studies" in result and experiment.protocol_name == protocol
    }


def _study_results(run: PlanRun, studies: _Studies, name: str) -> Iterator[tuple[Cell, Any]]:
    listed_codes = set()
    for cell in run.plan.table.cells:
        entry = studies.get(cell.experiment, {}).get(name)
        code = run.plan.cell_experiment(cell).code
        if entry is not None and code not in listed_codes:  # two cells may show the same model
            listed_codes.add(code)
            yield cell, entry


def _cell_name(cell: Cell) -> str:
    return f"{cell.row}: {cell.column}" if cell.column else cell.row


def _probe_lines(run: PlanRun, studies: _Studies) -> list[str]:
    entries = list(_study_results(run, studies, "LayerProbes"))
    if not entries:
        return []
    layers = list(dict.fromkeys(name for _, entry in entries for name in entry["accuracy"]))
    rows = []
    for cell, entry in entries:
        if cell.layers:
            published = [
                f"{cell.layers[layer]:.1f}" if layer in cell.layers else "" for layer in layers
            ]
            rows.append([markdown_text(_cell_name(cell)), "published", *published])
        accuracy = entry["accuracy"]
        ours = [f"{100 * accuracy[layer]:.1f}" if layer in accuracy else "" for layer in layers]
        rows.append(["" if cell.layers else markdown_text(_cell_name(cell)), "ours", *ours])
    num_samples = max(entry["num_samples"] for _, entry in entries)
    return [
        "### Accuracy of single layers in %",
        "",
        "Each probe is a multinomial logistic regression on the frozen features of one layer, "
        f"fitted on {num_samples:,} samples from the training part. The features of each sample "
        "are divided by their L2 norm. The paper does not describe its probes.",
        "",
        *markdown_table(["model", "", *layers], rows),
        "",
    ]


def _time_lines(run: PlanRun, studies: _Studies) -> list[str]:
    entries = list(_study_results(run, studies, "FrameTime"))
    if not entries:
        return []
    rows = []
    for cell, entry in entries:
        mean, spread = _mean_and_spread(run, cell)
        milliseconds = cell.published.get("milliseconds")
        rows.append(
            [
                markdown_text(_cell_name(cell)),
                _format_accuracy(mean, spread),
                f"{entry['milliseconds']:.2f}",
                "" if milliseconds is None else f"{milliseconds:g}",
            ]
        )
    return [
        "### Time of one sample",
        "",
        "Median time from readings to a class, for one sample at a time on one thread, while other "
        "runs used the machine. Networks ran in eager mode. Accuracies are mean ± standard "
        "deviation over the runs (seeds and folds).",
        "",
        *markdown_table(["model", "accuracy (%)", "ms", "published ms"], rows),
        "",
    ]


def _format_accuracy(mean: float, spread: float) -> str:
    if math.isnan(mean):
        return NO_NUMBER
    return f"{mean:.1f}" if math.isnan(spread) else f"{mean:.1f} ± {spread:.1f}"


def _mean_and_spread(run: PlanRun, cell: Cell) -> tuple[float, float]:
    protocol = run.plan.protocols[0].name
    values = [
        100 * result["metrics"]["accuracy"]
        for experiment, result in run.results
        if experiment.name == cell.experiment and experiment.protocol_name == protocol
    ]
    if not values:
        return math.nan, math.nan
    return statistics.fmean(values), statistics.stdev(values) if len(values) > 1 else math.nan


def _dead_lines(run: PlanRun, studies: _Studies) -> list[str]:
    entries = list(_study_results(run, studies, "DeadRows"))
    if not entries:
        return []
    num_rows = entries[0][1]["num_rows"]
    rows = [
        [markdown_text(_cell_name(cell)), *(f"{100 * value:.1f}" for value in entry["accuracy"])]
        for cell, entry in entries
    ]
    return [
        "### Accuracy in % with dead rows",
        "",
        "In each sample, the given number of rows is drawn at random and set to the reading at "
        "rest. No model was trained on such samples.",
        "",
        *markdown_table(["model", *(f"{number} dead" for number in num_rows)], rows),
        "",
    ]


def _dead_curves(run: PlanRun, studies: _Studies) -> dict[str, list[tuple[float, float, float]]]:
    return {
        _cell_name(cell): [
            (float(number), 100 * value, math.nan)
            for number, value in zip(entry["num_rows"], entry["accuracy"], strict=True)
        ]
        for cell, entry in _study_results(run, studies, "DeadRows")
    }


def _first_seed_predictions(run: PlanRun, cell: Cell) -> Predictions | None:
    # Returns the predictions of the first seed if all its folds are finished.
    protocol = run.plan.protocols[0].name
    for part, results in finished_parts(run).items():
        if (part.experiment, part.protocol, part.seed) == (cell.experiment, protocol, 0):
            return pooled_predictions(results)
    return None


def _confusion_counts(predictions: Predictions, entry: Mapping[str, Any]) -> Any:
    y, predicted = (
        torch.from_numpy(predictions.y.copy()),
        torch.from_numpy(predictions.prediction.copy()),
    )
    return class_confusion(y, predicted, len(entry["class_names"])).numpy()


def _confusion_lines(run: PlanRun, studies: _Studies) -> list[str]:
    lines = []
    for cell, entry in _study_results(run, studies, "Confusion"):
        predictions = _first_seed_predictions(run, cell)
        if predictions is None:
            continue
        counts, names = _confusion_counts(predictions, entry), entry["class_names"]
        recall = counts.diagonal() / counts.sum(axis=1).clip(min=1)
        order = recall.argsort()
        best = ", ".join(f"{names[i]} {100 * recall[i]:.1f}" for i in order[::-1][:_NUM_LISTED])
        worst = ", ".join(f"{names[i]} {100 * recall[i]:.1f}" for i in order[:_NUM_LISTED])
        errors = counts - np.diag(counts.diagonal())
        pairs = [
            f"{names[i // len(names)]} predicted as {names[i % len(names)]} "
            f"({errors.flat[i]} times)"
            for i in errors.ravel().argsort()[::-1][:_NUM_LISTED]
            if errors.flat[i]
        ]
        lines.append(
            markdown_text(
                f"{_cell_name(cell)}, accuracy of a class in %: best {best}; worst {worst}"
                + (f"; most frequent errors: {', '.join(pairs)}." if pairs else ".")
            )
        )
    return ["### Confusion", "", *(f"* {line}" for line in lines), ""] if lines else []


def _picture_lines(run: PlanRun, studies: _Studies) -> list[str]:
    name = run.plan.table.name
    names = [f"`{name}-{suffix}.png`" for suffix in _drawings(run, studies)]
    return [f"Pictures: {', '.join(names)}.", ""] if names else []
