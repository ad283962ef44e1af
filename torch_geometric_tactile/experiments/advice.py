r"""Advice based on a comparison in words, and the comparison as JSON values."""

import math
from dataclasses import replace
from typing import Any, Literal, NamedTuple

import numpy as np
from scipy.stats import t

from torch_geometric_tactile.experiments._compared_models import FLOOR
from torch_geometric_tactile.experiments._scores import (
    MIN_PAIRS,
    NAMES,
    PERCENT,
    format_score,
    prediction_scores,
)
from torch_geometric_tactile.experiments.comparison import Comparison, ModelResult, Summary
from torch_geometric_tactile.experiments.differences import Difference, paired_difference
from torch_geometric_tactile.experiments.predictions import Predictions

_VERSION = 4  # of the JSON format
_MIN_CERTAIN_UNITS = 5  # with fewer, the advice warns that other units may change it
_SUGGESTED_FOLDS = 10  # suggested if fewer folds cannot prove a difference
_MAX_RANGE_UNITS = 50  # with more, an interval is printed, since extremes of many units say little
_SCORE_PHRASES = {
    "accuracy": "has an accuracy of",
    "balanced_accuracy": "has a balanced accuracy of",
    "mae": "has a mean absolute error of",
}
_MIN_SAMPLES_PER_UNIT = 5  # on average, to print the scores of single units


class _Recommendation(NamedTuple):
    r"""The recommended model, or the reason why none is recommended.

    Args:
        result (ModelResult, optional): The recommended model.
        best (ModelResult, optional): The model with the best mean score, on validation parts if the
            parts are given. It differs from :obj:`result` if a simpler model is recommended.
        obstacle (str): The reason why none is recommended: no model has a result for every split,
            given parts share trials, the constant answer is the best, or the best model exceeds
            the constant answer by at most one standard error on the test parts.
    """

    result: ModelResult | None
    best: ModelResult | None
    obstacle: Literal["", "no results", "shared trials", "constant", "near constant"] = ""


def advice(comparison: Comparison) -> str:
    r"""Returns the recommendation of a comparison in words. The text has three parts:

    * **The recommendation** is the model with the best mean score (on validation parts if the
      parts are given), unless a simpler model is about as good (:func:`recommended`).
    * **The verdict** compares this model with the best model of the other kind (graph or plain)
      and with the constant answer.
    * **The last sentence** can be quoted. It states the score, its variation, and what is new in
      the test parts.

    Args:
        comparison (Comparison): The scores.
    """
    recommendation = _recommend(comparison)
    result = recommendation.result
    if result is None:
        return _no_recommendation(comparison, recommendation)
    sentences = [
        *_model_sentences(comparison, recommendation, result),
        _contradiction_sentence(comparison, result),
        _constant_sentence(comparison, result),
        _units_sentence(comparison),
        *(f"{text[0].upper()}{text[1:]}." for text in comparison.run.plan.shared),
        _quotation(comparison, result),
    ]
    return " ".join(filter(None, sentences))


def recommended(comparison: Comparison) -> ModelResult | None:
    r"""Returns the model that :func:`advice` recommends, or :obj:`None` if it recommends none.

    This is the model with the best mean score, unless a simpler model is about as good. A simpler
    model has at most half the weights and is not slower. It is about as good if its score is within
    the tolerance of the comparison and within one standard error of the paired difference (the
    larger of the errors over splits and over units). Of several such models, the smallest is
    recommended. With given parts, scores and differences are computed on the validation parts.

    No model is recommended if the best model exceeds the constant answer by at most one standard
    error on the test parts, or if given parts share trials.

    Args:
        comparison (Comparison): The scores.
    """
    return _recommend(comparison).result


def _recommend(comparison: Comparison) -> _Recommendation:
    r"""Recommends a model by the rule of :func:`recommended`.

    With given parts, scores and differences are computed on the validation parts. The test part
    then only decides whether the model is better than the constant answer.

    Args:
        comparison (Comparison): The scores.
    """
    best = comparison.best
    if best is None:
        return _Recommendation(None, None, "no results")
    (protocol,) = comparison.run.plan.protocols
    if comparison.units.num_leaked and protocol.protocol.by == "given":
        return _Recommendation(None, best, "shared trials")
    if best.model.name == FLOOR:
        return _Recommendation(None, best, "constant")
    has_floor = any(result.model.name == FLOOR for result in comparison.results)
    if has_floor and not _is_ahead_of_floor(comparison, best):
        return _Recommendation(None, best, "near constant")
    models = [result for result in comparison.results if result.model.name != FLOOR]
    simpler = [r for r in models if _is_simpler(r, best) and _is_close(comparison, best, r)]
    return _Recommendation(min(simpler, key=_size, default=best), best)


