r"""One experiment: a model is fitted, its settings chosen or given, and judged once."""

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


class _Tried:
    # A setting in the race: what it said of each validation part, its scores, the higher the
    # better, and the losses that decide between equals.
    def __init__(self, experiment: Experiment) -> None:
        self.experiment = experiment
        self.said: list[Predictions] = []
        self.values: list[float] = []
        self.losses: list[float] = []
        self.failed = False

    @property
    def value(self) -> float:
        return -math.inf if self.failed or not self.values else float(np.mean(self.values))

    @property
    def loss(self) -> float:
        return float(np.mean(self.losses)) if self.losses else math.inf

    def judge(self, choice: Choice, part: SampleSet, val: SampleSet) -> None:
        # A setting with which a training fails, such as a learning rate that makes it diverge, is
        # not chosen.
        try:
            fitted = fit(self.experiment, part, val)
        except ValueError:
            self.failed = True
            return
        self.said.append(_judge(self.experiment, fitted, val))
        value = prediction_scores(fitted.y, fitted.prediction, choice.of_numbers)[choice.metric]
        self.values.append(-value if choice.metric == "mae" else value)
        self.losses.append(fitted.loss)


def run_experiment(experiment: Experiment) -> dict[str, Any]:
    r"""Trains a model and tests it once, at the end; nothing is chosen by the test part.

    With :obj:`experiment.choice`, its settings are tried on validation parts, and the one that is
    chosen is trained on the whole training part.

    Peak memory is the growth from before the model is built, with the recordings loaded and the
    scaling fitted, to the highest point of training: parameters, gradients, the optimizer's state,
    activations and one batch.
    """
    start = time.perf_counter()
    if experiment.accelerator == "gpu" and not torch.cuda.is_available():
        raise ArgumentError(
            Argument("accelerator"), " must be 'cpu': torch finds no GPU here (got 'gpu')"
        )
    threads = torch.get_num_threads()
    torch.set_num_threads(experiment.threads)
    try:
        result = _run(experiment)
    finally:
        torch.set_num_threads(threads)
    return {
        **result,
        "seconds": time.perf_counter() - start,
        "machine": _machine(experiment.accelerator, experiment.threads),
    }


