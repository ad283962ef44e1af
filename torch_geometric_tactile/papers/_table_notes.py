r"""Notes on a table: orderings, positive class, ROC areas, rank correlation and draws."""

import csv
import io
import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from scipy.stats import spearmanr

from torch_geometric_tactile._texts import markdown_table, markdown_text
from torch_geometric_tactile.experiments._scores import RULE
from torch_geometric_tactile.experiments.differences import Difference, run_difference
from torch_geometric_tactile.experiments.plan import PlanRun
from torch_geometric_tactile.experiments.tables import Ordering
from torch_geometric_tactile.io._csv_table import text_to_cell
from torch_geometric_tactile.papers._table_numbers import (
    PUBLISHED,
    Number,
    finished_parts,
    has_areas,
    pooled_predictions,
)

_PAIR_COLUMNS = (
    "ordering",
    "protocol",
    "first",
    "second",
    "difference",
    "error",
    "splits",
    "holds",
)
_AREA_TOLERANCE = 0.0015  # published areas and accuracies are rounded
_MIN_RANKED = 5  # with fewer models, a rank correlation is not informative
_SQUARED_PERCENT = 100.0**2  # converts variances of fractions


@dataclass(frozen=True)
class OrderedPair:
    r"""Two models of an ordering, compared with one protocol."""

    ordering: Ordering
    protocol: str
    pair: tuple[str, str]
    difference: Difference

    @property
    def verdict(self) -> str:
        r""":obj:`"yes"` or :obj:`"no"` if the difference is beyond the noise; otherwise, the reason
        why the order is undecided.
        """
        if not self.difference.is_beyond_noise:
            return self.difference.verdict
        return "yes" if self.difference.mean > 0 else "no"


def compare_orderings(run: PlanRun) -> list[OrderedPair]:
    r"""Compares the pairs of all orderings of a table with each protocol, on the splits for which
    both models are finished.
    """
    comparisons = []
    for ordering in run.plan.table.orderings:
        for protocol in run.plan.protocols:
            for pair in ordering.pairs:
                difference = run_difference(run, *pair, protocol.name)
                if difference is not None:
                    comparisons.append(OrderedPair(ordering, protocol.name, pair, difference))
    return comparisons


def ordering_lines(run: PlanRun) -> list[str]:
    r"""Returns the lines of the section on orderings, or an empty list for a table without
    orderings.
    """
    comparisons = compare_orderings(run)
    if not comparisons:
        return []
    return [
        "## Which orderings hold",
        "",
        "An ordering of two models holds if the first model is more accurate than the second on "
        f"the same splits and the difference is beyond the noise. {RULE}",
        "",
        *markdown_table(["ordering", "protocol", "holds"], _verdict_rows(comparisons)),
        "",
        f"`{run.plan.table.name}-orderings.csv` lists the difference for each pair in points and "
        "its standard error over the splits or over the test trials, whichever is larger.",
        "",
    ]


def orderings_csv(run: PlanRun) -> str:
    r"""Returns the pairs of all orderings as CSV, one pair per line, with differences in points."""
    file = io.StringIO()
    writer = csv.writer(file, lineterminator="\n")
    writer.writerow(_PAIR_COLUMNS)
    writer.writerows(map(_pair_cells, compare_orderings(run)))
    return file.getvalue()


def _pair_cells(comparison: OrderedPair) -> list[str]:
    names = (comparison.ordering.name, comparison.protocol, *comparison.pair)
    difference = comparison.difference
    return [
        *map(text_to_cell, names),
        f"{100 * difference.mean:.6g}",
        "" if math.isnan(difference.error) else f"{100 * difference.error:.6g}",
        str(difference.num_splits),
        comparison.verdict,
    ]


def _verdict_rows(comparisons: list[OrderedPair]) -> Iterator[list[str]]:
    groups: dict[tuple[str, str], list[str]] = {}
    for comparison in comparisons:
        groups.setdefault((comparison.ordering.name, comparison.protocol), []).append(
            comparison.verdict
        )
    for (name, protocol), verdicts in groups.items():
        count = {verdict: verdicts.count(verdict) for verdict in dict.fromkeys(verdicts)}
        summary = next(iter(count))
        if len(verdicts) > 1:
            summary = ", ".join(
                f"{verdict} in {num_pairs} of {len(verdicts)}"
                for verdict, num_pairs in count.items()
            )
        yield [markdown_text(name), markdown_text(protocol), summary]


def positive_note(run: PlanRun) -> str:
    r"""Returns a note on the positive class and its share of the test samples, or an empty string
    for a table without a positive class.
    """
    name = run.plan.table.positive
    if not name:
        return ""
    shares = _class_shares(run)
    share_text = "; ".join(
        f"{100 * share:.1f} % ({protocol})" for protocol, share in shares.items()
    )
    share_sentence = f" Its share of the test samples: {share_text}." if share_text else ""
    return (
        f"Precision, recall and F1 score refer to the positive class, *{markdown_text(name)}* "
        f"(class 1).{share_sentence}"
    )


