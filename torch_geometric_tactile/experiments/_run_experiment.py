r"""Runs one experiment: selects settings, trains the model and tests it once."""

import math
import os
import platform
import time
from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import torch

from torch_geometric_tactile._checks import Argument, ArgumentError
from torch_geometric_tactile.data._graph_samples import SampleSet
from torch_geometric_tactile.experiments._building import build_object
from torch_geometric_tactile.experiments._estimators import fit_estimator
from torch_geometric_tactile.experiments._experiment import Choice, Experiment, Fitted
from torch_geometric_tactile.experiments._held_out import choice_cuts, choice_parts, column_of
from torch_geometric_tactile.experiments._networks import fit_network
from torch_geometric_tactile.experiments._scores import prediction_scores
from torch_geometric_tactile.experiments.differences import paired_difference
from torch_geometric_tactile.experiments.predictions import Predictions
from torch_geometric_tactile.experiments.studies import Study, Trained
from torch_geometric_tactile.training.metrics import classification_metrics


class _Candidate:
    # A setting with its predictions for each validation part, its scores (higher is better), and
    # its losses, which decide between equal scores.
    def __init__(self, experiment: Experiment) -> None:
        self.experiment = experiment
        self.predictions: list[Predictions] = []
        self.scores: list[float] = []
        self.losses: list[float] = []
        self.has_failed = False

    @property
    def score(self) -> float:
        return -math.inf if self.has_failed or not self.scores else float(np.mean(self.scores))

    @property
    def loss(self) -> float:
        return float(np.mean(self.losses)) if self.losses else math.inf

    def evaluate(self, choice: Choice, part: SampleSet, val: SampleSet) -> None:
        # A setting whose training fails is never selected, such as a learning rate that diverges.
        try:
            fitted = fit(self.experiment, part, val)
        except ValueError:
            self.has_failed = True
            return
        self.predictions.append(_predictions_for(self.experiment, fitted, val))
        score = prediction_scores(fitted.y, fitted.prediction, choice.is_regression)[choice.metric]
        self.scores.append(-score if choice.metric == "mae" else score)
        self.losses.append(fitted.loss)


def run_experiment(experiment: Experiment) -> dict[str, Any]:
    r"""Trains a model, tests it once and returns the result as JSON values. The test part never
    influences the selection of settings.

    With :obj:`experiment.choice`, the settings are compared on validation parts, and the selected
    setting is trained on the whole training part.

    Peak memory is the growth from the point before the model is built (with the recordings loaded
    and the scaling fitted) to the highest point of training. It includes parameters, gradients, the
    optimizer's state, activations and one batch.

    Raises:
        ValueError: If the experiment needs a missing GPU, or its training fails.
    """
    start = time.perf_counter()
    if experiment.accelerator == "gpu" and not torch.cuda.is_available():
        raise ArgumentError(
            Argument("accelerator"), " must be 'cpu': torch finds no GPU here (got 'gpu')"
        )
    threads = torch.get_num_threads()
    torch.set_num_threads(experiment.threads)
    try:
        result = _train_and_test(experiment)
    finally:
        torch.set_num_threads(threads)
    return {
        **result,
        "seconds": time.perf_counter() - start,
        "machine": _describe_machine(experiment.accelerator, experiment.threads),
    }


def _train_and_test(experiment: Experiment) -> dict[str, Any]:
    choice = experiment.choice
    if choice is not None and experiment.studies:
        raise ValueError("'studies' must be empty for an experiment with a choice")
    val = None
    selection: dict[str, Any] = {}
    if choice is not None:
        train, test, cuts = choice_cuts(experiment, choice.repeats, choice.most_samples)
        experiment, selection = _select_setting(experiment, choice, cuts)
        if choice.num_validation_cuts:
            selection |= _validate(experiment, choice, selection["choose_seconds"])
    elif experiment.threshold is not None:
        train, val, _, test = choice_parts(experiment)
    else:
        train, test = experiment.data.parts(experiment.protocol, experiment.seed, experiment.fold)
    studies = _build_studies(experiment)
    fitted = fit(experiment, train, test, val, studies)
    predictions = _predictions_for(experiment, fitted, test)
    return {
        "metrics": _compute_metrics(experiment, fitted, predictions),
        **({} if fitted.threshold is None else {"threshold": fitted.threshold}),
        **({"studies": _study_results(studies, fitted.trained)} if studies else {}),
        "label_names": fitted.label_names,
        "frames_per_second": len(train) * max(1, experiment.epochs) / fitted.seconds,
        "peak_memory_mb": fitted.peak_memory_mb,
        "measures": fitted.measures,
        "num_parameters": fitted.num_parameters,
        "is_graph": fitted.is_graph,
        "train_seconds": fitted.seconds,
        "predict_seconds": fitted.predict_seconds,
        **selection,
        "predictions": predictions.to_dict(),
        "num_train": len(train),
        "num_test": len(test),
    }


def fit(
    experiment: Experiment,
    train: SampleSet,
    test: SampleSet,
    val: SampleSet | None = None,
    studies: Sequence[Study] = (),
) -> Fitted:
    r"""Trains a model on one part and predicts another part.

    Args:
        experiment (Experiment): The model and its settings.
        train (StaticDataset): The samples to train on.
        test (StaticDataset): The samples to predict.
        val (StaticDataset, optional): The samples on which a decision threshold is selected.
        studies (sequence of Study): Studies of a network with callbacks for the training.
    """
    if experiment.is_estimator:
        return fit_estimator(experiment, train, test, val)
    return fit_network(experiment, train, test, val, studies)


