r"""Writes the files of a table: Markdown, CSV and pictures of our numbers and published numbers."""

import csv
import io
import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING

from torch_geometric_tactile._files import atomic_path
from torch_geometric_tactile._texts import markdown_table, markdown_text, printable
from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile.experiments.plan import Plan, PlanRun
from torch_geometric_tactile.experiments.tables import Cell
from torch_geometric_tactile.io._csv_table import text_to_cell
from torch_geometric_tactile.papers._table_caption import NO_NUMBER, caption, cost_note
from torch_geometric_tactile.papers._table_notes import (
    area_note,
    correlation_notes,
    draws_note,
    ordering_lines,
    orderings_csv,
    positive_note,
)
from torch_geometric_tactile.papers._table_numbers import (
    ALL_RUNS,
    PUBLISHED,
    Number,
    has_areas,
    run_rows,
    table_numbers,
)
from torch_geometric_tactile.papers._table_studies import study_lines, study_pictures
from torch_geometric_tactile.training._config_files import TEMPLATES
from torch_geometric_tactile.visualization import (
    ComparisonPanel,
    plot_comparison,
    plot_curves,
    save_figure,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# Decimals of metrics that are not in percent.
_DIGITS = {
    "auroc": 3,
    "decided_auroc": 3,
    "draws_variance": 2,
    "peak_memory_mb": 0,
    "frames_per_second": 0,
    "num_parameters": 0,
}
# The key of published numbers, for each metric that has a different name in the tables.
_PUBLISHED_KEYS = {
    "draws_variance": "variance",
    "auroc": "auc",
    "f1": "",  # papers publish the F1 score of one class
    "f1_positive": "f1",
    "peak_memory_mb": "memory",
    "ratio": "memory",
}
_NumberIndex = dict[tuple[str, str, str], Number]
# A line in a table or a bar in a picture: source, metric and label.
_Series = tuple[str, str, str]


def write_table(run: PlanRun, out: PathLike) -> list[Path]:
    r"""Writes the files of a table and returns their paths:

    * :obj:`NAME.md`, :obj:`NAME.csv` and :obj:`NAME.png`: our numbers and the published numbers;
    * :obj:`NAME-runs.csv`: one line per run;
    * :obj:`NAME-orderings.csv`: one line per pair of models, if the table has orderings;
    * :obj:`NAME-*.png`: the pictures of studies.
    """
    suffixes = (".md", ".csv", ".png", "-runs.csv")
    paths = [Path(out) / f"{run.plan.table.name}{suffix}" for suffix in suffixes]
    page, numbers, picture, runs = paths
    texts = {page: markdown(run), numbers: csv_text(run), runs: _runs_csv(run)}
    if run.plan.table.orderings:
        paths.append(Path(out) / f"{run.plan.table.name}-orderings.csv")
        texts[paths[-1]] = orderings_csv(run)
    for path, text in texts.items():
        with atomic_path(path) as temporary:
            temporary.write_text(text, encoding="utf-8")
    save_figure(_picture(run), picture)
    for suffix, figure in study_pictures(run).items():
        paths.append(Path(out) / f"{run.plan.table.name}-{suffix}.png")
        save_figure(figure, paths[-1])
    return paths


def _picture(run: PlanRun) -> "Figure":
    if run.plan.table.axis:
        return plot_curves(_curves(run), run.plan.table.axis, "Accuracy in %", _title(run))
    series = dict.fromkeys(name for _, group in _drawn_groups(run) for _, _, name in group)
    return plot_comparison(_panels(run), list(series), _title(run))


def _curves(run: PlanRun) -> dict[str, list[tuple[float, float, float]]]:
    # Returns one line for each row and protocol. The columns are numbers, which are the positions
    # on the axis.
    index = _number_index(run)
    curves: dict[str, list[tuple[float, float, float]]] = {}
    for source in (PUBLISHED, *(protocol.name for protocol in run.plan.protocols)):
        for cell in run.plan.table.cells:
            number = index.get((cell.experiment, source, "accuracy"))
            if number is not None:
                name = (
                    _published_label(run)
                    if source == PUBLISHED
                    else f"{run.plan.data.kind}, {source}"
                )
                point = (float(cell.column), number.mean, number.spread)
                curves.setdefault(f"{cell.row} ({name})", []).append(point)
    return {name: sorted(points) for name, points in curves.items()}


def csv_text(run: PlanRun) -> str:
    r"""Returns all numbers as CSV, with one number per line. The columns are the cell in the table,
    source, metric, mean, standard deviation and number of runs.
    """
    cells = {cell.experiment: cell for cell in run.plan.table.cells}
    file = io.StringIO()
    writer = csv.writer(file, lineterminator="\n")
    writer.writerow(
        ["section", "row", "column", "experiment", "source", "data", "metric", "mean", "sd", "runs"]
    )
    measured_on = f"{run.plan.table.measured_on}, {run.plan.table.recordings}"
    for number in table_numbers(run):
        cell = cells[number.experiment]
        is_published = number.source == PUBLISHED
        writer.writerow(
            [
                *map(text_to_cell, (cell.section, cell.row, cell.column, cell.experiment)),
                text_to_cell(number.source),
                measured_on if is_published else run.plan.data.kind,
                text_to_cell(number.metric),
                f"{number.mean:.6g}" if is_published else repr(number.mean),
                "" if math.isnan(number.spread) else f"{number.spread:.6g}",
                "" if is_published else number.runs,
            ]
        )
    return file.getvalue()


def _runs_csv(run: PlanRun) -> str:
    r"""Returns the metrics and costs of all runs as CSV, with one run per line, accuracies in
    percent.
    """
    rows = run_rows(run)
    file = io.StringIO()
    writer = csv.DictWriter(file, dict.fromkeys(chain.from_iterable(rows)), lineterminator="\n")
    writer.writeheader()
    for row in rows:
        writer.writerow(
            {
                text_to_cell(name): f"{value:.6g}"
                if isinstance(value, float)
                else text_to_cell(str(value))
                for name, value in row.items()
            }
        )
    return file.getvalue()


def markdown(run: PlanRun) -> str:
    r"""Returns the page of the table as Markdown: its caption, our numbers beside the published
    numbers, and the cost of each model.
    """
    table, index = run.plan.table, _number_index(run)
    lines = [f"# {printable(table.title)}", "", printable(caption(run)), ""]
    notes = (positive_note(run), draws_note(run), area_note(run))
    for note in filter(None, (*correlation_notes(run, index.values()), *notes)):
        lines += [printable(note), ""]
    if table.see_also:
        lines += [f"See also: {printable(table.see_also)}", ""]
    for heading, series in _groups(run):
        for section in table.sections:
            name = f"{heading}, {markdown_text(section)}" if section else heading
            lines += [f"## {name}", "", *_section_table(run, index, section, series)]
            lines.append("")
    lines += ordering_lines(run)
    lines += study_lines(run)
    lines += ["## Cost of the models", "", cost_note(run.plan), ""]
    metrics = ("num_parameters", "frames_per_second", "peak_memory_mb", "train_seconds")
    models = _named_models(run.plan)
    lines += markdown_table(
        ["experiment", "parameters", "frames/s", "peak memory (MB)", "seconds of training"],
        [
            [
                f"`{printable(name).replace('|', '')}`",
                *(
                    _format_number(index.get((cell.experiment, ALL_RUNS, metric)))
                    for metric in metrics
                ),
            ]
            for name, cell in models.items()
        ],
    )
    return "\n".join([*lines, ""])


def _section_table(
    run: PlanRun, index: _NumberIndex, section: str, series: Sequence[_Series]
) -> list[str]:
    table = run.plan.table
    columns = table.columns(section)
    rows = [
        (row, i, name, _row_texts(run, index, section, row, source, metric))
        for row in table.rows
        if any(_is_in_row(cell, section, row) for cell in table.cells)
        for i, (source, metric, name) in enumerate(_row_series(run, section, row, series))
    ]
    if table.axis:  # one row for each number on the axis, since there may be many
        headings = [f"{row}, {name}" for row, _, name, _ in rows]
        texts_by_column = zip(columns, *(texts for *_, texts in rows), strict=True)
        return markdown_table([table.axis, *headings], [[*texts] for texts in texts_by_column])
    return markdown_table(
        ["model", "", *columns],
        [
            [markdown_text(row) if i == 0 else "", markdown_text(name), *texts]
            for row, i, name, texts in rows
        ],
    )


def _named_models(plan: Plan) -> dict[str, Cell]:
    # Two cells may show the same model, which is trained once and listed once. Models with the same
    # configuration but different data or transforms are named after their experiments.
    codes = {
        cell.experiment: replace(plan.cell_experiment(cell), studies=[]).code
        for cell in plan.table.cells
    }
    codes_by_config: dict[str, set[str]] = {}
    for cell in plan.table.cells:
        codes_by_config.setdefault(_config_name(cell), set()).add(codes[cell.experiment])
    models: dict[str, Cell] = {}
    for cell in plan.table.cells:
        name = _config_name(cell)
        is_ambiguous = len(codes_by_config[name]) > 1 or cell.data
        models[cell.experiment if is_ambiguous else name] = cell
    return models


def _config_name(cell: Cell) -> str:
    # Returns the name for `tactile fit --config` if the cell is an experiment from a template.
    config = str(cell.config)
    return config if config.partition("/")[0] in TEMPLATES else cell.experiment


def _row_texts(
    run: PlanRun, index: _NumberIndex, section: str, row: str, source: str, metric: str
) -> list[str]:
    cells_by_column = {
        cell.column: cell for cell in run.plan.table.cells if _is_in_row(cell, section, row)
    }
    texts = []
    for column in run.plan.table.columns(section):
        cell = cells_by_column.get(column)
        if cell is None:
            texts.append("")  # not in the table of the paper
        elif metric == "ratio":
            ratio = _memory_ratio(run, index, cell, source)
            texts.append(NO_NUMBER if ratio is None else f"{ratio:.2f}")
        else:
            text = _format_number(index.get((cell.experiment, source, metric)), run.plan.seeds)
            variance = index.get((cell.experiment, source, "variance"))
            if variance is not None and metric == "accuracy":
                text += f" (variance {variance.mean:g})"
            texts.append(text)
    return texts


def _row_series(run: PlanRun, section: str, row: str, series: Sequence[_Series]) -> list[_Series]:
    # A model that is not in the paper has no line for published numbers.
    is_published = any(
        cell.published for cell in run.plan.table.cells if _is_in_row(cell, section, row)
    )
    return [entry for entry in series if is_published or entry[0] != PUBLISHED]


def _is_in_row(cell: Cell, section: str, row: str) -> bool:
    return (cell.section, cell.row) == (section, row)


def _format_number(number: Number | None, seeds: int | None = None) -> str:
    if number is None:
        return NO_NUMBER
    digits = _DIGITS.get(number.metric, 2 if number.source == PUBLISHED else 1)
    if number.metric == "auroc" and number.source == PUBLISHED:
        digits = 4
    text = f"{number.mean:,.{digits}f}" if digits == 0 else f"{number.mean:.{digits}f}"
    if number.metric in ("num_parameters", "frames_per_second", "train_seconds"):
        return text
    if not math.isnan(number.spread):
        text += f" ± {number.spread:.{digits}f}"
    is_incomplete = (
        seeds is not None and number.source not in (PUBLISHED, ALL_RUNS) and number.runs < seeds
    )
    return f"{text} ({number.runs} of {seeds})" if is_incomplete else text


def _memory_ratio(run: PlanRun, index: _NumberIndex, cell: Cell, source: str) -> float | None:
    # Returns the memory relative to the first model in the table with the same inputs.
    base = next(
        candidate
        for candidate in run.plan.table.cells
        if (candidate.section, candidate.column) == (cell.section, cell.column)
    )
    number, base_number = (
        index.get((compared.experiment, source, "peak_memory_mb")) for compared in (cell, base)
    )
    return None if number is None or base_number is None else number.mean / base_number.mean


def _number_index(run: PlanRun) -> _NumberIndex:
    numbers = table_numbers(run)
    return {(number.experiment, number.source, number.metric): number for number in numbers}


def _groups(run: PlanRun) -> list[tuple[str, list[_Series]]]:
    # Returns the headings of the page with the series that are shown below each heading.
    table, ours = run.plan.table, run.plan.data.kind
    protocols = [protocol.name for protocol in run.plan.protocols]
    if table.shows == "memory":
        return [
            (heading, [*_published_series(run, metric), (ALL_RUNS, metric, _memory_name(run))])
            for heading, metric in (
                ("Peak memory in MB", "peak_memory_mb"),
                (f"Memory relative to {table.rows[0]}", "ratio"),
            )
        ]
    kinds = {"accuracy": ""}
    if table.task == "multilabel":
        kinds = {"accuracy": ": all labels right", "label_accuracy": ": mean of the labels"}
    accuracy: list[_Series] = [
        (name, metric, f"{ours}, {name}{kind}")
        for name in protocols
        for metric, kind in kinds.items()
    ]
    groups = [("Accuracy in %", [*_published_series(run, "accuracy"), *accuracy])]
    if table.draws is not None:
        groups += [_draws_group(run)]
    headings = {"auroc": "Area under the ROC curve", "f1": "F1 score in %"}
    if table.positive:
        headings = {
            "precision_positive": f"Precision of {table.positive} in %",
            "recall_positive": f"Recall of {table.positive} in %",
            "f1_positive": f"F1 score of {table.positive} in %",
            "auroc": headings["auroc"],
        }
    for metric, heading in headings.items():
        series: list[_Series] = [(name, metric, f"{ours}, {name}") for name in protocols]
        if metric == "auroc" and has_areas(table):
            variants = {metric: "scores", "decided_auroc": "decisions"}
            series = [
                (name, kind, f"{label}: of {variant}")
                for name, _, label in series
                for kind, variant in variants.items()
            ]
        groups.append((heading, [*_published_series(run, metric), *series]))
    return groups


def _published_label(run: PlanRun) -> str:
    return f"published, {run.plan.table.measured_on}, {run.plan.table.recordings} data"


def _draws_group(run: PlanRun) -> tuple[str, list[_Series]]:
    assert run.plan.table.draws is not None
    kinds = {"draws_accuracy": "mean, %", "draws_variance": "variance, %²"}
    published = [
        (source, metric, f"{name}: {kinds['draws_variance']}")
        for source, metric, name in _published_series(run, "draws_variance")
    ]
    ours = [
        (protocol.name, metric, f"{run.plan.data.kind}, {protocol.name}: {kind}")
        for protocol in run.plan.protocols
        for metric, kind in kinds.items()
    ]
    count = run.plan.table.draws.count
    return f"Accuracy over {count} draws of the test samples", [*published, *ours]


def _published_series(run: PlanRun, metric: str) -> list[_Series]:
    key = _PUBLISHED_KEYS.get(metric, metric)
    has_numbers = any(key in cell.published for cell in run.plan.table.cells)
    return [(PUBLISHED, metric, _published_label(run))] if has_numbers else []


def _memory_name(run: PlanRun) -> str:
    measures = {result["measures"] for _, result in run.results} - {None}
    return f"{run.plan.data.kind}, {' and '.join(sorted(measures)) or 'no run yet'}"


def _drawn_groups(run: PlanRun) -> list[tuple[str, list[_Series]]]:
    groups = _groups(run)
    published = [group for group in groups if group[1][0][0] == PUBLISHED]
    return [group for group in published if "draws_variance" not in group[1][0]] or groups[:1]


def _panels(run: PlanRun) -> list[ComparisonPanel]:
    table, index = run.plan.table, _number_index(run)
    panels = []
    for heading, series in _drawn_groups(run):
        for section in table.sections:
            rows = {}
            for cell in (cell for cell in table.cells if cell.section == section):
                values = {}
                for source, metric, name in series:
                    number = index.get((cell.experiment, source, metric))
                    ratio = _memory_ratio(run, index, cell, source) if metric == "ratio" else None
                    if ratio is not None:
                        values[name] = (ratio, math.nan)
                    elif number is not None:
                        values[name] = (number.mean, number.spread)
                rows[f"{cell.row}: {cell.column}" if cell.column else cell.row] = values
            panels.append(ComparisonPanel(section, heading, rows, table.shows == "memory"))
    return panels


def _title(run: PlanRun) -> str:
    table, ours = run.plan.table, run.plan.data.kind
    note = " beside published numbers" if table.is_published else ""
    title = f"{table.title} ({ours} recordings{note})"
    runs = "1 run" if run.missing == 1 else f"{run.missing} runs"
    return f"{title}; {runs} missing" if run.missing else title
