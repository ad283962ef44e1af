r"""The rule by which a model of a comparison is recommended."""

import math
from typing import Literal, NamedTuple

from torch_geometric_tactile.experiments._compared_models import FLOOR
from torch_geometric_tactile.experiments.comparison import Comparison, ModelResult
from torch_geometric_tactile.experiments.differences import Difference


class Recommendation(NamedTuple):
    r"""The recommended model, or the reason why none is recommended.

    Args:
        result (ModelResult, optional): The recommended model.
        best (ModelResult, optional): The model with the best mean score, on validation parts if the
            parts are given. It differs from :obj:`result` if a simpler model is recommended.
        obstacle (str): The reason why none is recommended: no model has a result for every split,
            given parts share trials, the constant answer is the best, or the best model is not
            ahead of it by more than one standard error on the test parts.
    """

    result: ModelResult | None
    best: ModelResult | None
    obstacle: Literal["", "no results", "shared trials", "constant", "near constant"] = ""


def recommend(comparison: Comparison) -> Recommendation:
    r"""Recommends the model with the best mean score, unless a simpler model is about as good:
    within one standard error of the difference and within the tolerance, with at most half the
    weights, and not slower. Of several such models, the smallest is recommended.

    With given parts, scores and differences are those on validation parts. The test part then only
    decides whether the model is better than the constant answer.

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
    has_floor = any(result.model.name == FLOOR for result in comparison.results)
    if has_floor and not _is_ahead_of_floor(comparison, best):
        return Recommendation(None, best, "near constant")
    models = [result for result in comparison.results if result.model.name != FLOOR]
    simpler = [r for r in models if _is_simpler(r, best) and _is_close(comparison, best, r)]
    return Recommendation(min(simpler, key=_size, default=best), best)


def _is_ahead_of_floor(comparison: Comparison, result: ModelResult) -> bool:
    difference = comparison.difference(result.model.name, FLOOR)
    gain = -difference.mean if comparison.metric == "mae" else difference.mean
    return gain > _known_error(difference)


def _is_close(comparison: Comparison, best: ModelResult, result: ModelResult) -> bool:
    # The small number allows for rounding of a gap that equals the tolerance.
    if not comparison.merit(best) - comparison.merit(result) <= comparison.tolerance + 1e-12:
        return False
    compute = comparison.validation_difference if comparison.is_validated else comparison.difference
    difference = compute(best.model.name, result.model.name)
    return not abs(difference.mean) > _known_error(difference)


def _known_error(difference: Difference) -> float:
    return 0.0 if math.isnan(difference.error) else difference.error


def _is_simpler(result: ModelResult, best: ModelResult) -> bool:
    return 2 * _size(result) <= _size(best) < math.inf and (
        result.milliseconds <= best.milliseconds
    )


def _size(result: ModelResult) -> float:
    return math.inf if result.num_parameters is None else result.num_parameters
