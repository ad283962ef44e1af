r"""A comparison of models: Markdown, CSV, JSON and a picture."""

import csv
import io
import json
import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from torch_geometric_tactile._files import atomic_path
from torch_geometric_tactile._texts import markdown_table, markdown_text, printable
from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile.data._graph_samples import GraphSamples, SampleSet
from torch_geometric_tactile.experiments._compared_models import FLOOR, MODELS
from torch_geometric_tactile.experiments._held_out import column_of
from torch_geometric_tactile.experiments._scores import (
    NAMES,
    RULE,
    format_score,
    prediction_scores,
)
from torch_geometric_tactile.experiments._setting_words import describe_setting
from torch_geometric_tactile.experiments.advice import advice, to_dict
from torch_geometric_tactile.experiments.compared_windows import describe_cut, describe_left_out
from torch_geometric_tactile.experiments.comparison import Comparison, ModelResult
from torch_geometric_tactile.experiments.differences import Difference
from torch_geometric_tactile.experiments.plan import Plan
from torch_geometric_tactile.experiments.predictions import Predictions
from torch_geometric_tactile.io._csv_table import safe_cell
from torch_geometric_tactile.reports._predictions import cell_text
from torch_geometric_tactile.visualization import ComparisonPanel, plot_comparison, save_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PERCENT = ("accuracy", "balanced_accuracy", "f1")
_COLUMNS = (
    *("model", "kind", "metric", "mean", "sd", "splits"),
    *("difference", "over_splits", "over_units", "parameters", "seconds", "milliseconds"),
    *("validation", "over_seeds"),
)
_WHO_SEES_TIME = (
    "The models temporal, lstm, temporal_cnn and minirocket process the frames in their order, and "
    "svm_signal takes statistics of each signal; all others take the frames of a taxel as channels."
)
_PARTS = "The test samples of all splits together, with the mean over their seeds."
_KINDS = ("set", "session", "group", "trial")
_MOST = 50
_SIMULATED = "The samples are simulated: the results may not hold for a real hand."
_SERIES = {False: "plain models", True: "graph models"}


def write_comparison(comparison: Comparison, out: PathLike) -> list[Path]:
    r"""Writes :obj:`NAME.md`, :obj:`NAME.csv`, :obj:`NAME.json` and, if there is a result,
    :obj:`NAME_predictions.csv` and :obj:`NAME.png`, and returns their paths.
    """
    name = comparison.run.plan.table.name
    texts = {
        ".md": comparison_markdown(comparison),
        ".csv": comparison_csv(comparison),
        ".json": json.dumps(to_dict(comparison), indent=1) + "\n",
    }
    paths = [Path(out) / f"{name}{suffix}" for suffix in texts]
    for path, text in zip(paths, texts.values(), strict=True):
        with atomic_path(path) as temporary:
            temporary.write_text(text, encoding="utf-8")
    if comparison.results:
        paths.append(Path(out) / f"{name}_predictions.csv")
        with atomic_path(paths[-1]) as temporary, temporary.open("w", encoding="utf-8") as file:
            writer = csv.writer(file, lineterminator="\n")
            for row in prediction_rows(comparison):
                writer.writerow([cell_text(v) if isinstance(v, str) else v for v in row])
        paths.append(Path(out) / f"{name}.png")
        save_figure(_picture(comparison), paths[-1])
    return paths


def comparison_rows(comparison: Comparison) -> tuple[list[str], list[list[str]]]:
    r"""Returns the header and the rows of a table of a comparison, the best model first."""
    names = [f"{NAMES[key]}{' (%)' if key in PERCENT else ''}" for key in comparison.metrics]
    header = ["model", "kind", *names]
    if comparison.is_validated:
        header.append(f"validation {names[comparison.metrics.index(comparison.metric)]}")
    if comparison.best_plain is not None:
        unit = " (points)" if comparison.metric in PERCENT else ""
        errors = [name for name, _ in _errors(comparison, None)]
        header += [f"to {comparison.best_plain}{unit}", *errors]
    header += ["parameters", "seconds", "ms a sample"]
    ordered = sorted(comparison.results, key=comparison.merit, reverse=True)
    return header, [_row(comparison, result) for result in ordered]


