r"""The files with the results of a comparison: Markdown, CSV, JSON and a picture."""

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
from torch_geometric_tactile.data._sample_units import unit_names
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
from torch_geometric_tactile.io._csv_table import text_to_cell
from torch_geometric_tactile.reports._predictions import cell_text
from torch_geometric_tactile.visualization import ComparisonPanel, plot_comparison, save_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_PERCENT_METRICS = ("accuracy", "balanced_accuracy", "f1")
_CSV_COLUMNS = (
    *("model", "kind", "metric", "mean", "sd", "splits"),
    *("difference", "over_splits", "over_units", "parameters", "seconds", "milliseconds"),
    *("validation", "over_seeds"),
)
_TIME_MODELS_NOTE = (
    "The models temporal, lstm, temporal_cnn and minirocket process the frames in order, and "
    "svm_signal uses statistics of each signal; all others use the frames of a taxel as channels."
)
_PARTS_NOTE = "Scores over the test samples of all splits together, averaged over the seeds."
_UNIT_COLUMNS = ("set", "session", "group", "trial")
_MAX_UNITS = 50  # rows of a table by set, session or another unit, to keep the page readable
_SIMULATED_NOTE = "The samples are simulated: the results may not hold for a real hand."
_SERIES_NAMES = {False: "plain models", True: "graph models"}


