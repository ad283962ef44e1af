r"""Training and testing one experiment."""

import copy
import logging
import math
import os
import platform
import time
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any

import lightning as L
import numpy as np
import torch
from sklearn.utils import get_tags
from torch import Tensor
from torch.utils.data import DataLoader

from torch_geometric_tactile.data import StaticData, StaticDataset
from torch_geometric_tactile.experiments.building import build
from torch_geometric_tactile.experiments.experiment import Experiment
from torch_geometric_tactile.experiments.judgement import Judgement
from torch_geometric_tactile.experiments.memory import PeakMemory
from torch_geometric_tactile.training.checkpoint import AtomicCheckpointIO
from torch_geometric_tactile.training.data_module import TactileDataModule
from torch_geometric_tactile.training.metrics import classification_metrics
from torch_geometric_tactile.training.module import TactileClassifier, classifier_from_config
from torch_geometric_tactile.training.predictions import collect_predictions
from torch_geometric_tactile.transforms import fit_transform
from torch_geometric_tactile.typing import PathLike

_NO_EDGES = torch.zeros(2, 0, dtype=torch.long)


def run_experiment(experiment: Experiment, checkpoint: PathLike | None = None) -> dict[str, Any]:
    r"""Trains for the given number of epochs and tests once, at the end; nothing is chosen by the
    test part.

    Peak memory is the growth from before the model is built, with the recordings loaded and the
    scaling fitted, to the highest point of training: parameters, gradients, the optimizer's state,
    activations and one batch.

    Args:
        experiment (Experiment): What to do.
        checkpoint (str or PathLike, optional): Where to save the trained classifier.

    Returns:
        dict: JSON values: :obj:`metrics` (of :func:`classification_metrics`; of a scikit-learn
        model those of :class:`Judgement`), :obj:`predictions` (of :meth:`Judgement.to_dict`),
        :obj:`label_names`, :obj:`num_train` and :obj:`num_test` (samples),
        :obj:`frames_per_second` of training, :obj:`peak_memory_mb` and what it :obj:`measures`,
        :obj:`num_parameters`, :obj:`train_seconds` and :obj:`seconds` in all, and :obj:`machine`.
        What was not measured is :obj:`None`.

    Raises:
        ValueError: If the experiment cannot be run, or a scikit-learn model is to be saved.
    """
    start = time.perf_counter()
    if experiment.accelerator == "gpu" and not torch.cuda.is_available():
        raise ValueError("'accelerator' must be 'cpu': torch finds no GPU here (got 'gpu')")
    threads = torch.get_num_threads()
    torch.set_num_threads(experiment.threads)
    try:
        train, test = experiment.data.parts(experiment.protocol, experiment.seed, experiment.fold)
        if not experiment.is_estimator:
            result = _run_classifier(experiment, train, test, checkpoint)
        elif checkpoint is None:
            result = _run_estimator(experiment, train, test)
        else:
            raise ValueError(f"'checkpoint' must be None for scikit-learn (got '{checkpoint}')")
    finally:
        torch.set_num_threads(threads)
    return {
        **result,
        "num_train": len(train),
        "num_test": len(test),
        "seconds": time.perf_counter() - start,
        "machine": machine(experiment.accelerator, experiment.threads),
    }


def _run_classifier(
    experiment: Experiment,
    train: StaticDataset,
    test: StaticDataset,
    checkpoint: PathLike | None,
) -> dict[str, Any]:
    data = TactileDataModule(
        train,
        test,
        split="frame",
        val=0.0,
        transform=build(experiment.transform),
        batch_size=experiment.batch_size,
    )
    data.setup()
    _warm_up(experiment.accelerator)
    memory = PeakMemory("cuda" if experiment.accelerator == "gpu" else "cpu")
    if experiment.measure_memory:
        memory.start()
    clock = _Clock()
    settings = {"accelerator": experiment.accelerator, **experiment.trainer}
    classifier = fit_classifier(
        experiment.model, data, experiment.seed, settings, experiment.epochs, clock
    )
    peak = memory.stop() if experiment.measure_memory else math.nan
    if checkpoint is not None:
        classifier.trainer.save_checkpoint(Path(checkpoint), weights_only=False)
    device = classifier.trainer.strategy.root_device
    said = collect_predictions(classifier, data.test_dataloader(), device)
    session = test.column("session")
    multilabel = classifier.task == "multilabel"
    judgement = Judgement(
        score=said.probability.numpy(),
        prediction=_predicted(said.probability, multilabel).numpy(),
        y=said.y.numpy(),
        session=None if session is None else session.numpy(),
    )
    return {
        "metrics": _finite(classification_metrics(said.probability, said.y, classifier.task)),
        "label_names": data.class_names if multilabel else None,
        "frames_per_second": len(train) * experiment.epochs / clock.seconds,
        "peak_memory_mb": peak if math.isfinite(peak) else None,
        "measures": memory.measure if experiment.measure_memory else None,
        "num_parameters": sum(p.numel() for p in classifier.model.parameters()),
        "train_seconds": clock.seconds,
        "predictions": judgement.to_dict(),
    }


