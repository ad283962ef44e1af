r"""The recommendation of a comparison in words, and the comparison as plain data."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.stats import t

from torch_geometric_tactile.experiments._compared_models import FLOOR
from torch_geometric_tactile.experiments._recommendation import Recommendation, recommend
from torch_geometric_tactile.experiments._scores import (
    LEAST_PAIRS,
    NAMES,
    PERCENT,
    prediction_scores,
    shown_number,
)
from torch_geometric_tactile.experiments.comparison import Comparison, ModelResult, Summary
from torch_geometric_tactile.experiments.differences import Difference, paired_difference
from torch_geometric_tactile.experiments.predictions import Predictions

_VERSION = 4
_FEW_UNITS = 5  # with fewer the choice is called uncertain
_FOLDS = 10  # that are suggested where fewer cannot prove a difference
_LISTED_UNITS = 50  # whose lowest and highest scores are told
_VERBS = {
    "accuracy": "is right in",
    "balanced_accuracy": "has a balanced accuracy of",
    "mae": "has a mean absolute error of",
}
_SAMPLES_PER_UNIT = 5  # of a unit that has a score of its own


def advice(comparison: Comparison) -> str:
    r"""Returns three things in plain words. **The recommendation** is the model with the best mean,
    with given parts on validation parts, unless a simpler one is about as good
    (:func:`recommended`). **The verdict** says what is proved
    about it, against the best model of the other kind (graph or plain) and against the constant
    answer. **The last sentence** can be quoted: the score, what is new in the test parts, and how
    much the score varies.

    Args:
        comparison (Comparison): The scores.
    """
    recommendation = recommend(comparison)
    result = recommendation.result
    if result is None:
        return _no_recommendation(comparison, recommendation)
    sentences = [
        *_choice(comparison, recommendation, result),
        _contradiction(comparison, result),
        _over_constant(comparison, result),
        _few_units(comparison),
        *(f"{text[0].upper()}{text[1:]}." for text in comparison.run.plan.shared),
        quotation(comparison, result),
    ]
    return " ".join(filter(None, sentences))


def recommended(comparison: Comparison) -> ModelResult | None:
    r"""Returns the model that :func:`advice` recommends, or :obj:`None` if it recommends none.

    It is the model with the best mean, unless another one is within one standard error of the
    paired difference (the larger of those over splits and over units) and within the tolerance of
    the comparison, has at most half the weights, and is not slower. Of several such models it is
    the smallest. With given parts, means and differences are those on validation parts.

    None is recommended if the best is not ahead of the constant answer by more than one standard
    error on the test parts, or if given parts share trials.

    Args:
        comparison (Comparison): The scores.
    """
    return recommend(comparison).result


def _no_recommendation(comparison: Comparison, recommendation: Recommendation) -> str:
    best, units, constant = recommendation.best, comparison.units, comparison.constant
    if best is None:
        return "No model has a result for every split yet: run the same command again."
    floor = f"always answering {constant.name} ({_number(comparison, constant.score)})"
    if recommendation.obstacle == "shared trials":
        return (
            f"Take none: {_count(units.num_leaked, 'trial')} of the test part "
            f"{'is' if units.num_leaked == 1 else 'are'} in the training part too, so the scores "
            "say nothing about new trials. Put each trial into one part, or split by trial."
        )
    if recommendation.obstacle == "constant":
        return (
            f"Take none: no model is better than {floor}. There is nothing to learn from these "
            "samples, or there are too few."
        )
    difference = comparison.difference(best.model.name, FLOOR)
    return (
        f"Take none yet: {_with_score(comparison, best)}, the best model, is "
        f"{_relation_to_floor(comparison, best)} {floor} ({_errors(comparison, difference)}). More "
        f"{units.name}s would tell."
    )


def _relation_to_floor(comparison: Comparison, result: ModelResult) -> str:
    is_worse = comparison.goodness(result) < comparison.goodness(comparison.of(FLOOR))
    return "worse on the test part than" if is_worse else "within one standard error of"


def _choice(
    comparison: Comparison, recommendation: Recommendation, result: ModelResult
) -> list[str]:
    # The sentences on the model, and on the best one of the other kind.
    best = recommendation.best
    text = f"Take {_with_score(comparison, result)}"
    if best is not None and best is not result:
        text += (
            f", which is simpler than {best.model.name}, the best model, and about as good "
            f"({_simplicity(result, best)})"
        )
    rivals = [r for r in comparison.results if r is not result and r.model.name != FLOOR]
    of_other_kind = [r for r in rivals if r.model.is_graph != result.model.is_graph]
    if not rivals:
        return [f"{text}; no other model has a score."]
    rival = max(of_other_kind or rivals, key=comparison.merit)
    kind = "the best graph model" if rival.model.is_graph else "the best plain model"
    if not of_other_kind:
        kind = "the next best model" if best is result else "the best of the others"
    difference = comparison.difference(rival.model.name, result.model.name)
    size = shown_number(comparison.metric, abs(difference.mean))
    if not float(size):
        return [f"{text}: {rival.model.name}, {kind}, is level with it."]
    points = " points" if comparison.metric in PERCENT else ""
    is_better = (difference.mean > 0) != (comparison.metric == "mae")
    text += f": {rival.model.name}, {kind}, is {size}{points} {'better' if is_better else 'worse'}"
    if difference.is_beyond_noise:
        return [f"{text}, which is {_beyond(comparison, difference)}."]
    leader = rival if is_better else result
    return [f"{text}.", _not_proved(comparison, leader, difference)]


def _contradiction(comparison: Comparison, result: ModelResult) -> str:
    # What is said of the best model on the test part, if another one was chosen by validation
    # scores, and that cannot be by chance.
    leader = max(comparison.results, key=comparison.goodness)
    if not comparison.is_validated or leader is result:
        return ""
    difference = comparison.difference(leader.model.name, result.model.name)
    if not difference.is_beyond_noise:
        return ""
    size = shown_number(comparison.metric, abs(difference.mean))
    points = " points" if comparison.metric in PERCENT else ""
    return (
        f"The validation parts and the test part disagree: on the test part {leader.model.name} is "
        f"{size}{points} better than {result.model.name}, beyond the noise. Test both on new "
        f"{comparison.units.name}s."
    )


def _beyond(comparison: Comparison, difference: Difference) -> str:
    margin = shown_number(comparison.metric, difference.margin)
    return f"{difference.verdict} of ± {margin} ({_errors(comparison, difference)})"


def _not_proved(comparison: Comparison, leader: ModelResult, difference: Difference) -> str:
    # What speaks for the better one of two models, and what could prove it.
    ahead, behind = difference.units
    num_won = difference.splits.above
    if difference.mean < 0:
        ahead, behind, num_won = behind, ahead, difference.splits.below
    text = f"{leader.model.name} is ahead in "
    if difference.num_splits > 1:
        text += f"{num_won} of {difference.num_splits} splits and in "
    text += f"{_count(ahead, difference.unit)} against {behind}"
    if difference.num_units < LEAST_PAIRS:
        count = _count(difference.num_units, difference.unit)
        return f"{text}; {count} cannot prove it; more {difference.unit}s could."
    if math.isnan(difference.margin):
        count, hint = _count(difference.num_splits, "split"), _more_folds(comparison, difference)
        return f"{text}; {count} cannot prove it; {hint}."
    margin = shown_number(comparison.metric, difference.margin)
    noise = f"the noise of ± {margin} ({_errors(comparison, difference)})"
    if not abs(difference.mean) > difference.error:
        return f"{text}, which is within {noise}."
    if difference.is_proved_by(_FOLDS):
        hint = _more_folds(comparison, difference)
        count = _count(difference.num_splits, "split")
        return f"{text}, but {count} cannot prove it beyond {noise}; {hint}."
    return f"{text}, but within {noise}; more {difference.unit}s could prove it."


def _more_folds(comparison: Comparison, difference: Difference) -> str:
    (protocol,) = comparison.run.plan.protocols
    folds, by = protocol.protocol.folds, protocol.protocol.by
    has_units = by == "frame" or difference.num_units >= _FOLDS
    if folds is None or folds >= _FOLDS or not has_units:
        return f"more {difference.unit}s could"
    return f"'--folds {_FOLDS}' could"


def _over_constant(comparison: Comparison, result: ModelResult) -> str:
    if FLOOR not in [other.model.name for other in comparison.results]:
        return ""
    difference = comparison.difference(result.model.name, FLOOR)
    if difference.is_beyond_noise:
        return ""
    return (
        f"{result.model.name} is not clearly better than always answering "
        f"{comparison.constant.name} ({_errors(comparison, difference)}); more "
        f"{comparison.units.name}s would tell."
    )


def _few_units(comparison: Comparison) -> str:
    num_units = len(_by_unit(comparison, comparison.results[0].model.name))
    if comparison.units.num_leaked:
        return (
            f"{_count(comparison.units.num_leaked, 'trial')} "
            f"{'is' if comparison.units.num_leaked == 1 else 'are'} in the training and the test "
            "part of a split: the scores say nothing about new trials (split by trial)."
        )
    num_seen, unit = comparison.units.num_seen, comparison.units.name
    if num_seen:
        return (
            f"{num_seen} of {_count(num_units, unit)} in the test part "
            f"{'is' if num_seen == 1 else 'are'} in the training part too: put each {unit} into "
            "one part."
        )
    if num_units >= _FEW_UNITS:
        return ""
    return f"Only {_count(num_units, comparison.units.name)}: others may give another choice."


def quotation(comparison: Comparison, result: ModelResult) -> str:
    r"""Returns a sentence that can be quoted: the score of a model, what is new in the test parts,
    how much the score varies, and what the constant answer scores.

    Args:
        comparison (Comparison): The scores.
        result (ModelResult): The model.
    """
    metric, unit, constant = comparison.metric, comparison.units.name, comparison.constant
    name, value = result.model.name, _number(comparison, result.scores[metric].mean)
    where = f"On {unit}s that the model has never seen"
    if comparison.units.num_leaked:
        where = "On samples of trials that the model has seen"
    elif comparison.units.num_seen:
        where = f"On {unit}s most of which the model has never seen"
    num_models = sum(other.model.name != FLOOR for other in comparison.results)
    by = "validation scores" if comparison.is_validated else "these scores"
    remarks = [
        _variation(comparison, name),
        f"always answering {constant.name} would give {_number(comparison, constant.score)}",
        f"the best of {num_models} models, chosen by {by}" if num_models > 1 else "",
        _trainings(comparison),
    ]
    return f"{where}, {name} {_VERBS[metric]} {value} ({'; '.join(filter(None, remarks))})."


def _trainings(comparison: Comparison) -> str:
    if not comparison.has_given_parts:
        return ""
    if comparison.num_seeds > 1:
        return f"the mean of {comparison.num_seeds} trainings"
    return "one training, and another one would give another score"


def _variation(comparison: Comparison, name: str) -> str:
    # The lowest and the highest score of a unit, or the 95 % interval of the mean.
    metric, unit = comparison.metric, comparison.units.name
    by_unit = _by_unit(comparison, name)
    count = _count(len(by_unit), unit)
    num_samples = sum(len(part.y) for part in by_unit.values())
    if 1 < len(by_unit) <= _LISTED_UNITS and num_samples >= _SAMPLES_PER_UNIT * len(by_unit):
        scores = [
            prediction_scores(part.y, part.prediction, metric == "mae")[metric]
            for part in by_unit.values()
        ]
        worst, best = shown_number(metric, min(scores)), _number(comparison, max(scores))
        return f"{count}, {worst} to {best} each"
    if len(by_unit) < LEAST_PAIRS:
        return count
    low, high = _interval(_score_of(comparison, name), is_share=metric in PERCENT)
    return (
        f"{count}, {shown_number(metric, low)} to {_number(comparison, high)} with 95 % confidence"
    )


def _interval(score: Difference, is_share: bool) -> tuple[float, float]:
    # The 95 % interval of a score over its units; of a share that of Wilson, within 0 and 1, which
    # has a width where all units are right.
    p, quantile = score.mean, float(t.ppf(0.975, score.num_units - 1))
    margin = quantile * score.over_units
    if not is_share:
        return p - margin, p + margin
    variance = p * (1 - p)
    a = margin**2 / variance if variance > 1e-9 else quantile**2 / score.num_units
    center, half = p + a / 2, math.sqrt(margin**2 + a**2 / 4)
    return (center - half) / (1 + a), (center + half) / (1 + a)


def _by_unit(comparison: Comparison, name: str) -> dict[int, Predictions]:
    # The predictions of a model for each unit, of all splits; of samples without their places none.
    joined = Predictions.join(comparison.predictions(name))
    units = joined.index if joined.trial is None else joined.trial
    assert units is not None
    order = np.argsort(units, kind="stable")
    numbers, starts = np.unique(units[order], return_index=True)
    parts = np.split(order, starts[1:])
    return {n: joined.select(part) for n, part in zip(numbers.tolist(), parts, strict=True)}


def _score_of(comparison: Comparison, name: str) -> Difference:
    # The score of a model with its errors: the difference to a model without a score.
    predictions = comparison.predictions(name)
    no_score = [
        replace(p, prediction=p.y if comparison.metric == "mae" else np.full_like(p.y, -1))
        for p in predictions
    ]
    return paired_difference(predictions, no_score, comparison.metric)


def _simplicity(result: ModelResult, best: ModelResult) -> str:
    sizes = [f"{r.num_parameters:,.0f}" for r in (result, best) if r.num_parameters is not None]
    times = [f"{r.milliseconds:.2g}" for r in (result, best)]
    return f"{' against '.join(sizes)} weights, {' against '.join(times)} ms a sample"


def _with_score(comparison: Comparison, result: ModelResult) -> str:
    score = _number(comparison, result.scores[comparison.metric].mean)
    if comparison.is_validated and result.validation is not None:
        score += f", {_number(comparison, result.validation)} on validation parts"
    return f"{result.model.name} ({NAMES[comparison.metric]} {score})"


def _number(comparison: Comparison, value: float) -> str:
    text = shown_number(comparison.metric, value)
    return f"{text} %" if comparison.metric in PERCENT else text


def _count(count: int, unit: str) -> str:
    return f"1 {unit}" if count == 1 else f"{count:,} {unit}s"


def _errors(comparison: Comparison, difference: Difference) -> str:
    texts = [
        f"{shown_number(comparison.metric, error)} over {_count(count, unit)}"
        for error, count, unit in (
            (difference.over_splits, difference.num_splits, "split"),
            (difference.over_units, difference.num_units, difference.unit),
            (difference.over_seeds, difference.num_seeds, "seed"),
        )
        if not math.isnan(error)
    ]
    return f"standard error {' and '.join(texts)}" if texts else "no standard error"


def to_dict(comparison: Comparison) -> dict[str, Any]:
    r"""Returns a comparison as JSON values: scores as parts of one, missing numbers as
    :obj:`None`.
    """
    run, plan = comparison.run, comparison.run.plan
    result = recommended(comparison)
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
        "num_seeds": comparison.num_seeds,
        "chosen_by": "validation" if comparison.is_validated else "test",
        "task": plan.table.task,
        "metric": comparison.metric,
        "unit": comparison.units.name,
        "constant": {"name": comparison.constant.name, "score": comparison.constant.score},
        "tolerance": comparison.tolerance,
        "recommended": None if result is None else result.model.name,
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
        "validation": result.validation,
        "difference": None
        if difference is None
        else {
            "mean": difference.mean,
            "over_splits": _json_number(difference.over_splits),
            "over_units": _json_number(difference.over_units),
            "over_seeds": _json_number(difference.over_seeds),
            "num_splits": difference.num_splits,
            "num_units": difference.num_units,
            "margin": _json_number(difference.margin),
            "verdict": difference.verdict,
        },
        "num_parameters": result.num_parameters,
        "seconds": result.seconds,
        "milliseconds": result.milliseconds,
        "chosen": list(result.chosen),
    }


def _summary_dict(value: Summary) -> dict[str, float | None]:
    return {"mean": _json_number(value.mean), "sd": _json_number(value.sd)}


def _json_number(value: float) -> float | None:
    return value if math.isfinite(value) else None