def _is_ahead_of_floor(comparison: Comparison, result: ModelResult) -> bool:
    difference = comparison.difference(result.model.name, FLOOR)
    gain = -difference.mean if comparison.metric == "mae" else difference.mean
    return gain > _error_or_zero(difference)


def _is_close(comparison: Comparison, best: ModelResult, result: ModelResult) -> bool:
    # The small number allows for rounding of a gap that equals the tolerance.
    if not comparison.merit(best) - comparison.merit(result) <= comparison.tolerance + 1e-12:
        return False
    compute = comparison.validation_difference if comparison.is_validated else comparison.difference
    difference = compute(best.model.name, result.model.name)
    return not abs(difference.mean) > _error_or_zero(difference)


def _error_or_zero(difference: Difference) -> float:
    return 0.0 if math.isnan(difference.error) else difference.error


def _is_simpler(result: ModelResult, best: ModelResult) -> bool:
    return 2 * _size(result) <= _size(best) < math.inf and (
        result.milliseconds <= best.milliseconds
    )


def _size(result: ModelResult) -> float:
    return math.inf if result.num_parameters is None else result.num_parameters


def _no_recommendation(comparison: Comparison, recommendation: _Recommendation) -> str:
    best, units, constant = recommendation.best, comparison.units, comparison.constant
    if best is None:
        return "No model has a result for every split yet: run the same command again."
    floor = f"always answering {constant.name} ({_format_number(comparison, constant.score)})"
    if recommendation.obstacle == "shared trials":
        return (
            f"No model is recommended: {_format_count(units.num_leaked, 'trial')} of the test part "
            f"{'is' if units.num_leaked == 1 else 'are'} also in the training part, so the scores "
            "say nothing about new trials. Put each trial into one part, or split by trial."
        )
    if recommendation.obstacle == "constant":
        return (
            f"No model is recommended: none is better than {floor}. Either the readings do not "
            "determine the answer, or there are too few samples."
        )
    difference = comparison.difference(best.model.name, FLOOR)
    return (
        f"No model is recommended yet: the best model, {_name_with_score(comparison, best)}, is "
        f"{_relation_to_constant(comparison, best)} {floor} "
        f"({_describe_errors(comparison, difference)}). More {units.name}s are needed."
    )


def _relation_to_constant(comparison: Comparison, result: ModelResult) -> str:
    is_worse = comparison.goodness(result) < comparison.goodness(comparison.of(FLOOR))
    return "worse on the test part than" if is_worse else "within one standard error of"


def _model_sentences(
    comparison: Comparison, recommendation: _Recommendation, result: ModelResult
) -> list[str]:
    # Returns sentences on the recommended model and on the best model of the other kind.
    best = recommendation.best
    text = f"Use {_name_with_score(comparison, result)}."
    if best is not None and best is not result:
        text += (
            f" It is simpler than {best.model.name}, the best model, and about as good "
            f"({_compare_sizes(result, best)})."
        )
    rivals = [r for r in comparison.results if r is not result and r.model.name != FLOOR]
    cross_kind_rivals = [r for r in rivals if r.model.is_graph != result.model.is_graph]
    if not rivals:
        return [f"{text} No other model has a score."]
    rival = max(cross_kind_rivals or rivals, key=comparison.merit)
    kind = "best graph model" if rival.model.is_graph else "best plain model"
    if not cross_kind_rivals:
        kind = "next best model" if best is result else "best other model"
    difference = comparison.difference(rival.model.name, result.model.name)
    size = format_score(comparison.metric, abs(difference.mean))
    if not float(size):
        return [f"{text} The {kind}, {rival.model.name}, has the same score."]
    points = " points" if comparison.metric in PERCENT else ""
    is_better = (difference.mean > 0) != (comparison.metric == "mae")
    comparative = "better" if is_better else "worse"
    text += f" The {kind}, {rival.model.name}, is {size}{points} {comparative}"
    if difference.is_beyond_noise:
        return [f"{text}, which is {_describe_noise(comparison, difference)}."]
    leader = rival if is_better else result
    return [f"{text}.", _unproved_sentence(comparison, leader, difference)]


def _contradiction_sentence(comparison: Comparison, result: ModelResult) -> str:
    # Returns a sentence if a model that the validation scores did not select is better on the test
    # part, beyond the noise.
    leader = max(comparison.results, key=comparison.goodness)
    if not comparison.is_validated or leader is result:
        return ""
    difference = comparison.difference(leader.model.name, result.model.name)
    if not difference.is_beyond_noise:
        return ""
    size = format_score(comparison.metric, abs(difference.mean))
    points = " points" if comparison.metric in PERCENT else ""
    return (
        f"Validation and test scores disagree: on the test part, {leader.model.name} is "
        f"{size}{points} better than {result.model.name}, beyond the noise. Test both on new "
        f"{comparison.units.name}s."
    )


