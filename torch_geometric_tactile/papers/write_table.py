r"""A table of our numbers, beside the published ones if there are: Markdown, CSV and a picture."""

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
from torch_geometric_tactile.io._csv_table import safe_cell
from torch_geometric_tactile.papers._table_caption import NOTHING, caption, cost_note
from torch_geometric_tactile.papers._table_notes import (
    area_note,
    correlation_notes,
    draws_note,
    ordering_lines,
    positive_note,
)
from torch_geometric_tactile.papers._table_numbers import (
    ALL,
    Number,
    has_areas,
    run_rows,
    table_numbers,
)
from torch_geometric_tactile.papers._table_numbers import PUBLISHED as OF_PAPER
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

_DIGITS = {
    "auroc": 3,
    "decided_auroc": 3,
    "draws_variance": 2,
    "peak_memory_mb": 0,
    "frames_per_second": 0,
    "num_parameters": 0,
}
_PUBLISHED_AS = {
    "draws_variance": "variance",
    "auroc": "auc",
    "f1": "",  # that of papers is of one class
    "f1_positive": "f1",
    "peak_memory_mb": "memory",
    "ratio": "memory",
}
_Index = dict[tuple[str, str, str], Number]
# A series of a table: its source and metric, and what it is called.
_Series = tuple[str, str, str]


def write_table(run: PlanRun, out: PathLike) -> list[Path]:
    r"""Writes :obj:`NAME.md`, :obj:`NAME.csv`, :obj:`NAME.png`, :obj:`NAME-runs.csv` (each run by
    itself) and the pictures of studies, :obj:`NAME-*.png`, and returns their paths.
    """
    suffixes = (".md", ".csv", ".png", "-runs.csv")
    paths = [Path(out) / f"{run.plan.table.name}{suffix}" for suffix in suffixes]
    page, numbers, picture, runs = paths
    for path, text in ((page, markdown(run)), (numbers, csv_text(run)), (runs, _runs_csv(run))):
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
    series = dict.fromkeys(name for _, group in _drawn(run) for _, _, name in group)
    return plot_comparison(_panels(run), list(series), _title(run))


def _curves(run: PlanRun) -> dict[str, list[tuple[float, float, float]]]:
    # A line for each row and protocol along the columns, which are numbers.
    index = _index(run)
    curves: dict[str, list[tuple[float, float, float]]] = {}
    for source in (OF_PAPER, *(protocol.name for protocol in run.plan.protocols)):
        for cell in run.plan.table.cells:
            number = index.get((cell.experiment, source, "accuracy"))
            if number is not None:
                name = _of_paper(run) if source == OF_PAPER else f"{run.plan.data.kind}, {source}"
                point = (float(cell.column), number.mean, number.spread)
                curves.setdefault(f"{cell.row} ({name})", []).append(point)
    return {name: sorted(points) for name, points in curves.items()}


