r"""Which orderings of models hold, by paired differences over seeds."""

from dataclasses import dataclass

from torch_geometric_tactile.experiments.differences import Difference, run_difference
from torch_geometric_tactile.experiments.run_plan import PlanRun
from torch_geometric_tactile.experiments.tables import Ordering
from torch_geometric_tactile.papers._numbers import finished_parts, pooled_judgement


@dataclass(frozen=True)
class Comparison:
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


def compare_orderings(run: PlanRun) -> list[Comparison]:
    r"""Compares the pairs of all orderings of a table, by each protocol, on the splits that are
    finished for both.
    """
    compared = []
    for ordering in run.plan.table.orderings:
        for protocol in run.plan.protocols:
            for pair in ordering.pairs:
                difference = run_difference(run, *pair, protocol.name)
                if difference is not None:
                    compared.append(Comparison(ordering, protocol.name, pair, difference))
    return compared


def class_shares(run: PlanRun) -> dict[str, float]:
    r"""Returns the part of the positive class among the samples tested on, by protocol, over the
    splits of the first experiment that is finished.
    """
    shares: dict[str, list[float]] = {}
    for part, results in finished_parts(run).items():
        if part.experiment == run.results[0][0].name:
            share = float((pooled_judgement(results).y == 1).mean())
            shares.setdefault(part.protocol, []).append(share)
    return {protocol: sum(values) / len(values) for protocol, values in shares.items()}