def _describe_noise(comparison: Comparison, difference: Difference) -> str:
    margin = format_score(comparison.metric, difference.margin)
    return f"{difference.verdict} of ± {margin} ({_describe_errors(comparison, difference)})"


def _unproved_sentence(comparison: Comparison, leader: ModelResult, difference: Difference) -> str:
    # Returns sentences on the evidence that one of two models is better, and how to prove it.
    ahead, behind = difference.units
    num_won = difference.splits.above
    if difference.mean < 0:
        ahead, behind, num_won = behind, ahead, difference.splits.below
    text = f"{leader.model.name} is better in "
    if difference.num_splits > 1:
        text += f"{num_won} of {difference.num_splits} splits and in "
    text += f"{_format_count(ahead, difference.unit)}, and worse in {behind}"
    if difference.num_units < MIN_PAIRS:
        count = _format_count(difference.num_units, difference.unit)
        return f"{text}. {count} cannot prove a difference; more {difference.unit}s could."
    if math.isnan(difference.margin):
        count, hint = (
            _format_count(difference.num_splits, "split"),
            _folds_hint(comparison, difference),
        )
        return f"{text}. {count} cannot prove a difference; {hint}."
    margin = format_score(comparison.metric, difference.margin)
    noise = f"the noise of ± {margin} ({_describe_errors(comparison, difference)})"
    if not abs(difference.mean) > difference.error:
        return f"{text}. The difference is within {noise}."
    if difference.is_proved_by(_SUGGESTED_FOLDS):
        hint = _folds_hint(comparison, difference)
        count = _format_count(difference.num_splits, "split")
        return f"{text}. {count} cannot prove a difference beyond {noise}; {hint}."
    return f"{text}. The difference is within {noise}; more {difference.unit}s could prove it."


def _folds_hint(comparison: Comparison, difference: Difference) -> str:
    (protocol,) = comparison.run.plan.protocols
    folds, by = protocol.protocol.folds, protocol.protocol.by
    has_units = by == "frame" or difference.num_units >= _SUGGESTED_FOLDS
    if folds is None or folds >= _SUGGESTED_FOLDS or not has_units:
        return f"more {difference.unit}s could"
    return f"'--folds {_SUGGESTED_FOLDS}' could"


def _constant_sentence(comparison: Comparison, result: ModelResult) -> str:
    if FLOOR not in [measured.model.name for measured in comparison.results]:
        return ""
    difference = comparison.difference(result.model.name, FLOOR)
    if difference.is_beyond_noise:
        return ""
    return (
        f"{result.model.name} is not clearly better than always answering "
        f"{comparison.constant.name} ({_describe_errors(comparison, difference)}). More "
        f"{comparison.units.name}s are needed."
    )


def _units_sentence(comparison: Comparison) -> str:
    num_units = len(_predictions_by_unit(comparison, comparison.results[0].model.name))
    if comparison.units.num_leaked:
        return (
            f"{_format_count(comparison.units.num_leaked, 'trial')} "
            f"{'is' if comparison.units.num_leaked == 1 else 'are'} in both the training and the "
            "test part of a split: the scores say nothing about new trials. Split by trial."
        )
    num_seen, unit = comparison.units.num_seen, comparison.units.name
    if num_seen:
        return (
            f"{num_seen} of {_format_count(num_units, unit)} in the test part "
            f"{'is' if num_seen == 1 else 'are'} also in the training part: put each {unit} into "
            "one part only."
        )
    if num_units >= _MIN_CERTAIN_UNITS:
        return ""
    unit = comparison.units.name
    return (
        f"There {'is' if num_units == 1 else 'are'} only {_format_count(num_units, unit)}: with "
        f"other {unit}s, another model may be the best."
    )


def _quotation(comparison: Comparison, result: ModelResult) -> str:
    r"""Returns a sentence that can be quoted. It states the score of a model, its variation, what
    is new in the test parts, and the score of the constant answer.

    Args:
        comparison (Comparison): The scores.
        result (ModelResult): The model.
    """
    metric, unit, constant = comparison.metric, comparison.units.name, comparison.constant
    name, value = result.model.name, _format_number(comparison, result.scores[metric].mean)
    test_part = f"On {unit}s that the model has never seen"
    if comparison.units.num_leaked:
        test_part = "On samples from trials that the model has seen"
    elif comparison.units.num_seen:
        test_part = f"On samples from {unit}s that are mostly new to the model"
    num_models = sum(measured.model.name != FLOOR for measured in comparison.results)
    by = "validation scores" if comparison.is_validated else "these scores"
    remarks = [
        _describe_variation(comparison, name),
        f"always answering {constant.name} scores {_format_number(comparison, constant.score)}",
        f"best of {num_models} models, selected by {by}" if num_models > 1 else "",
        _describe_trainings(comparison),
    ]
    details = "; ".join(filter(None, remarks))
    return f"{test_part}, {name} {_SCORE_PHRASES[metric]} {value} ({details})."


