r"""The notes of a table's page: which orderings hold, its positive class, draws of its samples."""

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from scipy.stats import spearmanr

from torch_geometric_tactile._texts import markdown_table, markdown_text
from torch_geometric_tactile.experiments._scores import RULE
from torch_geometric_tactile.experiments.differences import Difference, run_difference
from torch_geometric_tactile.experiments.plan import PlanRun
from torch_geometric_tactile.experiments.tables import Ordering
from torch_geometric_tactile.papers._table_numbers import (
    PUBLISHED,
    Number,
    finished_parts,
    has_areas,
    pooled_predictions,
)

_COLUMNS = ("ordering", "protocol", "first", "second", "difference", "splits", "holds")
_AREA = 0.0015  # how far a published area may be from that of decisions
_FEWEST_RANKED = 5  # accuracies whose order is compared
_SQUARED_PERCENT = 100.0**2  # of a variance of parts


@dataclass(frozen=True)
class OrderedPair:
    r"""Two models of an ordering by one protocol."""

    ordering: Ordering
    protocol: str
    pair: tuple[str, str]
    difference: Difference

    @property
    def verdict(self) -> str:
        r"""Whether the pair is ordered so: :obj:`"yes"` or :obj:`"no"` where the difference is
        beyond the noise, and else why not.
        """
        if not self.difference.is_beyond_noise:
            return self.difference.verdict
        return "yes" if self.difference.mean > 0 else "no"


def compare_orderings(run: PlanRun) -> list[OrderedPair]:
    r"""Compares the pairs of all orderings of a table, by each protocol, on the splits that are
    finished for both.
    """
    compared = []
    for ordering in run.plan.table.orderings:
        for protocol in run.plan.protocols:
            for pair in ordering.pairs:
                difference = run_difference(run, *pair, protocol.name)
                if difference is not None:
                    compared.append(OrderedPair(ordering, protocol.name, pair, difference))
    return compared


def ordering_lines(run: PlanRun) -> list[str]:
    r"""Returns the section on orderings, line by line; nothing for a table without any."""
    compared = compare_orderings(run)
    if not compared:
        return []
    return [
        "## Which orderings hold",
        "",
        "The accuracy of the first model minus that of the second on the same splits, in points, ± "
        "its standard error: the larger of the one over the splits and the one over the test "
        f"trials. {RULE}",
        "",
        *markdown_table(["ordering", "protocol", "holds"], _summary(compared)),
        "",
        *markdown_table(_COLUMNS, map(_cells, compared)),
        "",
    ]


def _summary(compared: list[OrderedPair]) -> Iterator[list[str]]:
    groups: dict[tuple[str, str], list[str]] = {}
    for entry in compared:
        groups.setdefault((entry.ordering.name, entry.protocol), []).append(entry.verdict)
    for (name, protocol), verdicts in groups.items():
        count = {verdict: verdicts.count(verdict) for verdict in dict.fromkeys(verdicts)}
        told = next(iter(count))
        if len(verdicts) > 1:
            told = ", ".join(f"{verdict} in {n} of {len(verdicts)}" for verdict, n in count.items())
        yield [markdown_text(name), markdown_text(protocol), told]


def _cells(entry: OrderedPair) -> list[str]:
    names = map(markdown_text, [entry.ordering.name, entry.protocol, *entry.pair])
    return [*names, _shown(entry.difference), str(entry.difference.num_splits), entry.verdict]


def _shown(difference: Difference) -> str:
    text = f"{100 * difference.mean:+.1f}"
    return text if math.isnan(difference.error) else f"{text} ± {100 * difference.error:.1f}"


def positive_note(run: PlanRun) -> str:
    r"""Returns which class is the positive one, and how common it is, as sentences; empty for a
    table without any.
    """
    name = run.plan.table.positive
    if not name:
        return ""
    shares = _class_shares(run)
    told = "; ".join(f"{100 * share:.1f} % ({protocol})" for protocol, share in shares.items())
    counted = f" Its share of the test samples: {told}." if told else ""
    return (
        f"Precision, recall and F1 score are those of the positive class, *{markdown_text(name)}* "
        f"(class 1).{counted}"
    )


