r"""How often `tactile compare` recommends the worse of two models, on made-up scores whose truth is
known: two models that are equally good, and one that is better by one and by three standard errors
of their difference, on 2, 3, 5 and 10 folds and on one given part: of this, as it is (a model is
chosen by validation scores on five fifths of the training part) and chosen by the test part itself.

160 trials; both models are right in 85 % of them on average, and each split adds a deviation of two
points. The larger model (48,611 weights, 0.35 ms a sample) is a graph model, the smaller one (39
weights, 0.014 ms) is plain. Nothing is trained.

Examples:
    python studies/recommendation_errors.py
    python studies/recommendation_errors.py --draws 50
"""

import argparse
import tempfile
import warnings
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import norm

from torch_geometric_tactile.experiments import (
    ComparisonSettings,
    Plan,
    PlanRun,
    Predictions,
    comparison_plan,
    data_source,
    recommended,
    summarize,
)
from torch_geometric_tactile.experiments._held_out import choice_cuts

TRIALS = 160
ACCURACY, SPLIT_DEVIATION, CORRELATION = 0.85, 0.02, 0.5
MODELS = {"taxel_net": (48_611, 0.35e-3), "svm_linear": (39, 0.014e-3)}  # weights, seconds
ONE_POINT = 0.01
GIVEN = ((None, True), (None, False))  # with validation scores, and without


def plan_of(folder: Path, folds: int | None) -> Plan:
    """A comparison of both models on trials of two classes, in folds or in given parts."""
    trial = np.arange(TRIALS)
    part = np.where(trial % 3 == 0, 2, 0)
    np.savez(folder / "made.npz", x=np.zeros((TRIALS, 9)), y=trial % 2, trial=trial, part=part)
    settings = ComparisonSettings(
        models=tuple(MODELS), folds=folds or 5, by=None if folds else "given"
    )
    return comparison_plan(data_source(folder / "made.npz", grid="3x3"), settings)


def said_of(part: Any, level: float, common: np.ndarray, draw: np.random.Generator) -> Predictions:
    """Made-up predictions of a model that is right in a part of all trials."""
    index, y = np.asarray(part.indices()), part.data.y.numpy()
    level += SPLIT_DEVIATION * draw.normal()  # of one training
    own = np.sqrt(1 - CORRELATION) * draw.normal(size=len(y))
    is_right = np.sqrt(CORRELATION) * common[index] + own < norm.ppf(np.clip(level, 0, 1))
    prediction = np.where(is_right, y, 1 - y)
    return Predictions(prediction, prediction, y, trial=index, index=index)


def accuracy_of(said: Predictions) -> float:
    """The part of right answers."""
    return float((said.prediction == said.y).mean())


def validation_of(said: list[Predictions], overlap: float) -> dict[str, Any]:
    """What a run keeps of its validation parts."""
    score = float(np.mean([accuracy_of(one) for one in said]))
    return {"score": score, "overlap": overlap, "predictions": [one.to_dict() for one in said]}


def run_of(plan: Plan, gain: float, draw: np.random.Generator, validated: bool = True) -> PlanRun:
    """Made-up predictions, where the larger model is better by a gain."""
    results: list[tuple[Any, dict[str, Any]]] = []
    common = draw.normal(size=TRIALS)  # trials are easy or hard for both
    for experiment in plan.experiments:
        train, test, cuts = choice_cuts(experiment, experiment.choice.num_validation_cuts)
        weights, seconds = MODELS[experiment.name]
        sign = 0.5 if experiment.name == "taxel_net" else -0.5
        level = ACCURACY + sign * gain
        predictions = said_of(test, level, common, draw)
        accuracy = accuracy_of(predictions)
        content = {
            "metrics": {"accuracy": accuracy, "balanced_accuracy": accuracy, "f1": accuracy},
            "predictions": predictions.to_dict(),
            "num_parameters": weights,
            "choose_seconds": 0.0,
            "train_seconds": 1.0,
            "predict_seconds": seconds * len(test),
            "num_train": len(train),
            "num_test": len(test),
            "chosen": {"setting": {}, "number": 0, "validation": []},
        }
        if cuts and validated:
            said = [said_of(val, level, common, draw) for _, val in cuts]
            content["validation"] = validation_of(said, len(cuts[0][1]) / len(cuts[0][0]))
        results.append((experiment, content))
    return PlanRun(plan, results, 0, {}, 0)


def gain_of(run: PlanRun) -> float:
    """How much better the larger model was in a run."""
    by_model: dict[str, list[float]] = {name: [] for name in MODELS}
    for experiment, result in run.results:
        by_model[experiment.name].append(result["metrics"]["accuracy"])
    large, small = (float(np.mean(scores)) for scores in by_model.values())
    return large - small


def main() -> None:
    """Prints the table."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n\n")[0])
    parser.add_argument("--draws", type=int, default=200, help="draws of each cell (default: 200)")
    arguments = parser.parse_args()
    warnings.simplefilter("ignore")
    print("| splits | standard error (points) | larger model better by | worse by > 1 point |")
    print("|---|---|---|---|")
    with tempfile.TemporaryDirectory() as folder:
        for folds, validated in ((2, False), (3, False), (5, False), (10, False), *GIVEN):
            plan = plan_of(Path(folder), folds)
            draw = np.random.default_rng(0)
            runs = (run_of(plan, 0.0, draw, validated) for _ in range(200))
            error = float(np.std([gain_of(run) for run in runs], ddof=1))
            for multiple in (0, 1, 3, -1, -3):
                gain, wrong = multiple * error, 0
                draw = np.random.default_rng(1)
                for _ in range(arguments.draws):
                    result = recommended(summarize(run_of(plan, gain, draw, validated)))
                    if result is not None:
                        loss = gain if result.model.name == "svm_linear" else -gain
                        wrong += loss > ONE_POINT
                share = 100 * wrong / arguments.draws
                name = (
                    f"1, given{'' if validated else ', by test'}" if folds is None else str(folds)
                )
                print(f"| {name} | {100 * error:.1f} | {multiple} errors | {share:.1f} % |")


if __name__ == "__main__":
    main()
