r"""Training and testing one experiment."""

import math
import os
import platform
import time
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile.data import StaticDataset
from torch_geometric_tactile.experiments._building import build
from torch_geometric_tactile.experiments._choosing import run_choosing
from torch_geometric_tactile.experiments._estimators import (
    class_scores,
    estimator_input,
    fitted_samples,
    positive_score,
    seeded_estimator,
)
from torch_geometric_tactile.experiments._experiment import Experiment
from torch_geometric_tactile.experiments._fitting import Clock, fit_classifier, warm_up
from torch_geometric_tactile.experiments._held_out import choice_parts, column_of
from torch_geometric_tactile.experiments._memory import PeakMemory
from torch_geometric_tactile.experiments._run_studies import build_studies, run_studies
from torch_geometric_tactile.experiments.judgement import Judgement
from torch_geometric_tactile.experiments.studies import Study, Trained
from torch_geometric_tactile.training._collected_metrics import predicted_classes
from torch_geometric_tactile.training._predictions import collect_predictions
from torch_geometric_tactile.training._threshold import choose_threshold
from torch_geometric_tactile.training.data_module import TactileDataModule
from torch_geometric_tactile.training.metrics import classification_metrics


def run_experiment(experiment: Experiment, checkpoint: PathLike | None = None) -> dict[str, Any]:
    r"""Trains for the given number of epochs and tests once, at the end; nothing is chosen by the
    test part.

    Peak memory is the growth from before the model is built, with the recordings loaded and the
    scaling fitted, to the highest point of training: parameters, gradients, the optimizer's state,
    activations and one batch.
    """
    start = time.perf_counter()
    if experiment.accelerator == "gpu" and not torch.cuda.is_available():
        raise ValueError("'accelerator' must be 'cpu': torch finds no GPU here (got 'gpu')")
    threads = torch.get_num_threads()
    torch.set_num_threads(experiment.threads)
    try:
        result = _run(experiment, checkpoint)
    finally:
        torch.set_num_threads(threads)
    return {
        **result,
        "seconds": time.perf_counter() - start,
        "machine": machine(experiment.accelerator, experiment.threads),
    }


def _run(experiment: Experiment, checkpoint: PathLike | None) -> dict[str, Any]:
    kind = "scikit-learn" if experiment.is_estimator else "an experiment with a choice"
    if checkpoint is not None and (experiment.is_estimator or experiment.choice is not None):
        raise ValueError(f"'checkpoint' must be None for {kind} (got '{checkpoint}')")
    if experiment.choice is not None:
        if experiment.studies:
            raise ValueError("'studies' must be empty for an experiment with a choice")
        return run_choosing(experiment)
    if experiment.threshold is not None:
        parts = choice_parts(experiment)
        train, val, test = parts.fit, parts.val, parts.test
    else:
        train, test = experiment.data.parts(experiment.protocol, experiment.seed, experiment.fold)
        val = test[:0]
    sizes = {"num_train": len(train), "num_test": len(test)}
    if experiment.is_estimator:
        return {**_run_estimator(experiment, train, val, test), **sizes}
    return {**_run_classifier(experiment, train, val, test, checkpoint), **sizes}


def _run_classifier(
    experiment: Experiment,
    train: StaticDataset,
    val: StaticDataset,
    test: StaticDataset,
    checkpoint: PathLike | None,
) -> dict[str, Any]:
    data = TactileDataModule(
        train,
        test,
        split="frame",
        val_dataset=val,
        transform=build(experiment.transform),
        batch_size=experiment.batch_size,
    )
    data.setup()
    warm_up(experiment.accelerator)
    memory = PeakMemory("cuda" if experiment.accelerator == "gpu" else "cpu")
    if experiment.measure_memory:
        memory.start()
    clock = Clock()
    settings = {"accelerator": experiment.accelerator, "limit_val_batches": 0}
    settings |= experiment.trainer
    studies = build_studies(experiment.studies)
    watching = [found for study in studies if (found := study.callback(data)) is not None]
    classifier = fit_classifier(
        experiment.model, data, experiment.seed, settings, experiment.epochs, clock, *watching
    )
    peak = memory.stop() if experiment.measure_memory else math.nan
    device = classifier.trainer.strategy.root_device
    if experiment.threshold is not None:
        seen = collect_predictions(classifier, data.val_dataloader(), device)
        classifier.decision_threshold = choose_threshold(
            seen.probability[:, 1].numpy(), seen.y.numpy(), experiment.threshold
        )
    threshold = classifier.decision_threshold
    if checkpoint is not None:
        classifier.trainer.save_checkpoint(Path(checkpoint), weights_only=False)
    said = collect_predictions(classifier, data.test_dataloader(), device)
    session = test.column("session")
    multilabel = classifier.task == "multilabel"
    judgement = Judgement(
        score=said.probability.numpy(),
        prediction=_predicted(said.probability, multilabel, threshold).numpy(),
        y=said.y.numpy(),
        session=None if session is None else session.numpy(),
        trial=column_of(test, "trial"),
        index=np.asarray(test.indices()),
    )
    metrics = classification_metrics(said.probability, said.y, classifier.task, threshold)
    return {
        "metrics": _finite(metrics),
        **({} if threshold is None else {"threshold": threshold}),
        **_network_studies(experiment, studies, classifier.model.eval().cpu(), data),
        "label_names": data.class_names if multilabel else None,
        "frames_per_second": len(train) * experiment.epochs / clock.seconds,
        "peak_memory_mb": peak if math.isfinite(peak) else None,
        "measures": memory.measure if experiment.measure_memory else None,
        "num_parameters": sum(p.numel() for p in classifier.model.parameters()),
        "train_seconds": clock.seconds,
        "predictions": judgement.to_dict(),
    }