def _class_shares(run: PlanRun) -> dict[str, float]:
    r"""Returns the part of the positive class among the samples tested on, by protocol, over the
    splits of the first experiment that is finished.
    """
    shares: dict[str, list[float]] = {}
    for part, results in finished_parts(run).items():
        if part.experiment == run.results[0][0].name:
            share = float((pooled_predictions(results).y == 1).mean())
            shares.setdefault(part.protocol, []).append(share)
    return {protocol: sum(values) / len(values) for protocol, values in shares.items()}


def area_note(run: PlanRun) -> str:
    r"""Returns what the published areas under the ROC curve are of, as sentences; empty for a table
    without any.
    """
    pairs = [
        (cell.published["auc"], cell.published["accuracy"] / 100)
        for cell in run.plan.table.cells
        if {"auc", "accuracy"} <= cell.published.keys()
    ]
    if not has_areas(run.plan.table):
        return ""
    slope = run.plan.facts.num_classes / (run.plan.facts.num_classes - 1) / 2
    close = sum(abs(auc - (1 - slope * (1 - accuracy))) < _AREA for auc, accuracy in pairs)
    return (
        f"Areas under the ROC curve: {close} of {len(pairs)} published ones are 1 - {slope:.3f} · "
        f"(1 - accuracy) to {_AREA}. That is the area of decisions, which is smaller than that of "
        "scores. Ours is shown of both."
    )


def correlation_notes(run: PlanRun, numbers: Iterable[Number]) -> list[str]:
    r"""Returns how far our accuracies have the order of the published ones, and that of the columns
    where these are numbers, as a sentence each; none for fewer than five accuracies, or equal ones.
    """
    numbers = [number for number in numbers if number.metric == "accuracy"]
    published = {n.experiment: n.mean for n in numbers if n.source == PUBLISHED}
    alike, along = [], []
    for protocol in run.plan.protocols:
        ours = {n.experiment: n.mean for n in numbers if n.source == protocol.name}
        both = [name for name in published if name in ours]
        correlation = _rank_correlation(
            [published[name] for name in both], [ours[name] for name in both]
        )
        if correlation:
            alike.append(f"{correlation} over {len(both)} models ({protocol.name})")
        for row in run.plan.table.rows if run.plan.table.axis else ():
            cells = [c for c in run.plan.table.cells if c.row == row and c.experiment in ours]
            columns = [float(cell.column) for cell in cells]
            correlation = _rank_correlation(columns, [ours[cell.experiment] for cell in cells])
            if correlation:
                along.append(f"{row} {correlation} ({protocol.name})")
    notes = []
    if alike:
        notes.append(
            "Rank correlation (Spearman) of published and our accuracies, 1 for the same order and "
            f"0 for none in common: {', '.join(alike)}."
        )
    if along:
        notes.append(
            f"Rank correlation (Spearman) of our mean accuracies with {run.plan.table.axis}: "
            f"{', '.join(along)}."
        )
    return notes


def _rank_correlation(first: list[float], second: list[float]) -> str:
    if len(first) < _FEWEST_RANKED or len(set(second)) == 1:
        return ""
    return f"{spearmanr(first, second)[0]:.2f}"


def draws_note(run: PlanRun) -> str:
    r"""Returns what draws are, and how much they can vary, as sentences; empty for a table without
    any.
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
        f"Accuracies of draws: {draws.count} draws of {100 * draws.part:.0f} % of the test "
        f"samples, without replacement, from the predictions of one trained network (seed "
        f"{draws.seed}): mean and variance in %² (squared points)."
    )
    if not sizes:
        return text
    total = sizes[-1]
    drawn, most = draws.num_drawn(total), _SQUARED_PERCENT * draws.variance(0.5, total)
    text += (
        f" Of {drawn:,} of {total:,} samples the variance is p(1 - p)/{drawn} · "
        f"{total - drawn}/{total - 1} on average: at most {most:.2f} %², if half of the answers "
        f"are right, and {_SQUARED_PERCENT * draws.variance(0.95, total):.2f} %² if 95 % are."
    )
    if not published:
        return text
    by_draws = [
        variance / (_SQUARED_PERCENT * draws.variance(accuracy / 100, total))
        for variance, accuracy in published
    ]
    low, high = min(published)[0], max(published)[0]
    text += (
        f" The published variances are {low:g} to {high:g}, {min(by_draws):.1f} to "
        f"{max(by_draws):.1f} times the average of draws from one network at the published "
        "accuracy."
    )
    if min(by_draws) <= 1:
        return text
    return f"{text} They must contain something else, which the paper does not name."
