r"""The part of a table's page on which orderings of models hold."""

import math
from collections.abc import Iterator

from torch_geometric_tactile._texts import markdown_text
from torch_geometric_tactile.experiments._noise import RULE
from torch_geometric_tactile.experiments.differences import Difference
from torch_geometric_tactile.experiments.run_plan import PlanRun
from torch_geometric_tactile.papers._orderings import (
    Comparison,
    class_shares,
    compare_orderings,
)


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
        "| ordering | protocol | holds |",
        "| --- | --- | --- |",
        *_summary(compared),
        "",
        "| ordering | protocol | first | second | difference | splits | holds |",
        "| --- | --- | --- | --- | --- | --- | --- |",
        *map(_line, compared),
        "",
    ]


def _summary(compared: list[Comparison]) -> Iterator[str]:
    groups: dict[tuple[str, str], list[str]] = {}
    for entry in compared:
        groups.setdefault((entry.ordering.name, entry.protocol), []).append(entry.verdict)
    for (name, protocol), verdicts in groups.items():
        count = {verdict: verdicts.count(verdict) for verdict in dict.fromkeys(verdicts)}
        told = next(iter(count))
        if len(verdicts) > 1:
            told = ", ".join(f"{verdict} in {n} of {len(verdicts)}" for verdict, n in count.items())
        yield f"| {markdown_text(name)} | {markdown_text(protocol)} | {told} |"


def _line(entry: Comparison) -> str:
    cells = [entry.ordering.name, entry.protocol, *entry.pair]
    names = " | ".join(map(markdown_text, cells))
    found = entry.difference
    return f"| {names} | {_shown(found)} | {found.num_splits} | {entry.verdict} |"


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
    shares = class_shares(run)
    told = "; ".join(f"{100 * share:.1f} % ({protocol})" for protocol, share in shares.items())
    counted = f" Its share of the test samples: {told}." if told else ""
    return (
        f"Precision, recall and F1 score are those of the positive class, *{markdown_text(name)}* "
        f"(class 1).{counted}"
    )
