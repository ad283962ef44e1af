r"""Which orderings of models hold, by paired differences over seeds."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from torch_geometric_tactile.experiments.differences import Difference, paired_difference
from torch_geometric_tactile.experiments.held_out import column_of
from torch_geometric_tactile.experiments.judgement import Judgement
from torch_geometric_tactile.experiments.numbers import Part, finished_parts, pooled_judgement
from torch_geometric_tactile.experiments.run_plan import PlanRun
from torch_geometric_tactile.experiments.tables import Ordering


@dataclass(frozen=True)
class Comparison:
    r"""Two models of an ordering by one protocol.

    Args:
        ordering (Ordering): The ordering.
        protocol (str): The protocol.
        pair (tuple of str): Two experiments, of which the first should be better.
        difference (Difference): The accuracy of the first less that of the second.
    """

    ordering: Ordering
    protocol: str
    pair: tuple[str, str]
    difference: Difference

    @property
    def verdict(self) -> str:
        r"""Whether the pair is ordered so: :obj:`"yes"` or :obj:`"no"`, where the difference is
        beyond twice its standard error, and :obj:`"within noise"` otherwise.
        """
        if not self.difference.is_beyond_noise:
            return "within noise"
        return "yes" if self.difference.mean > 0 else "no"


def compare_orderings(run: PlanRun) -> list[Comparison]:
    r"""Compares the pairs of all orderings of a table, by each protocol, on the seeds that are
    finished for both.

    Args:
        run (PlanRun): What :func:`run_plan` returned.
    """
    if not run.plan.table.orderings:
        return []
    judged = {
        part: _with_trials(pooled_judgement(found), part, run)
        for part, found in finished_parts(run).items()
    }
    compared = []
    for ordering in run.plan.table.orderings:
        for protocol in run.plan.protocols:
            for pair in ordering.pairs:
                firsts, seconds = _matched(judged, pair, protocol.name, run.plan.seeds)
                if firsts:
                    difference = paired_difference(firsts, seconds, "accuracy")
                    compared.append(Comparison(ordering, protocol.name, pair, difference))
    return compared


def _with_trials(judgement: Judgement, part: Part, run: PlanRun) -> Judgement:
    # Runs of earlier versions do not tell the trials of their samples, but the data does.
    if judgement.trial is not None:
        return judgement
    tested = [
        column_of(e.data.parts(e.protocol, e.seed, e.fold)[1], "trial")
        for e in run.plan.experiments
        if Part(e.name, e.protocol_name, e.seed) == part and e.data.fingerprint
    ]
    known = [trial for trial in tested if trial is not None]
    if not known or len(known) < len(tested):
        return judgement
    trial = np.concatenate(known)
    return replace(judgement, trial=trial) if len(trial) == len(judgement.y) else judgement


def _matched(
    judged: Mapping[Part, Judgement], pair: tuple[str, str], protocol: str, seeds: int
) -> tuple[list[Judgement], list[Judgement]]:
    firsts, seconds = [], []
    for seed in range(seeds):
        found = [judged.get(Part(name, protocol, seed)) for name in pair]
        if found[0] is not None and found[1] is not None:
            firsts.append(found[0])
            seconds.append(found[1])
    return firsts, seconds


def class_shares(run: PlanRun) -> dict[str, float]:
    r"""Returns the part of the positive class among the samples tested on, by protocol, over the
    splits of the first experiment that is finished.

    Args:
        run (PlanRun): What :func:`run_plan` returned.
    """
    shares: dict[str, list[float]] = {}
    for part, results in finished_parts(run).items():
        if part.experiment == run.results[0][0].name:
            share = float((pooled_judgement(results).y == 1).mean())
            shares.setdefault(part.protocol, []).append(share)
    return {protocol: sum(values) / len(values) for protocol, values in shares.items()}