def _select_setting(
    experiment: Experiment,
    choice: Choice,
    cuts: Sequence[tuple[SampleSet, SampleSet]],
) -> tuple[Experiment, dict[str, Any]]:
    # Returns the experiment with the selected setting, and the entries of the result that describe
    # the selection.
    start = time.perf_counter()
    draft = replace(experiment, choice=replace(choice, members=1)).with_setting(choice.draft)
    candidates = [_Candidate(draft.with_setting(setting)) for setting in choice.settings]
    # Candidates that are behind the default are dropped after each cut, which saves most of the
    # training time.
    remaining = candidates if len(candidates) > 1 else []
    for part, val in cuts:
        for candidate in remaining:
            candidate.evaluate(choice, part, val)
        remaining = [
            candidate
            for candidate in remaining
            if candidate is candidates[0] or candidate.score > candidates[0].score
        ]
    overlap = len(cuts[0][1]) / len(cuts[0][0])
    finalists = [
        i for i in range(1, len(candidates)) if len(candidates[i].predictions) == len(cuts)
    ]
    best = 0
    for i in sorted(finalists, key=lambda i: (-candidates[i].score, candidates[i].loss)):
        if _is_better(candidates[i], candidates[0], choice.metric, overlap):
            best = i
            break
    scores = [candidate.score for candidate in candidates] if len(candidates) > 1 else []
    entry = {
        "setting": dict(choice.settings[best]),
        "number": best,
        "validation": [score if math.isfinite(score) else None for score in scores],
    }
    seconds = time.perf_counter() - start
    selected = experiment.with_setting(choice.settings[best])
    return selected, {"choose_seconds": seconds, "chosen": entry}


def _validate(experiment: Experiment, choice: Choice, choose_seconds: float) -> dict[str, Any]:
    # Trains the selected setting as for the test, scores it on validation parts, and returns the
    # entries of the result.
    start = time.perf_counter()
    cuts = choice_cuts(experiment, choice.num_validation_cuts)[2]
    try:
        predictions = [
            _predictions_for(experiment, fit(experiment, part, val), val) for part, val in cuts
        ]
    except ValueError:  # such as a network that diverges
        predictions = []
    scores = [
        prediction_scores(p.y, p.prediction, choice.is_regression)[choice.metric]
        for p in predictions
    ]
    return {
        "choose_seconds": choose_seconds + time.perf_counter() - start,
        "validation": {
            "score": float(np.mean(scores)) if scores else None,
            "overlap": len(cuts[0][1]) / len(cuts[0][0]),
            "predictions": [p.to_dict() for p in predictions],
        },
    }


def _is_better(candidate: _Candidate, default: _Candidate, metric: str, overlap: float) -> bool:
    if default.has_failed or not default.predictions:
        return candidate.score > default.score
    difference = paired_difference(candidate.predictions, default.predictions, metric, overlap)
    gain = candidate.score - default.score
    return gain > 0 and not gain <= difference.error  # true if the error is NaN, as with one cut


def _build_studies(experiment: Experiment) -> list[Study]:
    studies = [build_object(content) for content in experiment.studies]
    for content, study in zip(experiment.studies, studies, strict=True):
        if not isinstance(study, Study):
            raise ValueError(f"'studies' must hold studies (got '{content.get('class_path')}')")
    return studies


def _study_results(studies: Sequence[Study], trained: Trained | None) -> dict[str, Any]:
    # Returns the result of each study by the name of its class.
    assert trained is not None
    results = {type(study).__name__: study.measure(trained) for study in studies}
    return {name: result for name, result in results.items() if result is not None}


def _predictions_for(experiment: Experiment, fitted: Fitted, test: SampleSet) -> Predictions:
    y = column_of(test, "y")  # not test.data.y, which would cut all windows
    assert y is not None
    return Predictions(
        score=fitted.score,
        prediction=fitted.prediction,
        y=y,
        session=column_of(test, "session") if experiment.choice is None else None,
        trial=column_of(test, "trial"),
        index=np.asarray(test.indices()),
    )


def _compute_metrics(
    experiment: Experiment, fitted: Fitted, predictions: Predictions
) -> dict[str, float | None]:
    if experiment.choice is not None:
        is_regression = experiment.choice.is_regression
        metrics = prediction_scores(predictions.y, predictions.prediction, is_regression)
    elif experiment.is_estimator:
        metrics = predictions.metrics()
    else:
        score, y = torch.from_numpy(predictions.score), torch.from_numpy(predictions.y)
        metrics = classification_metrics(score, y, fitted.task, fitted.threshold)
    return {name: value if math.isfinite(value) else None for name, value in metrics.items()}


@cache
def _describe_machine(accelerator: str, threads: int) -> str:
    # Describes the machine: GPU, processor, number of cores and threads.
    name = platform.processor() or platform.machine()
    cpuinfo = Path("/proc/cpuinfo")
    if cpuinfo.is_file():
        lines = cpuinfo.read_text("utf-8", "replace").splitlines()
        models = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
        name = models[0] if models else name
    text = f"{name}, {os.cpu_count()} cores, {threads} thread{'s' if threads > 1 else ''} per run"
    return f"{torch.cuda.get_device_name()}; {text}" if accelerator == "gpu" else text