def write_comparison(comparison: Comparison, out: PathLike) -> list[Path]:
    r"""Writes :obj:`NAME.md`, :obj:`NAME.csv`, :obj:`NAME.json` and, if a model has results,
    :obj:`NAME_predictions.csv` and :obj:`NAME.png`. Returns their paths.
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
    r"""Returns the header and the rows of the table of models, the best model first."""
    names = [
        f"{NAMES[key]}{' (%)' if key in _PERCENT_METRICS else ''}" for key in comparison.metrics
    ]
    header = ["model", "kind", *names]
    if comparison.is_validated:
        header.append(f"validation {names[comparison.metrics.index(comparison.metric)]}")
    if comparison.best_plain is not None:
        unit = " (points)" if comparison.metric in _PERCENT_METRICS else ""
        error_names = [name for name, _ in _standard_errors(comparison, None)]
        header += [f"vs {comparison.best_plain}{unit}", *error_names]
    header += ["parameters", "seconds", "ms per sample"]
    ordered = sorted(comparison.results, key=comparison.merit, reverse=True)
    return header, [_row(comparison, result) for result in ordered]


def _standard_errors(
    comparison: Comparison, difference: Difference | None
) -> list[tuple[str, float]]:
    # The column headers with their standard errors, which are NaN if there is no difference.
    errors = Difference(math.nan, math.nan, math.nan, 0, 0) if difference is None else difference
    columns = [(f"over {comparison.units.name}s", errors.over_units)]
    if not comparison.has_given_parts:
        return [("over splits", errors.over_splits), *columns]
    return [("over seeds", errors.over_seeds), *columns] if comparison.num_seeds > 1 else columns


def _row(comparison: Comparison, result: ModelResult) -> list[str]:
    scores = []
    for key in comparison.metrics:
        mean, sd = result.scores[key]
        text = format_score(key, mean)
        scores.append(text if math.isnan(sd) else f"{text} ± {format_score(key, sd)}")
    if comparison.is_validated:
        validation = math.nan if result.validation is None else result.validation
        scores.append(format_score(comparison.metric, validation))
    errors = _standard_errors(comparison, result.difference)
    difference_cells = [] if comparison.best_plain is None else [""] * (1 + len(errors))
    if result.difference is not None:
        mean = result.difference.mean
        sign = "+" if mean > 0 else ""
        number = format_score(comparison.metric, mean)
        mark = " *" if result.difference.is_beyond_noise else ""
        difference_cells = [f"{sign}{number}{mark}"]
        difference_cells += [f"± {format_score(comparison.metric, error)}" for _, error in errors]
    num_parameters = "" if result.num_parameters is None else f"{result.num_parameters:,.0f}"
    kind = "graph" if result.model.is_graph else "plain"
    times = [f"{result.seconds:,.1f}", f"{result.milliseconds:.2g}"]
    return [result.model.name, kind, *scores, *difference_cells, num_parameters, *times]


def comparison_markdown(comparison: Comparison) -> str:
    r"""Returns the page of a comparison as Markdown."""
    plan = comparison.run.plan
    header, rows = comparison_rows(comparison)
    lines = [f"# {printable(plan.table.title)}", "", printable(advice(comparison)), ""]
    lines += [f"**Scores are too high:** {markdown_text(text)}\n" for text in plan.shared]
    lines += [markdown_text(text) for text in _facts(comparison)]
    lines += ["", *markdown_table(header, _escaped(rows)), ""]
    lines += [
        "## Selected settings",
        "",
        *markdown_table(["model", "description", "selected"], _escaped(_settings_rows(comparison))),
    ]
    for kind, part_header, part_rows in _part_tables(comparison):
        lines += ["", f"## {NAMES[comparison.metric].capitalize()} by {kind}", "", _PARTS_NOTE, ""]
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
    counts = f" of {facts.num_frames} frames" if facts.num_frames else ""
    counts += f", {facts.num_trials:,} trials" if facts.num_trials else ""
    counts += f", {facts.num_groups:,} groups" if facts.num_groups else ""
    notes = [_differences_note(comparison), describe_cut(plan.data), describe_sensors(plan)]
    dataset = plan.data.load()
    if facts.num_frames is not None and not isinstance(dataset, GraphSamples):
        notes += [describe_left_out(dataset), _TIME_MODELS_NOTE]
    notes.append(_SIMULATED_NOTE if plan.data.kind == "simulated" else "")
    return [
        f"{facts.num_samples:,} samples{counts}{facts.part_note}; {protocol.protocol.describe()}, "
        f"{splits}. {_spread_note(comparison)}Settings were selected on a part of the training "
        "samples; each test part was used once.",
        *filter(None, [_model_choice_note(comparison), *notes]),
    ]


def _spread_note(comparison: Comparison) -> str:
    if not comparison.has_given_parts:
        return "Mean ± standard deviation over the splits. "
    if comparison.num_seeds == 1:
        return "Each model was trained once. "
    return f"Mean ± standard deviation over {comparison.num_seeds} training seeds. "


def _model_choice_note(comparison: Comparison) -> str:
    if not comparison.is_validated:
        return ""
    return (
        "The recommended model has the best score on the validation parts, which are held out from "
        "the training samples (or defined by the data set). Models are then trained again on all "
        "training samples. The test part is not used to select a model."
    )


def describe_sensors(plan: Plan) -> str:
    r"""Returns a note that lists the models that are left out because the samples have different
    layouts. The note is empty if all samples share a layout.
    """
    dataset = plan.data.load()
    if not isinstance(dataset, GraphSamples):
        return ""
    names = [model.name for model in MODELS if model.name != FLOOR]
    return (
        f"The samples have {dataset.describe_taxels()} and share no layout. Only networks with "
        "forward(x, edge_index, batch) and the constant baseline are compared. Models that need a "
        f"layout are left out: {', '.join(names)}."
    )


def _differences_note(comparison: Comparison) -> str:
    if comparison.best_plain is None:
        return ""
    runs = "seeds" if comparison.has_given_parts else "splits"
    return (
        f"Differences are relative to {comparison.best_plain}, the best plain model, on the same "
        f"samples, with standard errors over the {runs} and over the {comparison.units.name}s. "
        f"A * marks a difference beyond the noise. {RULE}"
    )


def _settings_rows(comparison: Comparison) -> list[list[str]]:
    rows = []
    transforms = {
        experiment.name: experiment.transform for experiment in comparison.run.plan.experiments
    }
    for result in comparison.results:
        transform = transforms[result.model.name]
        descriptions = [describe_setting(choice["setting"], transform) for choice in result.chosen]
        counts = {text: descriptions.count(text) for text in descriptions}
        summary = "; ".join(f"{text} ({n} x)" if n > 1 else text for text, n in counts.items())
        rows.append([result.model.name, result.model.title, summary])
    return rows


def _escaped(rows: Sequence[Sequence[str]]) -> list[list[str]]:
    return [[markdown_text(text) for text in row] for row in rows]


def comparison_csv(comparison: Comparison) -> str:
    r"""Returns all scores as CSV with one score per line, and the differences in the compared
    metric.
    """
    file = io.StringIO()
    writer = csv.writer(file, lineterminator="\n")
    writer.writerow(_CSV_COLUMNS)
    for result in comparison.results:
        kind = "graph" if result.model.is_graph else "plain"
        for key in comparison.metrics:
            mean, sd = result.scores[key]
            is_compared = key == comparison.metric
            difference = result.difference if is_compared else None
            numbers: list[float | None] = [mean, sd, comparison.num_splits]
            numbers += [None] * 3 if difference is None else difference[:3]
            extra_numbers = [result.validation if is_compared else None]
            extra_numbers.append(None if difference is None else difference.over_seeds)
            num_parameters = "" if result.num_parameters is None else result.num_parameters
            row = [
                kind,
                key,
                *map(_number_cell, numbers),
                num_parameters,
                result.seconds,
                result.milliseconds,
            ]
            row += map(_number_cell, extra_numbers)
            writer.writerow([text_to_cell(result.model.name), *row])
    return file.getvalue()


def _number_cell(value: object) -> object:
    return "" if value is None or (isinstance(value, float) and math.isnan(value)) else value


def _picture(comparison: Comparison) -> "Figure":
    metric = comparison.metric
    factor, unit = (100, " in %") if metric in _PERCENT_METRICS else (1, "")
    ordered = sorted(comparison.results, key=comparison.goodness, reverse=True)
    rows = {
        result.model.name: {
            _SERIES_NAMES[result.model.is_graph]: tuple(factor * v for v in result.scores[metric])
        }
        for result in ordered
    }
    series = [name for name in _SERIES_NAMES.values() if any(name in row for row in rows.values())]
    runs = "seeds" if comparison.has_given_parts else "splits"
    label = f"{NAMES[metric]}{unit}, mean and standard deviation over {runs}"
    if comparison.has_given_parts and comparison.num_seeds == 1:
        label = f"{NAMES[metric]}{unit}"
    panel = ComparisonPanel("", label, rows)  # type: ignore[arg-type]
    return plot_comparison([panel], series, comparison.run.plan.table.title)


def _part_tables(comparison: Comparison) -> Iterator[tuple[str, list[str], list[list[str]]]]:
    # Tables with the scores of all models on the test samples of each set, session, group or split
    # unit. A table is written only if there are 2 to 50 of them.
    dataset, metric = comparison.run.plan.data.load(), comparison.metric
    ordered = sorted(comparison.results, key=comparison.goodness, reverse=True)
    run_predictions: dict[str, list[Predictions]] = {result.model.name: [] for result in ordered}
    for experiment, result in comparison.run.results:
        if experiment.name in run_predictions:
            run_predictions[experiment.name].append(Predictions.from_dict(result["predictions"]))
    joined = {name: Predictions.join(predictions) for name, predictions in run_predictions.items()}
    for column in _unit_columns(comparison):
        if column == "trial":
            continue
        names_by_model = {
            name: _sample_names(dataset, column, prediction.index)
            for name, prediction in joined.items()
        }
        first_rows = _first_rows(next(iter(joined.values()), None))
        if column_of(dataset, column) is None or first_rows is None:
            continue
        names, counts = np.unique(
            next(iter(names_by_model.values()))[first_rows], return_counts=True
        )
        if not 2 <= len(names) <= _MAX_UNITS:
            continue
        rows = []
        for name, count in zip(names.tolist(), counts.tolist(), strict=True):
            parts = [joined[model].select(names_by_model[model] == name) for model in joined]
            scores = (
                prediction_scores(part.y, part.prediction, metric == "mae")[metric]
                for part in parts
            )
            rows.append([name, f"{count:,}", *(format_score(metric, score) for score in scores)])
        yield column, [column, "test samples", *joined], rows


def _unit_columns(comparison: Comparison) -> list[str]:
    by = {experiment.protocol.by for experiment in comparison.run.plan.experiments}
    return [*sorted(by - {*_UNIT_COLUMNS, "frame", "given"}), *_UNIT_COLUMNS]


def _first_rows(predictions: Predictions | None) -> np.ndarray | None:
    # The row of the first prediction of each sample: with several seeds, a sample has several
    # predictions.
    if predictions is None or predictions.index is None:
        return None
    return np.unique(predictions.index, return_index=True)[1]


def prediction_rows(comparison: Comparison) -> Iterator[list[Any]]:
    r"""Yields the header and then the rows of a table that has a row for each model, split and test
    sample.
    """
    dataset = comparison.run.plan.data.load()
    unit_columns = [c for c in _unit_columns(comparison) if column_of(dataset, c) is not None]
    y = column_of(dataset, "y")
    suffixes = [""] if y is None or y.ndim == 1 else [f"_{i}" for i in range(y.shape[1])]
    answers = [f"{name}{suffix}" for name in ("y", "prediction") for suffix in suffixes]
    yield ["model", "seed", "fold", "index", *unit_columns, *answers]
    for experiment, result in comparison.run.results:
        predictions = Predictions.from_dict(result["predictions"])
        columns = [
            _sample_names(dataset, column, predictions.index).tolist() for column in unit_columns
        ]
        for values in (predictions.y, predictions.prediction):
            columns += (
                _values_to_names(values, dataset.class_names).reshape(len(values), -1).T.tolist()
            )
        run_cells = [experiment.name, experiment.seed, experiment.fold]
        assert predictions.index is not None
        for row in zip(predictions.index.tolist(), *columns, strict=True):
            yield [*run_cells, *row]


def _sample_names(dataset: SampleSet, column_name: str, index: np.ndarray | None) -> np.ndarray:
    # `index` counts all samples of the data set, including samples that are not selected.
    column = column_of(dataset, column_name)
    if column is None or index is None:
        return np.array([])
    position = np.zeros(dataset.len(), dtype=np.int64)
    position[np.asarray(dataset.indices())] = np.arange(len(dataset))
    return _values_to_names(column[position[index]], unit_names(dataset, column_name))


def _values_to_names(values: np.ndarray, names: Any) -> np.ndarray:
    if values.dtype.kind == "f":
        return values
    return np.array(
        [names[value] if value < len(names) else str(value) for value in values.ravel().tolist()]
    )