def _describe_trainings(comparison: Comparison) -> str:
    if not comparison.has_given_parts:
        return ""
    if comparison.num_seeds > 1:
        return f"mean of {comparison.num_seeds} training runs"
    return "one training run; another run would give another score"


def _describe_variation(comparison: Comparison, name: str) -> str:
    # Returns the lowest and the highest score over the units, or the 95 % interval of the mean.
    metric, unit = comparison.metric, comparison.units.name
    by_unit = _predictions_by_unit(comparison, name)
    count = _format_count(len(by_unit), unit)
    num_samples = sum(len(part.y) for part in by_unit.values())
    if 1 < len(by_unit) <= _MAX_RANGE_UNITS and num_samples >= _MIN_SAMPLES_PER_UNIT * len(by_unit):
        scores = [
            prediction_scores(part.y, part.prediction, metric == "mae")[metric]
            for part in by_unit.values()
        ]
        worst, best = format_score(metric, min(scores)), _format_number(comparison, max(scores))
        return f"{count} with {worst} to {best} each"
    if len(by_unit) < MIN_PAIRS:
        return count
    low, high = _confidence_interval(
        _score_with_errors(comparison, name), is_share=metric in PERCENT
    )
    interval = f"{format_score(metric, low)} to {_format_number(comparison, high)}"
    return f"{count}; 95 % confidence interval {interval}"


def _confidence_interval(score: Difference, is_share: bool) -> tuple[float, float]:
    # Returns the 95 % interval of a score over its units. A share gets Wilson's interval, which
    # stays within 0 and 1 and has a width even if all units are correct.
    p, quantile = score.mean, float(t.ppf(0.975, score.num_units - 1))
    margin = quantile * score.over_units
    if not is_share:
        return p - margin, p + margin
    variance = p * (1 - p)
    a = margin**2 / variance if variance > 1e-9 else quantile**2 / score.num_units
    center, half = p + a / 2, math.sqrt(margin**2 + a**2 / 4)
    return (center - half) / (1 + a), (center + half) / (1 + a)


def _predictions_by_unit(comparison: Comparison, name: str) -> dict[int, Predictions]:
    # Returns the predictions of a model for each unit, over all splits. Samples without trials are
    # units by their index.
    joined = Predictions.join(comparison.predictions(name))
    units = joined.index if joined.trial is None else joined.trial
    assert units is not None
    order = np.argsort(units, kind="stable")
    numbers, starts = np.unique(units[order], return_index=True)
    parts = np.split(order, starts[1:])
    return {n: joined.select(part) for n, part in zip(numbers.tolist(), parts, strict=True)}


def _score_with_errors(comparison: Comparison, name: str) -> Difference:
    # Returns the score of a model with its errors, as the difference from predictions that score
    # zero.
    predictions = comparison.predictions(name)
    zero_score = [
        replace(p, prediction=p.y if comparison.metric == "mae" else np.full_like(p.y, -1))
        for p in predictions
    ]
    return paired_difference(predictions, zero_score, comparison.metric)


def _compare_sizes(result: ModelResult, best: ModelResult) -> str:
    sizes = [f"{r.num_parameters:,.0f}" for r in (result, best) if r.num_parameters is not None]
    times = [f"{r.milliseconds:.2g}" for r in (result, best)]
    return f"{' instead of '.join(sizes)} weights, {' instead of '.join(times)} ms per sample"


def _name_with_score(comparison: Comparison, result: ModelResult) -> str:
    score = _format_number(comparison, result.scores[comparison.metric].mean)
    if comparison.is_validated and result.validation is not None:
        score += f", {_format_number(comparison, result.validation)} on validation parts"
    return f"{result.model.name} ({NAMES[comparison.metric]} {score})"


def _format_number(comparison: Comparison, value: float) -> str:
    text = format_score(comparison.metric, value)
    return f"{text} %" if comparison.metric in PERCENT else text


def _format_count(count: int, unit: str) -> str:
    return f"1 {unit}" if count == 1 else f"{count:,} {unit}s"


def _describe_errors(comparison: Comparison, difference: Difference) -> str:
    texts = [
        f"{format_score(comparison.metric, error)} over {_format_count(count, unit)}"
        for error, count, unit in (
            (difference.over_splits, difference.num_splits, "split"),
            (difference.over_units, difference.num_units, difference.unit),
            (difference.over_seeds, difference.num_seeds, "seed"),
        )
        if not math.isnan(error)
    ]
    return f"standard error {' and '.join(texts)}" if texts else "no standard error"


def to_dict(comparison: Comparison) -> dict[str, Any]:
    r"""Returns a comparison as JSON values. Scores are from 0 to 1; missing numbers are
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
