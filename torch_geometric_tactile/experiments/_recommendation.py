r"""Which model of a comparison is recommended: the rule, without words."""

import math
from typing import Literal, NamedTuple

from torch_geometric_tactile.experiments._compared_models import FLOOR
from torch_geometric_tactile.experiments.comparison import Comparison, ModelResult


class Recommendation(NamedTuple):
    r"""The model that is recommended, or the reason for none.

    Args:
        result (ModelResult, optional): The model.
        best (ModelResult, optional): The model with the best mean, which is another one where a
            simpler model is recommended.
        obstacle (str): Why none is recommended: no model has a result for every split, given parts
            share trials, the constant answer is the best, or the best is within one standard error
            of it.
    """

    result: ModelResult | None
    best: ModelResult | None
    obstacle: Literal["", "no results", "shared trials", "constant", "near constant"] = ""


def recommend(comparison: Comparison) -> Recommendation:
    r"""Recommends the model with the best mean, unless a simpler one is about as good: within one
    standard error of the difference and within the tolerance, with at most half the weights, and
    not slower. Of several such models the smallest is recommended.

    Args:
        comparison (Comparison): The scores.
    """
    best = comparison.best
    if best is None:
        return Recommendation(None, None, "no results")
    (protocol,) = comparison.run.plan.protocols
    if comparison.units.num_leaked and protocol.protocol.by == "given":
        return Recommendation(None, best, "shared trials")
    if best.model.name == FLOOR:
        return Recommendation(None, best, "constant")
    if any(result.model.name == FLOOR for result in comparison.results) and _is_within_one_error(
        comparison, best.model.name, FLOOR
    ):
        return Recommendation(None, best, "near constant")
    models = [result for result in comparison.results if result.model.name != FLOOR]
    near = [r for r in models if _is_simpler(r, best) and _is_close(comparison, best, r)]
    return Recommendation(min(near, key=_size, default=best), best)


def _is_within_one_error(comparison: Comparison, first: str, second: str) -> bool:
    difference = comparison.difference(first, second)
    return not abs(difference.mean) > (0.0 if math.isnan(difference.error) else difference.error)


def _is_close(comparison: Comparison, best: ModelResult, other: ModelResult) -> bool:
    loss = comparison.goodness(best) - comparison.goodness(other)
    return loss <= comparison.tolerance + 1e-12 and _is_within_one_error(
        comparison, best.model.name, other.model.name
    )


def _is_simpler(result: ModelResult, best: ModelResult) -> bool:
    return 2 * _size(result) <= _size(best) < math.inf and (
        result.milliseconds <= best.milliseconds
    )


def _size(result: ModelResult) -> float:
    return math.inf if result.num_parameters is None else result.num_parameters
