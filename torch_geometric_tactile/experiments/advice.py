r"""What a comparison says in one sentence, and as plain data."""

import math
from typing import Any

from torch_geometric_tactile.experiments.compared_models import FLOOR
from torch_geometric_tactile.experiments.comparison import Comparison, ModelResult, Summary
from torch_geometric_tactile.experiments.differences import Difference

VERSION = 1
NAMES = {
    "accuracy": "accuracy",
    "balanced_accuracy": "balanced accuracy",
    "f1": "macro F1",
    "mae": "MAE",
    "rmse": "RMSE",
    "r2": "R2",
}
_PERCENT = ("accuracy", "balanced_accuracy", "f1")


def shown_number(metric: str, value: float) -> str:
    r"""Returns a score as text, in percent where that is usual.

    Args:
        metric (str): Name of the score.
        value (float): The score, or a difference of two.

    Examples:
        >>> shown_number("accuracy", 0.918), shown_number("mae", 0.00435)
        ('91.8', '0.00435')
    """
    if math.isnan(value):
        return "?"
    text = f"{100 * value:.1f}" if metric in _PERCENT else f"{value:.3g}"
    return text.removeprefix("-") if not float(text) else text  # not "-0.0"


def advice(comparison: Comparison) -> str:
    r"""Returns which model to take, and whether it differs from the best plain model by more than
    the noise: more than twice the standard error, over splits or over trials, whichever is larger.
    Where it does not, the plain model is taken.

    Args:
        comparison (Comparison): What came of the runs.
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
    gain = -difference.mean if comparison.metric == "mae" else difference.mean
    size = _size(comparison.metric, difference)
    noise = _noise(comparison, difference)
    if difference.is_beyond_noise and gain > 0:
        return (
            f"Take {_with_score(comparison, graph)}: {size} better than {plain.model.name}, the "
            f"best plain model, which is beyond the noise ({noise})."
        )
    taken = f"Take {_with_score(comparison, plain)}"
    worse = "better" if gain > 0 else "worse"
    if difference.is_beyond_noise:
        return (
            f"{taken}: {graph.model.name}, the best graph model, is {size} worse, which is beyond "
            f"the noise ({noise})."
        )
    return (
        f"{taken}: {graph.model.name}, the best graph model, is {size} {worse}, which is within "
        f"the noise ({noise}), and the plain model is the simpler one."
    )


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
    if difference.is_beyond_noise:
        return ""
    return (
        f"Take none yet: {_with_score(comparison, best)} is not beyond the noise above '{FLOOR}' "
        f"({_noise(comparison, difference)}); more samples would tell."
    )


def _with_score(comparison: Comparison, result: ModelResult) -> str:
    return f"{result.model.name} ({_score(comparison, result)})"


def _score(comparison: Comparison, result: ModelResult) -> str:
    metric = comparison.metric
    number = shown_number(metric, result.scores[metric].mean)
    return f"{NAMES[metric]} {number}" + (" %" if metric in _PERCENT else "")


def _size(metric: str, difference: Difference) -> str:
    number = shown_number(metric, abs(difference.mean))
    return f"{number} points" if metric in _PERCENT else number


def _noise(comparison: Comparison, difference: Difference) -> str:
    if math.isnan(difference.error):
        return f"unknown: there is one split of one {comparison.unit}"
    parts = []
    for error, count, unit in (
        (difference.over_splits, difference.num_splits, "splits"),
        (difference.over_trials, difference.num_trials, f"{comparison.unit}s"),
    ):
        if math.isfinite(error):
            parts.append(f"{shown_number(comparison.metric, error)} over {count} {unit}")
    return f"standard error {' and '.join(parts)}"


def to_dict(comparison: Comparison) -> dict[str, Any]:
    r"""Returns a comparison as JSON values: scores as parts of one, missing numbers as
    :obj:`None`.

    Args:
        comparison (Comparison): What came of the runs.
    """
    run, plan = comparison.run, comparison.run.plan
    (protocol,) = plan.protocols
    return {
        "format": "tactile comparison",
        "version": VERSION,
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
        "num_splits": len({(e.seed, e.fold) for e in plan.experiments}),
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
            "beyond_noise": difference.is_beyond_noise,
        },
        "num_parameters": result.num_parameters,
        "seconds": result.seconds,
        "chosen": list(result.chosen),
    }


def _summary_dict(value: Summary) -> dict[str, float | None]:
    return {"mean": _number(value.mean), "sd": _number(value.sd)}


def _number(value: float) -> float | None:
    return value if math.isfinite(value) else None