def _run(experiment: Experiment) -> dict[str, Any]:
    choice = experiment.choice
    if choice is not None and experiment.studies:
        raise ValueError("'studies' must be empty for an experiment with a choice")
    val = None
    chosen: dict[str, Any] = {}
    if choice is not None:
        train, test, cuts = choice_cuts(experiment, choice.repeats, choice.most_samples)
        experiment, chosen = _choose(experiment, choice, cuts)
        if choice.num_validation_cuts:
            chosen |= _validate(experiment, choice, chosen["choose_seconds"])
    elif experiment.threshold is not None:
        train, val, _, test = choice_parts(experiment)
    else:
        train, test = experiment.data.parts(experiment.protocol, experiment.seed, experiment.fold)
    studies = _build_studies(experiment)
    fitted = fit(experiment, train, test, val, studies)
    predicted = _judge(experiment, fitted, test)
    return {
        "metrics": _metrics(experiment, fitted, predicted),
        **({} if fitted.threshold is None else {"threshold": fitted.threshold}),
        **({"studies": _measure(studies, fitted.trained)} if studies else {}),
        "label_names": fitted.label_names,
        "frames_per_second": len(train) * max(1, experiment.epochs) / fitted.seconds,
        "peak_memory_mb": fitted.peak_memory_mb,
        "measures": fitted.measures,
        "num_parameters": fitted.num_parameters,
        "is_graph": fitted.is_graph,
        "train_seconds": fitted.seconds,
        "predict_seconds": fitted.predict_seconds,
        **chosen,
        "predictions": predicted.to_dict(),
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
    r"""Trains a model on one part and returns what it says of another. A threshold is chosen on
    :obj:`val`.
    """
    if experiment.is_estimator:
        return fit_estimator(experiment, train, test, val)
    return fit_network(experiment, train, test, val, studies)


def _choose(
    experiment: Experiment,
    choice: Choice,
    cuts: Sequence[tuple[SampleSet, SampleSet]],
) -> tuple[Experiment, dict[str, Any]]:
    # The experiment with the setting that is chosen, and what is told of the choice.
    start = time.perf_counter()
    draft = replace(experiment, choice=replace(choice, members=1)).with_setting(choice.draft)
    tried = [_Tried(draft.with_setting(setting)) for setting in choice.settings]
    racing = tried if len(tried) > 1 else []
    for part, val in cuts:
        for setting in racing:
            setting.judge(choice, part, val)
        racing = [s for s in racing if s is tried[0] or s.value > tried[0].value]
    overlap = len(cuts[0][1]) / len(cuts[0][0])
    full = [i for i in range(1, len(tried)) if len(tried[i].said) == len(cuts)]
    best = 0
    for i in sorted(full, key=lambda i: (-tried[i].value, tried[i].loss)):
        if _is_better(tried[i], tried[0], choice.metric, overlap):
            best = i
            break
    values = [setting.value for setting in tried] if len(tried) > 1 else []
    chosen = {
        "setting": dict(choice.settings[best]),
        "number": best,
        "validation": [value if math.isfinite(value) else None for value in values],
    }
    seconds = time.perf_counter() - start
    chosen_one = experiment.with_setting(choice.settings[best])
    return chosen_one, {"choose_seconds": seconds, "chosen": chosen}


def _validate(experiment: Experiment, choice: Choice, choose_seconds: float) -> dict[str, Any]:
    # The scores of the chosen setting on validation parts, trained as it is for the test.
    start = time.perf_counter()
    cuts = choice_cuts(experiment, choice.num_validation_cuts)[2]
    try:
        predictions = [_judge(experiment, fit(experiment, part, val), val) for part, val in cuts]
    except ValueError:  # as of a network that diverges
        predictions = []
    scores = [
        prediction_scores(p.y, p.prediction, choice.of_numbers)[choice.metric] for p in predictions
    ]
    return {
        "choose_seconds": choose_seconds + time.perf_counter() - start,
        "validation": {
            "score": float(np.mean(scores)) if scores else None,
            "overlap": len(cuts[0][1]) / len(cuts[0][0]),
            "predictions": [p.to_dict() for p in predictions],
        },
    }


def _is_better(setting: _Tried, default: _Tried, metric: str, overlap: float) -> bool:
    if default.failed or not default.said:
        return setting.value > default.value
    difference = paired_difference(setting.said, default.said, metric, overlap)
    gain = setting.value - default.value
    return gain > 0 and not gain <= difference.error


def _build_studies(experiment: Experiment) -> list[Study]:
    studies = [build_object(content) for content in experiment.studies]
    for content, study in zip(experiment.studies, studies, strict=True):
        if not isinstance(study, Study):
            raise ValueError(f"'studies' must hold studies (got '{content.get('class_path')}')")
    return studies


def _measure(studies: Sequence[Study], trained: Trained | None) -> dict[str, Any]:
    # What each study finds, by the name of its class.
    assert trained is not None
    found = {type(study).__name__: study.measure(trained) for study in studies}
    return {name: result for name, result in found.items() if result is not None}


def _judge(experiment: Experiment, fitted: Fitted, test: SampleSet) -> Predictions:
    y = column_of(test, "y")  # of `data`, all windows would be cut for them
    assert y is not None
    return Predictions(
        score=fitted.score,
        prediction=fitted.prediction,
        y=y,
        session=column_of(test, "session") if experiment.choice is None else None,
        trial=column_of(test, "trial"),
        index=np.asarray(test.indices()),
    )


def _metrics(
    experiment: Experiment, fitted: Fitted, predicted: Predictions
) -> dict[str, float | None]:
    if experiment.choice is not None:
        of_numbers = experiment.choice.of_numbers
        metrics = prediction_scores(predicted.y, predicted.prediction, of_numbers)
    elif experiment.is_estimator:
        metrics = predicted.metrics()
    else:
        score, y = torch.from_numpy(predicted.score), torch.from_numpy(predicted.y)
        metrics = classification_metrics(score, y, fitted.task, fitted.threshold)
    return {name: value if math.isfinite(value) else None for name, value in metrics.items()}


@cache
def _machine(accelerator: str, threads: int) -> str:
    # This machine in a few words.
    name = platform.processor() or platform.machine()
    cpuinfo = Path("/proc/cpuinfo")
    if cpuinfo.is_file():
        lines = cpuinfo.read_text("utf-8", "replace").splitlines()
        models = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
        name = models[0] if models else name
    text = f"{name}, {os.cpu_count()} cores, {threads} thread{'s' if threads > 1 else ''} a run"
    return f"{torch.cuda.get_device_name()}; {text}" if accelerator == "gpu" else text