def _errors(comparison: Comparison, difference: Difference | None) -> list[tuple[str, float]]:
    # The standard errors of a difference, by the headers of their columns.
    over = Difference(math.nan, math.nan, math.nan, 0, 0) if difference is None else difference
    columns = [(f"over {comparison.units.name}s", over.over_units)]
    if not comparison.has_given_parts:
        return [("over splits", over.over_splits), *columns]
    return [("over seeds", over.over_seeds), *columns] if comparison.num_seeds > 1 else columns


def _row(comparison: Comparison, result: ModelResult) -> list[str]:
    scores = []
    for key in comparison.metrics:
        mean, sd = result.scores[key]
        text = format_score(key, mean)
        scores.append(text if math.isnan(sd) else f"{text} ± {format_score(key, sd)}")
    if comparison.is_validated:
        value = math.nan if result.validation is None else result.validation
        scores.append(format_score(comparison.metric, value))
    errors = _errors(comparison, result.difference)
    difference = [] if comparison.best_plain is None else [""] * (1 + len(errors))
    if result.difference is not None:
        mean = result.difference.mean
        sign = "+" if mean > 0 else ""
        number = format_score(comparison.metric, mean)
        mark = " *" if result.difference.is_beyond_noise else ""
        difference = [f"{sign}{number}{mark}"]
        difference += [f"± {format_score(comparison.metric, error)}" for _, error in errors]
    size = "" if result.num_parameters is None else f"{result.num_parameters:,.0f}"
    kind = "graph" if result.model.is_graph else "plain"
    times = [f"{result.seconds:,.1f}", f"{result.milliseconds:.2g}"]
    return [result.model.name, kind, *scores, *difference, size, *times]


def comparison_markdown(comparison: Comparison) -> str:
    r"""Returns a comparison as a page."""
    plan = comparison.run.plan
    header, rows = comparison_rows(comparison)
    lines = [f"# {printable(plan.table.title)}", "", printable(advice(comparison)), ""]
    lines += [f"**Scores are too high:** {markdown_text(text)}\n" for text in plan.shared]
    lines += [markdown_text(text) for text in _facts(comparison)]
    lines += ["", *markdown_table(header, _escaped(rows)), ""]
    lines += [
        "## Chosen settings",
        "",
        *markdown_table(["model", "description", "chosen"], _escaped(_chosen(comparison))),
    ]
    for kind, part_header, part_rows in _part_tables(comparison):
        lines += ["", f"## {NAMES[comparison.metric].capitalize()} by {kind}", "", _PARTS, ""]
        lines += markdown_table(part_header, _escaped(part_rows))
    if comparison.run.failed:
        lines += ["", "## Failed runs", ""]
        lines += [f"- {markdown_text(f'{k}: {v}')}" for k, v in comparison.run.failed.items()]
    return "\n".join(lines) + "\n"


def _facts(comparison: Comparison) -> list[str]:
    plan = comparison.run.plan
    (protocol,) = plan.protocols
    facts = plan.facts
    splits = "1 split" if comparison.num_splits == 1 else f"{comparison.num_splits} splits"
    held = f" of {facts.num_frames} frames" if facts.num_frames else ""
    held += f", {facts.num_trials:,} trials" if facts.num_trials else ""
    held += f", {facts.num_groups:,} groups" if facts.num_groups else ""
    more = [_differences(comparison), describe_cut(plan.data), describe_sensors(plan)]
    dataset = plan.data.load()
    if facts.num_frames is not None and not isinstance(dataset, GraphSamples):
        more += [describe_left_out(dataset), _WHO_SEES_TIME]
    more.append(_SIMULATED if plan.data.kind == "simulated" else "")
    return [
        f"{facts.num_samples:,} samples{held}{facts.part_note}; {protocol.protocol.describe()}, "
        f"{splits}. {_spread(comparison)}Settings were "
        "chosen on a part of each training part; each test part was used once.",
        *filter(None, [_choice_of_model(comparison), *more]),
    ]