def _class_shares(run: PlanRun) -> dict[str, float]:
    r"""Returns the fraction of test samples in the positive class, by protocol. The fraction is the
    mean over the finished splits of the first experiment with results.
    """
    shares: dict[str, list[float]] = {}
    for part, results in finished_parts(run).items():
        if part.experiment == run.results[0][0].name:
            share = float((pooled_predictions(results).y == 1).mean())
            shares.setdefault(part.protocol, []).append(share)
    return {protocol: sum(values) / len(values) for protocol, values in shares.items()}


def area_note(run: PlanRun) -> str:
    r"""Returns a note that published areas under the ROC curve were computed from decisions instead
    of scores, or an empty string for a table without published areas.
    """
    pairs = [
        (cell.published["auc"], cell.published["accuracy"] / 100)
        for cell in run.plan.table.cells
        if {"auc", "accuracy"} <= cell.published.keys()
    ]
    if not has_areas(run.plan.table):
        return ""
    # The ROC curve for decisions has one corner. For balanced classes, the mean area over the
    # classes is 1 - slope * (1 - accuracy).
    slope = run.plan.facts.num_classes / (run.plan.facts.num_classes - 1) / 2
    num_equal = sum(
        abs(auc - (1 - slope * (1 - accuracy))) < _AREA_TOLERANCE for auc, accuracy in pairs
    )
    return (
        f"Areas under the ROC curve: {num_equal} of {len(pairs)} published areas are 1 - "
        f"{slope:.3f} · (1 - accuracy) within {_AREA_TOLERANCE}. This is the area for decisions, "
        "which is smaller than the area for scores. Our areas are given for both."
    )


def correlation_notes(run: PlanRun, numbers: Iterable[Number]) -> list[str]:
    r"""Returns notes on the rank correlation of our accuracies with the published accuracies and,
    if the columns are numbers, with the columns. Correlations are left out if there are fewer than
    five accuracies or all are equal.
    """
    numbers = [number for number in numbers if number.metric == "accuracy"]
    published = {number.experiment: number.mean for number in numbers if number.source == PUBLISHED}
    published_correlations, column_correlations = [], []
    for protocol in run.plan.protocols:
        ours = {
            number.experiment: number.mean for number in numbers if number.source == protocol.name
        }
        common = [name for name in published if name in ours]
        correlation = _rank_correlation(
            [published[name] for name in common], [ours[name] for name in common]
        )
        if correlation:
            published_correlations.append(
                f"{correlation} over {len(common)} models ({protocol.name})"
            )
        for row in run.plan.table.rows if run.plan.table.axis else ():
            cells = [
                cell for cell in run.plan.table.cells if cell.row == row and cell.experiment in ours
            ]
            columns = [float(cell.column) for cell in cells]
            correlation = _rank_correlation(columns, [ours[cell.experiment] for cell in cells])
            if correlation:
                column_correlations.append(f"{row} {correlation} ({protocol.name})")
    notes = []
    if published_correlations:
        notes.append(
            "Rank correlation (Spearman) between published accuracies and ours (1: same order, 0: "
            f"no relation): {', '.join(published_correlations)}."
        )
    if column_correlations:
        notes.append(
            f"Rank correlation (Spearman) of our mean accuracies with {run.plan.table.axis}: "
            f"{', '.join(column_correlations)}."
        )
    return notes


def _rank_correlation(first: list[float], second: list[float]) -> str:
    if len(first) < _MIN_RANKED or len(set(second)) == 1:
        return ""
    return f"{spearmanr(first, second)[0]:.2f}"


def draws_note(run: PlanRun) -> str:
    r"""Returns a note on the draws of test samples and the variance of their accuracies, or an
    empty string for a table without draws.
    """
    draws = run.plan.table.draws
    if draws is None:
        return ""
    sizes = sorted({result["num_test"] for _, result in run.results})
    published = [
        (cell.published["variance"], cell.published["accuracy"])
        for cell in run.plan.table.cells
        if {"variance", "accuracy"} <= cell.published.keys()
    ]
    text = (
        f"Accuracies over draws: mean and variance (in squared points, %²) over {draws.count} "
        f"draws of {100 * draws.part:.0f} % of the test samples, without replacement, from the "
        f"predictions of one trained network (seed {draws.seed})."
    )
    if not sizes:
        return text
    num_samples = sizes[-1]
    num_drawn, max_variance = (
        draws.num_drawn(num_samples),
        _SQUARED_PERCENT * draws.variance(0.5, num_samples),
    )
    text += (
        f" For {num_drawn:,} of {num_samples:,} samples, the variance is p(1 - p)/{num_drawn} · "
        f"{num_samples - num_drawn}/{num_samples - 1} on average. This is at most "
        f"{max_variance:.2f} %², if half of the answers are correct, and "
        f"{_SQUARED_PERCENT * draws.variance(0.95, num_samples):.2f} %² if 95 % are correct."
    )
    if not published:
        return text
    ratios = [
        variance / (_SQUARED_PERCENT * draws.variance(accuracy / 100, num_samples))
        for variance, accuracy in published
    ]
    low, high = min(published)[0], max(published)[0]
    text += (
        f" The published variances are {low:g} to {high:g}. This is {min(ratios):.1f} to "
        f"{max(ratios):.1f} times the average for draws from one network at the published "
        "accuracy."
    )
    if min(ratios) <= 1:
        return text
    return f"{text} There must be a further source of variance, which the paper does not name."