def fit_classifier(
    model: dict[str, Any],
    data: TactileDataModule,
    seed: int,
    settings: dict[str, Any],
    epochs: int,
    *callbacks: L.Callback,
) -> TactileClassifier:
    r"""Trains the classifier of a configuration; nothing is shown, logged or kept.

    Args:
        model (dict): The :obj:`model` section of the configuration; sizes that it leaves out are
            those of the data.
        data (TactileDataModule): The samples.
        seed (int): Seed of weights and batches.
        settings (dict): Arguments of :class:`lightning.Trainer`, at least :obj:`accelerator`.
        epochs (int): Number of epochs.
        *callbacks (lightning.Callback): Called while it trains.
    """
    L.seed_everything(seed, verbose=False)
    # jsonargparse writes into the configuration.
    classifier = classifier_from_config(copy.deepcopy(model), data)
    with _quiet():
        trainer = _trainer(settings, max_epochs=epochs, callbacks=list(callbacks))
        try:
            trainer.fit(classifier, datamodule=data)
        except SystemExit as stop:  # Lightning's answer to Ctrl-C
            raise KeyboardInterrupt from stop
    return classifier


def _predicted(probability: Tensor, multilabel: bool) -> Tensor:
    return (probability > 0.5).long() if multilabel else probability.argmax(dim=-1)


def _run_estimator(
    experiment: Experiment, train: StaticDataset, test: StaticDataset
) -> dict[str, Any]:
    transform = build(experiment.transform)
    seen, held_out = fit_transform(transform, train), fit_transform(transform, test, adapt=True)
    estimator = build(experiment.model)
    if estimator.get_params().get("random_state", 0) is None:
        estimator.set_params(random_state=experiment.seed)
    x, x_test = (_input(estimator, part.x.numpy()) for part in (seen, held_out))
    start = time.perf_counter()
    estimator.fit(x, seen.y.numpy())
    seconds = time.perf_counter() - start
    judgement = Judgement(
        score=_scores(estimator, x_test, train.num_classes),
        prediction=estimator.predict(x_test),
        y=held_out.y.numpy(),
        session=held_out.session.numpy() if "session" in held_out else None,
    )
    return {
        "metrics": _finite(judgement.metrics()),
        "label_names": None,
        "frames_per_second": len(train) / seconds,
        "peak_memory_mb": None,
        "measures": None,
        "num_parameters": None,
        "train_seconds": seconds,
        "predictions": judgement.to_dict(),
    }


def _input(estimator: Any, x: np.ndarray) -> np.ndarray:
    # Estimators take rows of numbers, but for those whose tags tell that they know taxels.
    return x if get_tags(estimator).input_tags.three_d_array else x.reshape(len(x), -1)


def _scores(estimator: Any, x: np.ndarray, num_classes: int) -> np.ndarray:
    method = "decision_function" if hasattr(estimator, "decision_function") else "predict_proba"
    scores: np.ndarray = getattr(estimator, method)(x)
    if scores.ndim == 1 or scores.shape[1] == num_classes:
        return scores
    # The training part lacks classes.
    complete = np.full((len(scores), num_classes), scores.min())
    complete[:, estimator.classes_] = scores
    return complete


def _trainer(settings: dict[str, Any], **arguments: Any) -> L.Trainer:
    arguments = {**settings, **arguments, "devices": 1, "plugins": [AtomicCheckpointIO()]}
    if set(settings) == {"accelerator"}:  # logging would take a tenth of the time of small models
        return L.Trainer(barebones=True, **arguments)
    off = ("logger", "enable_checkpointing", "enable_progress_bar", "enable_model_summary")
    return L.Trainer(**{**arguments, **dict.fromkeys(off, False)})


@cache
def _warm_up(accelerator: str) -> None:
    # What is loaded at a process's first training is not to count as memory or time of a model.
    batch = StaticData(x=torch.zeros(2, 1, 2), y=torch.tensor([0, 1]), edge_index=_NO_EDGES)
    classifier = TactileClassifier(_Linear())
    with _quiet():
        trainer = _trainer({"accelerator": accelerator}, max_epochs=1)
        batches: Any = [batch]
        trainer.fit(classifier, DataLoader(batches, batch_size=None))


class _Linear(torch.nn.Module):
    def __init__(self) -> None:
        super().__init__()
        self.lin = torch.nn.Linear(2, 2)

    def forward(self, x: Tensor, edge_index: Tensor) -> Tensor:
        logits: Tensor = self.lin(x).mean(dim=1)
        return logits


class _Clock(L.Callback):
    seconds = math.nan

    def on_train_start(self, trainer: L.Trainer, pl_module: L.LightningModule) -> None:
        self._start = time.perf_counter()

    def on_train_end(self, trainer: L.Trainer, pl_module: L.LightningModule) -> None:
        if trainer.strategy.root_device.type == "cuda":
            torch.cuda.synchronize()
        self.seconds = time.perf_counter() - self._start


@contextmanager
def _quiet() -> Iterator[None]:
    # Lightning explains itself at every start: hundreds of trainings would drown in it.
    logger = logging.getLogger("lightning.pytorch")
    level = logger.level
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        logger.setLevel(logging.ERROR)
        try:
            yield
        finally:
            logger.setLevel(level)


def _finite(metrics: dict[str, float]) -> dict[str, float | None]:
    return {name: value if math.isfinite(value) else None for name, value in metrics.items()}


@cache
def machine(accelerator: str, threads: int) -> str:
    r"""Describes this machine in a few words.

    Args:
        accelerator (str): :obj:`"cpu"` or :obj:`"gpu"`.
        threads (int): Threads of torch.
    """
    name = platform.processor() or platform.machine()
    cpuinfo = Path("/proc/cpuinfo")
    if cpuinfo.is_file():
        lines = cpuinfo.read_text("utf-8", "replace").splitlines()
        models = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
        name = models[0] if models else name
    text = f"{name}, {os.cpu_count()} cores, {threads} thread{'s' if threads > 1 else ''} a run"
    return f"{torch.cuda.get_device_name()}; {text}" if accelerator == "gpu" else text
