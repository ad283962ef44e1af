r"""What a comparison says in one sentence, and as plain data."""

import math
from typing import Any

from torch_geometric_tactile.experiments._compared_models import FLOOR
from torch_geometric_tactile.experiments._scores import LEAST_PAIRS, NAMES, PERCENT, shown_number
from torch_geometric_tactile.experiments.comparison import Comparison, ModelResult, Summary
from torch_geometric_tactile.experiments.differences import Difference

_VERSION = 2
_LEVEL = "level with it"
_MORE = " More test samples would tell."


def advice(comparison: Comparison) -> str:
    r"""Returns which model to take, and whether the best graph model differs from the best plain
    model by more than the noise (:data:`~torch_geometric_tactile.experiments.differences.RULE`).
    Where it does not, the simpler one is taken: the one with fewer weights that also predicts
    faster, or else the plain one.
    """
    if comparison.best is None:
        return "No model has a result for every split yet: the same command goes on."
    nothing = _nothing_learnt(comparison)
    if nothing:
        return nothing
    graphs = [result for result in comparison.results if result.model.is_graph]
    graph = max(graphs, key=comparison.goodness, default=None)
    if comparison.best_plain is None:
        return f"Take {_with_score(comparison, comparison.best)}; no plain model was compared."
    plain = comparison.of(comparison.best_plain)
    if graph is None or graph.difference is None:
        return f"Take {_with_score(comparison, plain)}; no graph model was compared."
    difference = graph.difference
    gain, size, is_told = _gain(comparison, difference)
    taken = _taken(comparison, graph, plain)
    other = plain if taken is graph else graph
    kind = "graph" if other is graph else "plain"
    worse = "" if size == _LEVEL else " better" if (gain > 0) == (other is graph) else " worse"
    return (
        f"Take {_with_score(comparison, taken)}: {other.model.name}, the best {kind} model, is "
        f"{size}{worse}, {_told(comparison, difference)}"
        + ("." if is_told else _why(taken, other))
        + (_MORE if difference.error < abs(difference.mean) <= difference.margin else "")
    )


def recommended(comparison: Comparison) -> ModelResult | None:
    r"""Returns the model that :func:`advice` says to take, or :obj:`None` if it says none.

    Args:
        comparison (Comparison): What came of a comparison.
    """
    if comparison.best is None or _nothing_learnt(comparison):
        return None
    if comparison.best_plain is None:
        return comparison.best
    graphs = [result for result in comparison.results if result.model.is_graph]
    graph = max(graphs, key=comparison.goodness, default=None)
    plain = comparison.of(comparison.best_plain)
    return plain if graph is None else _taken(comparison, graph, plain)


def _taken(comparison: Comparison, graph: ModelResult, plain: ModelResult) -> ModelResult:
    if graph.difference is None:
        return plain
    gain, _, is_told = _gain(comparison, graph.difference)
    return (graph if gain > 0 else plain) if is_told else _simpler(graph, plain)


def _gain(comparison: Comparison, difference: Difference) -> tuple[float, str, bool]:
    # How much better the graph model is, in words, and whether that is told from the noise.
    gain = -difference.mean if comparison.metric == "mae" else difference.mean
    size = _size(comparison.metric, difference)
    return gain, size, difference.is_beyond_noise and size != _LEVEL


def _simpler(graph: ModelResult, plain: ModelResult) -> ModelResult:
    weights = [r.num_parameters for r in (graph, plain) if r.num_parameters is not None]
    is_smaller = len(weights) == 2 and weights[0] < weights[1]
    return graph if is_smaller and graph.milliseconds <= plain.milliseconds else plain


def _why(taken: ModelResult, other: ModelResult) -> str:
    sizes, times = [], []
    for result in (taken, other):
        number = result.num_parameters
        sizes.append("?" if number is None else f"{number:,.0f}")
        times.append(f"{result.milliseconds:.2g}")
    numbers = f"({sizes[0]} against {sizes[1]} weights, {times[0]} against {times[1]} ms a sample)"
    if _simpler(taken, other) is taken:
        return f"; {taken.model.name} is the simpler one {numbers}."
    return f"; the plain model comes first, as the other is not both smaller and faster {numbers}."