def csv_text(run: PlanRun) -> str:
    r"""Returns all numbers, one a line: its place in the table, its source, metric, mean,
    standard deviation and number of runs.
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
        published = number.source == OF_PAPER
        writer.writerow(
            [
                *map(safe_cell, (cell.section, cell.row, cell.column, cell.experiment)),
                safe_cell(number.source),
                measured_on if published else run.plan.data.kind,
                safe_cell(number.metric),
                f"{number.mean:.6g}" if published else repr(number.mean),
                "" if math.isnan(number.spread) else f"{number.spread:.6g}",
                "" if published else number.runs,
            ]
        )
    return file.getvalue()


def _runs_csv(run: PlanRun) -> str:
    r"""Returns the metrics and costs of each run, one run a line; accuracies in percent."""
    rows = run_rows(run)
    file = io.StringIO()
    writer = csv.DictWriter(file, dict.fromkeys(chain.from_iterable(rows)), lineterminator="\n")
    writer.writeheader()
    for row in rows:
        writer.writerow(
            {
                safe_cell(name): f"{value:.6g}"
                if isinstance(value, float)
                else safe_cell(str(value))
                for name, value in row.items()
            }
        )
    return file.getvalue()


def markdown(run: PlanRun) -> str:
    r"""Returns the table as a page: what it is made of, our numbers beside the published ones, and
    what each model costs.
    """
    table, index = run.plan.table, _index(run)
    lines = [f"# {printable(table.title)}", "", printable(caption(run)), ""]
    notes = (positive_note(run), draws_note(run), area_note(run))
    for note in filter(None, (*correlation_notes(run, index.values()), *notes)):
        lines += [printable(note), ""]
    if table.see_also:
        lines += [f"See also: {printable(table.see_also)}", ""]
    for heading, series in _groups(run):
        for section in table.sections:
            columns = table.columns(section)
            name = f"{heading}, {markdown_text(section)}" if section else heading
            lines += [f"## {name}", ""]
            lines += markdown_table(
                ["model", "", *columns],
                [
                    [
                        markdown_text(row) if i == 0 else "",
                        markdown_text(name),
                        *_row(run, index, section, row, source, metric),
                    ]
                    for row in table.rows
                    if any(_at(cell, section, row) for cell in table.cells)
                    for i, (source, metric, name) in enumerate(_of_row(run, section, row, series))
                ],
            )
            lines.append("")
    lines += ordering_lines(run)
    lines += study_lines(run)
    lines += ["## Cost of the models", "", cost_note(run.plan), ""]
    metrics = ("num_parameters", "frames_per_second", "peak_memory_mb", "train_seconds")
    once = _named_models(run.plan)
    lines += markdown_table(
        ["experiment", "parameters", "frames/s", "peak memory (MB)", "seconds of training"],
        [
            [
                f"`{printable(name).replace('|', '')}`",
                *(_shown(index.get((cell.experiment, ALL, metric))) for metric in metrics),
            ]
            for name, cell in once.items()
        ],
    )
    return "\n".join([*lines, ""])


def _named_models(plan: Plan) -> dict[str, Cell]:
    # Two places may have one model, which is trained once. Two models of one configuration, with
    # other data or transforms, are named by their experiments.
    codes = {
        c.experiment: replace(plan.cell_experiment(c), studies=[]).code for c in plan.table.cells
    }
    of_config: dict[str, set[str]] = {}
    for cell in plan.table.cells:
        of_config.setdefault(_config_name(cell), set()).add(codes[cell.experiment])
    names: dict[str, Cell] = {}
    for cell in plan.table.cells:
        name = _config_name(cell)
        is_shared = len(of_config[name]) > 1 or cell.data
        names[cell.experiment if is_shared else name] = cell
    return names


def _config_name(cell: Cell) -> str:
    # What `tactile fit --config` takes, where that is one of a template.
    config = str(cell.config)
    return config if config.partition("/")[0] in TEMPLATES else cell.experiment


def _row(
    run: PlanRun, index: _Index, section: str, row: str, source: str, metric: str
) -> list[str]:
    of_row = {cell.column: cell for cell in run.plan.table.cells if _at(cell, section, row)}
    texts = []
    for column in run.plan.table.columns(section):
        cell = of_row.get(column)
        if cell is None:
            texts.append("")  # the paper has no such model
        elif metric == "ratio":
            ratio = _ratio(run, index, cell, source)
            texts.append(NOTHING if ratio is None else f"{ratio:.2f}")
        else:
            text = _shown(index.get((cell.experiment, source, metric)), run.plan.seeds)
            variance = index.get((cell.experiment, source, "variance"))
            if variance is not None and metric == "accuracy":
                text += f" (variance {variance.mean:g})"
            texts.append(text)
    return texts


def _of_row(run: PlanRun, section: str, row: str, series: Sequence[_Series]) -> list[_Series]:
    # A model that is in no paper has no line for published numbers.
    is_published = any(cell.published for cell in run.plan.table.cells if _at(cell, section, row))
    return [entry for entry in series if is_published or entry[0] != OF_PAPER]


def _at(cell: Cell, section: str, row: str) -> bool:
    return (cell.section, cell.row) == (section, row)


def _shown(number: Number | None, seeds: int | None = None) -> str:
    if number is None:
        return NOTHING
    digits = _DIGITS.get(number.metric, 2 if number.source == OF_PAPER else 1)
    if number.metric == "auroc" and number.source == OF_PAPER:
        digits = 4
    text = f"{number.mean:,.{digits}f}" if digits == 0 else f"{number.mean:.{digits}f}"
    if number.metric in ("num_parameters", "frames_per_second", "train_seconds"):
        return text
    if not math.isnan(number.spread):
        text += f" ± {number.spread:.{digits}f}"
    some = seeds is not None and number.source not in (OF_PAPER, ALL) and number.runs < seeds
    return f"{text} ({number.runs} of {seeds})" if some else text


def _ratio(run: PlanRun, index: _Index, cell: Cell, source: str) -> float | None:
    # To the first model of the table with the same inputs.
    base = next(
        other
        for other in run.plan.table.cells
        if (other.section, other.column) == (cell.section, cell.column)
    )
    mine, first = (index.get((e.experiment, source, "peak_memory_mb")) for e in (cell, base))
    return None if mine is None or first is None else mine.mean / first.mean


def _index(run: PlanRun) -> _Index:
    numbers = table_numbers(run)
    return {(number.experiment, number.source, number.metric): number for number in numbers}


def _groups(run: PlanRun) -> list[tuple[str, list[_Series]]]:
    # The parts of the page, and the lines of each model in them.
    table, ours = run.plan.table, run.plan.data.kind
    protocols = [protocol.name for protocol in run.plan.protocols]
    if table.shows == "memory":
        return [
            (heading, [*_published(run, metric), (ALL, metric, _memory_name(run))])
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
    groups = [("Accuracy in %", [*_published(run, "accuracy"), *accuracy])]
    if table.draws is not None:
        groups += [_of_draws(run)]
    others = {"auroc": "Area under the ROC curve", "f1": "F1 score in %"}
    if table.positive:
        others = {
            "precision_positive": f"Precision of {table.positive} in %",
            "recall_positive": f"Recall of {table.positive} in %",
            "f1_positive": f"F1 score of {table.positive} in %",
            "auroc": others["auroc"],
        }
    for metric, heading in others.items():
        series: list[_Series] = [(name, metric, f"{ours}, {name}") for name in protocols]
        if metric == "auroc" and has_areas(table):
            both = {metric: "scores", "decided_auroc": "decisions"}
            series = [
                (name, kind, f"{told}: of {what}")
                for name, _, told in series
                for kind, what in both.items()
            ]
        groups.append((heading, [*_published(run, metric), *series]))
    return groups


def _of_paper(run: PlanRun) -> str:
    return f"published, {run.plan.table.measured_on}, {run.plan.table.recordings} data"


def _of_draws(run: PlanRun) -> tuple[str, list[_Series]]:
    assert run.plan.table.draws is not None
    kinds = {"draws_accuracy": "mean, %", "draws_variance": "variance, %²"}
    published = [
        (source, metric, f"{name}: {kinds['draws_variance']}")
        for source, metric, name in _published(run, "draws_variance")
    ]
    ours = [
        (protocol.name, metric, f"{run.plan.data.kind}, {protocol.name}: {kind}")
        for protocol in run.plan.protocols
        for metric, kind in kinds.items()
    ]
    count = run.plan.table.draws.count
    return f"Accuracy over {count} draws of the test samples", [*published, *ours]


def _published(run: PlanRun, metric: str) -> list[_Series]:
    key = _PUBLISHED_AS.get(metric, metric)
    printed = any(key in cell.published for cell in run.plan.table.cells)
    return [(OF_PAPER, metric, _of_paper(run))] if printed else []


def _memory_name(run: PlanRun) -> str:
    measures = {result["measures"] for _, result in run.results} - {None}
    return f"{run.plan.data.kind}, {' and '.join(sorted(measures)) or 'no run yet'}"


def _drawn(run: PlanRun) -> list[tuple[str, list[_Series]]]:
    groups = _groups(run)
    drawn = [group for group in groups if group[1][0][0] == OF_PAPER]
    return [group for group in drawn if "draws_variance" not in group[1][0]] or groups[:1]


def _panels(run: PlanRun) -> list[ComparisonPanel]:
    table, index = run.plan.table, _index(run)
    panels = []
    for heading, series in _drawn(run):
        for section in table.sections:
            rows = {}
            for cell in (cell for cell in table.cells if cell.section == section):
                values = {}
                for source, metric, name in series:
                    number = index.get((cell.experiment, source, metric))
                    ratio = _ratio(run, index, cell, source) if metric == "ratio" else None
                    if ratio is not None:
                        values[name] = (ratio, math.nan)
                    elif number is not None:
                        values[name] = (number.mean, number.spread)
                rows[f"{cell.row}: {cell.column}" if cell.column else cell.row] = values
            panels.append(ComparisonPanel(section, heading, rows, table.shows == "memory"))
    return panels


def _title(run: PlanRun) -> str:
    table, ours = run.plan.table, run.plan.data.kind
    beside = " beside published numbers" if table.is_published else ""
    title = f"{table.title} ({ours} recordings{beside})"
    runs = "1 run" if run.missing == 1 else f"{run.missing} runs"
    return f"{title}; {runs} missing" if run.missing else title