def _spread(comparison: Comparison) -> str:
    if not comparison.has_given_parts:
        return "Mean ± standard deviation over the splits. "
    if comparison.num_seeds == 1:
        return "Scores of one training of each model. "
    return f"Mean ± standard deviation over {comparison.num_seeds} seeds of the training. "


def _choice_of_model(comparison: Comparison) -> str:
    if not comparison.is_validated:
        return ""
    return (
        "The model is recommended by the score on validation parts, which are held out of the "
        "samples to train on (the given ones, if there are any); models are then trained again on "
        "all of these. The test part chooses no model."
    )


def describe_sensors(plan: Plan) -> str:
    r"""Returns which models are left out where the samples have no layout that all share, and why;
    nothing where they have one.
    """
    dataset = plan.data.load()
    if not isinstance(dataset, GraphSamples):
        return ""
    names = [model.name for model in MODELS if model.name != FLOOR]
    return (
        f"The samples have {dataset.describe_taxels()}, and no layout that all share: networks run "
        "that are called as forward(x, edge_index, batch), and the constant answer. Left out are "
        f"the models of one layout: {', '.join(names)}."
    )


def _differences(comparison: Comparison) -> str:
    if comparison.best_plain is None:
        return ""
    runs = "seeds" if comparison.has_given_parts else "splits"
    return (
        f"Differences are to {comparison.best_plain}, the best plain model, on the same samples, "
        f"with their standard errors over the {runs} and over the {comparison.units.name}s; * is "
        f"beyond the noise. {RULE}"
    )


def _chosen(comparison: Comparison) -> list[list[str]]:
    rows = []
    transforms = {e.name: e.transform for e in comparison.run.plan.experiments}
    for result in comparison.results:
        transform = transforms[result.model.name]
        texts = [describe_setting(chosen["setting"], transform) for chosen in result.selections]
        counted = {text: texts.count(text) for text in texts}
        said = "; ".join(f"{text} ({n} x)" if n > 1 else text for text, n in counted.items())
        rows.append([result.model.name, result.model.title, said])
    return rows


def _escaped(rows: Sequence[Sequence[str]]) -> list[list[str]]:
    return [[markdown_text(text) for text in row] for row in rows]


def comparison_csv(comparison: Comparison) -> str:
    r"""Returns all scores, one a line, and the differences of the score that is compared."""
    file = io.StringIO()
    writer = csv.writer(file, lineterminator="\n")
    writer.writerow(_COLUMNS)
    for result in comparison.results:
        kind = "graph" if result.model.is_graph else "plain"
        for key in comparison.metrics:
            mean, sd = result.scores[key]
            is_compared = key == comparison.metric
            difference = result.difference if is_compared else None
            numbers: list[float | None] = [mean, sd, comparison.num_splits]
            numbers += [None] * 3 if difference is None else difference[:3]
            more = [result.validation if is_compared else None]
            more.append(None if difference is None else difference.over_seeds)
            size = "" if result.num_parameters is None else result.num_parameters
            row = [kind, key, *map(_cell, numbers), size, result.seconds, result.milliseconds]
            row += map(_cell, more)
            writer.writerow([safe_cell(result.model.name), *row])
    return file.getvalue()


def _cell(value: object) -> object:
    return "" if value is None or (isinstance(value, float) and math.isnan(value)) else value


def _picture(comparison: Comparison) -> "Figure":
    metric = comparison.metric
    factor, unit = (100, " in %") if metric in PERCENT else (1, "")
    ordered = sorted(comparison.results, key=comparison.goodness, reverse=True)
    rows = {
        result.model.name: {
            _SERIES[result.model.is_graph]: tuple(factor * v for v in result.scores[metric])
        }
        for result in ordered
    }
    series = [name for name in _SERIES.values() if any(name in row for row in rows.values())]
    runs = "seeds" if comparison.has_given_parts else "splits"
    label = f"{NAMES[metric]}{unit}, mean and standard deviation over {runs}"
    if comparison.has_given_parts and comparison.num_seeds == 1:
        label = f"{NAMES[metric]}{unit}"
    panel = ComparisonPanel("", label, rows)  # type: ignore[arg-type]
    return plot_comparison([panel], series, comparison.run.plan.table.title)