def _nothing_learnt(comparison: Comparison) -> str:
    names = [result.model.name for result in comparison.results]
    best = comparison.best
    if best is None or FLOOR not in names:
        return ""
    if best.model.name == FLOOR:
        return (
            f"Take none: no model is better than '{FLOOR}' ({_score(comparison, best)}); there is "
            "nothing to learn from these samples, or there are too few."
        )
    difference = comparison.difference(best.model.name, FLOOR)
    if difference.is_beyond_noise or difference.num_splits < LEAST_PAIRS:
        return ""
    return (
        f"Take none yet: {_with_score(comparison, best)} is not beyond the noise above '{FLOOR}' "
        f"({_errors(comparison, difference)}); more samples would tell."
    )


def _with_score(comparison: Comparison, result: ModelResult) -> str:
    return f"{result.model.name} ({_score(comparison, result)})"


def _score(comparison: Comparison, result: ModelResult) -> str:
    metric = comparison.metric
    number = shown_number(metric, result.scores[metric].mean)
    return f"{NAMES[metric]} {number}" + (" %" if metric in PERCENT else "")


def _size(metric: str, difference: Difference) -> str:
    number = shown_number(metric, abs(difference.mean))
    return f"{number}{' points' if metric in PERCENT else ''}" if float(number) else _LEVEL


def _told(comparison: Comparison, difference: Difference) -> str:
    if difference.num_splits < LEAST_PAIRS:
        few = "1 split" if difference.num_splits == 1 else f"{difference.num_splits} splits"
        return f"which {few} cannot tell ('--seeds {comparison.seeds_to_tell}' would)"
    margin = shown_number(comparison.metric, difference.margin)
    return f"which is {difference.verdict} of ± {margin} ({_errors(comparison, difference)})"


def _errors(comparison: Comparison, difference: Difference) -> str:
    splits, trials = (
        shown_number(comparison.metric, error)
        for error in (difference.over_splits, difference.over_trials)
    )
    return (
        f"standard error {splits} over {difference.num_splits} splits and {trials} over "
        f"{difference.num_trials} {comparison.unit}s"
    )


def to_dict(comparison: Comparison) -> dict[str, Any]:
    r"""Returns a comparison as JSON values: scores as parts of one, missing numbers as
    :obj:`None`.
    """
    run, plan = comparison.run, comparison.run.plan
    (protocol,) = plan.protocols
    return {
        "format": "tactile comparison",
        "version": _VERSION,
        "data": {
            "class_path": plan.data.class_path,
            "caption": plan.data.caption,
            "num_samples": plan.facts.num_samples,
            "num_trials": plan.facts.num_trials,
            "num_groups": plan.facts.num_groups,
            "num_frames": plan.facts.num_frames,
            "class_names": list(plan.facts.class_names),
        },
        "protocol": protocol.protocol.describe(),
        "num_splits": comparison.num_splits,
        "task": plan.table.task,
        "metric": comparison.metric,
        "best_plain": comparison.best_plain,
        "models": [_model_dict(result) for result in comparison.results],
        "failed": run.failed,
        "missing": run.missing,
        "advice": advice(comparison),
    }


def _model_dict(result: ModelResult) -> dict[str, Any]:
    difference = result.difference
    return {
        "name": result.model.name,
        "title": result.model.title,
        "kind": "graph" if result.model.is_graph else "plain",
        "scores": {key: _summary_dict(value) for key, value in result.scores.items()},
        "difference": None
        if difference is None
        else {
            "mean": difference.mean,
            "over_splits": _number(difference.over_splits),
            "over_trials": _number(difference.over_trials),
            "num_splits": difference.num_splits,
            "num_trials": difference.num_trials,
            "margin": _number(difference.margin),
            "verdict": difference.verdict,
        },
        "num_parameters": result.num_parameters,
        "seconds": result.seconds,
        "milliseconds": result.milliseconds,
        "chosen": list(result.chosen),
    }


def _summary_dict(value: Summary) -> dict[str, float | None]:
    return {"mean": _number(value.mean), "sd": _number(value.sd)}


def _number(value: float) -> float | None:
    return value if math.isfinite(value) else None