def _network_studies(
    experiment: Experiment, studies: list[Study], model: nn.Module, data: TactileDataModule
) -> dict[str, Any]:
    if not studies:
        return {}
    train, test = (data.part("train"), data.part("test"))
    trained = Trained(
        model,
        data.peek(train, len(train)),
        data.peek(test, len(test)),
        data.class_names,
        data.layout,
        experiment.seed,
    )
    return {"studies": run_studies(studies, trained)}


def _predicted(probability: Tensor, multilabel: bool, threshold: float | None) -> Tensor:
    if multilabel:
        return (probability > 0.5).long()
    return predicted_classes(probability, threshold)


def _run_estimator(
    experiment: Experiment, train: StaticDataset, val: StaticDataset, test: StaticDataset
) -> dict[str, Any]:
    transform = build(experiment.transform)
    seen = fitted_samples(transform, train)
    held_out = fitted_samples(transform, test, adapt=True)
    estimator = seeded_estimator(experiment.model, train.layout, experiment.seed)
    x, x_test = (estimator_input(estimator, part) for part in (seen, held_out))
    start = time.perf_counter()
    estimator.fit(x, seen.y.numpy())
    seconds = time.perf_counter() - start
    score = class_scores(estimator, x_test, train.num_classes)
    prediction, threshold = estimator.predict(x_test), None
    if experiment.threshold is not None:
        other = fitted_samples(transform, val, adapt=True)
        seen_score = class_scores(estimator, estimator_input(estimator, other), train.num_classes)
        threshold = choose_threshold(
            positive_score(seen_score),
            other.y.numpy(),
            experiment.threshold,
            default=0.0 if score.ndim == 1 else 0.5,
        )
        prediction = (positive_score(score) > threshold).astype(np.int64)
    judgement = Judgement(
        score=score,
        prediction=prediction,
        y=held_out.y.numpy(),
        session=held_out.session.numpy() if "session" in held_out else None,
        trial=column_of(test, "trial"),
        index=np.asarray(test.indices()),
    )
    found = {}
    if experiment.studies:
        names = train.class_names
        trained = Trained(estimator, seen, held_out, names, train.layout, experiment.seed)
        found = {"studies": run_studies(build_studies(experiment.studies), trained)}
    return {
        "metrics": _finite(judgement.metrics()),
        **({} if threshold is None else {"threshold": threshold}),
        **found,
        "label_names": None,
        "frames_per_second": len(train) / seconds,
        "peak_memory_mb": None,
        "measures": None,
        "num_parameters": None,
        "train_seconds": seconds,
        "predictions": judgement.to_dict(),
    }


def _finite(metrics: dict[str, float]) -> dict[str, float | None]:
    return {name: value if math.isfinite(value) else None for name, value in metrics.items()}


@cache
def machine(accelerator: str, threads: int) -> str:
    r"""Describes this machine in a few words."""
    name = platform.processor() or platform.machine()
    cpuinfo = Path("/proc/cpuinfo")
    if cpuinfo.is_file():
        lines = cpuinfo.read_text("utf-8", "replace").splitlines()
        models = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
        name = models[0] if models else name
    text = f"{name}, {os.cpu_count()} cores, {threads} thread{'s' if threads > 1 else ''} a run"
    return f"{torch.cuda.get_device_name()}; {text}" if accelerator == "gpu" else text