def _part_tables(comparison: Comparison) -> Iterator[tuple[str, list[str], list[list[str]]]]:
    # The scores of the models on the test samples of each set, session or group, where there are 2
    # to 50 of a kind.
    dataset, metric = comparison.run.plan.data.load(), comparison.metric
    ordered = sorted(comparison.results, key=comparison.goodness, reverse=True)
    said: dict[str, list[Predictions]] = {result.model.name: [] for result in ordered}
    for experiment, result in comparison.run.results:
        if experiment.name in said:
            said[experiment.name].append(Predictions.from_dict(result["predictions"]))
    joined = {name: Predictions.join(predictions) for name, predictions in said.items()}
    for kind in _KINDS[:-1]:
        of_model = {name: _names(dataset, kind, j.index) for name, j in joined.items()}
        once = _first_places(next(iter(joined.values()), None))
        if column_of(dataset, kind) is None or once is None:
            continue
        names, counts = np.unique(next(iter(of_model.values()))[once], return_counts=True)
        if not 2 <= len(names) <= _MOST:
            continue
        rows = []
        for name, count in zip(names.tolist(), counts.tolist(), strict=True):
            parts = [joined[model].select(of_model[model] == name) for model in joined]
            scores = (prediction_scores(p.y, p.prediction, metric == "mae")[metric] for p in parts)
            rows.append([name, f"{count:,}", *(format_score(metric, score) for score in scores)])
        yield kind, [kind, "test samples", *joined], rows


def _first_places(said: Predictions | None) -> np.ndarray | None:
    # The first prediction of each sample, of which several seeds have predictions.
    if said is None or said.index is None:
        return None
    return np.unique(said.index, return_index=True)[1]


def prediction_rows(comparison: Comparison) -> Iterator[list[Any]]:
    r"""Yields the header of a table with a row for each model, split and test sample, and
    its rows.
    """
    dataset = comparison.run.plan.data.load()
    kinds = [kind for kind in _KINDS if column_of(dataset, kind) is not None]
    y = column_of(dataset, "y")
    width = [""] if y is None or y.ndim == 1 else [f"_{i}" for i in range(y.shape[1])]
    answers = [f"{name}{end}" for name in ("y", "prediction") for end in width]
    yield ["model", "seed", "fold", "index", *kinds, *answers]
    for experiment, result in comparison.run.results:
        said = Predictions.from_dict(result["predictions"])
        columns = [_names(dataset, kind, said.index).tolist() for kind in kinds]
        for values in (said.y, said.prediction):
            columns += _named(values, dataset.class_names).reshape(len(values), -1).T.tolist()
        head = [experiment.name, experiment.seed, experiment.fold]
        assert said.index is not None
        for row in zip(said.index.tolist(), *columns, strict=True):
            yield [*head, *row]


def _names(dataset: SampleSet, kind: str, index: np.ndarray | None) -> np.ndarray:
    # Of the samples with these places among all that the data set holds, selected or not.
    column = column_of(dataset, kind)
    if column is None or index is None:
        return np.array([])
    place = np.zeros(dataset.len(), dtype=np.int64)
    place[np.asarray(dataset.indices())] = np.arange(len(dataset))
    is_graphs = isinstance(dataset, GraphSamples)
    names = dataset.names(kind) if is_graphs else dataset._names.get(kind, ())
    return _named(column[place[index]], names)


def _named(values: np.ndarray, names: Any) -> np.ndarray:
    if values.dtype.kind == "f":
        return values
    return np.array([names[v] if v < len(names) else str(v) for v in values.ravel().tolist()])
