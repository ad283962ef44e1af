r"""One experiment of a table: a model trained once and tested once."""

import copy
import hashlib
import json
import math
import os
import platform
import time
from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import Path
from typing import Any

import lightning as L
import torch
import torch_geometric
from lightning.pytorch.cli import instantiate_module
from torch import Tensor
from torch.utils.data import DataLoader

from torch_geometric_tactile import __version__
from torch_geometric_tactile.data import StaticData
from torch_geometric_tactile.experiments.evaluation import quiet
from torch_geometric_tactile.experiments.memory import PeakMemory
from torch_geometric_tactile.training.config import merged
from torch_geometric_tactile.training.data_module import TactileDataModule
from torch_geometric_tactile.training.metrics import classification_metrics
from torch_geometric_tactile.training.module import TactileClassifier, classifier_from_config

_NO_EDGES = torch.zeros(2, 0, dtype=torch.long)


@dataclass(frozen=True, eq=False)
class Experiment:
    r"""What is trained and tested.

    Args:
        name (str): Its name.
        config (dict): Its configuration; the settings below stand above it.
        root (str, optional): Folder of the recordings.
        data (str): Fingerprint of the recordings.
        seed (int): Seed of the split and of the training.
        split_by (str): :obj:`"trial"` or :obj:`"frame"`.
        epochs (int): Number of epochs.
        stride (int): Only every :obj:`stride`-th frame of each trial.
        phases (tuple of str, optional): Only frames in these phases.
        accelerator (str): :obj:`"cpu"` or :obj:`"gpu"`.
        threads (int): Threads of torch.
    """

    name: str
    config: dict[str, Any]
    root: str | None
    data: str
    seed: int
    split_by: str
    epochs: int
    stride: int = 1
    phases: tuple[str, ...] | None = None
    accelerator: str = "cpu"
    threads: int = 1

    def identity(self) -> dict[str, Any]:
        r"""Returns all that the result follows from. Two experiments of one configuration are one,
        whatever their names; threads and the place of the recordings do not count.
        """
        config = json.dumps(self.config, sort_keys=True)
        return {
            "config": hashlib.sha256(config.encode()).hexdigest(),
            "data": self.data,
            "seed": self.seed,
            "split_by": self.split_by,
            "epochs": self.epochs,
            "stride": self.stride,
            "phases": None if self.phases is None else list(self.phases),
            "accelerator": self.accelerator,
            "versions": versions(),
        }

    @cached_property
    def code(self) -> str:
        r"""A short code of the identity."""
        content = json.dumps(self.identity(), sort_keys=True)
        return hashlib.sha256(content.encode()).hexdigest()[:12]

    @property
    def label(self) -> str:
        r"""What a user reads: name, split and seed."""
        return f"{self.name}, by {self.split_by}, seed {self.seed}"

    @property
    def file_name(self) -> str:
        r"""The name of the file of its result."""
        return f"{self.name}_{self.split_by}_seed{self.seed}_{self.code}.json"

    def full_config(self) -> dict[str, Any]:
        r"""Returns the configuration with the settings in it, without what only validation needs:
        nothing is chosen.
        """
        settings = {
            "root": self.root,
            "split_by": self.split_by,
            "split_seed": self.seed,
            "stride": self.stride,
            "phases": None if self.phases is None else list(self.phases),
        }
        datasets = {key: {"init_args": settings} for key in ("dataset", "test_dataset")}
        trainer = {"max_epochs": self.epochs, "accelerator": self.accelerator}
        over = {"seed_everything": self.seed, "data": datasets, "trainer": trainer}
        config = copy.deepcopy(merged(self.config, over))  # jsonargparse writes into its own
        config["data"] = {**config["data"], "val_dataset": None, "val": 0.0}
        return config


def versions() -> dict[str, str]:
    r"""Returns the versions that results depend on."""
    return {
        "torch-geometric-tactile": __version__,
        "torch": torch.__version__,
        "torch-geometric": torch_geometric.__version__,
    }


def run_experiment(experiment: Experiment) -> dict[str, Any]:
    r"""Trains for the given number of epochs and tests once, at the end; nothing is chosen by the
    test part.

    Peak memory is the growth from before the model is built, with the recordings loaded and the
    scaling fitted, to the highest point of training: parameters, gradients, the optimizer's state,
    activations and one batch.

    Args:
        experiment (Experiment): What to do.

    Returns:
        dict: :obj:`metrics` (of :func:`classification_metrics`), :obj:`label_names`,
        :obj:`num_train` and :obj:`num_test` (frames), :obj:`frames_per_second` of training,
        :obj:`peak_memory_mb` and what it :obj:`measures`, :obj:`num_parameters`,
        :obj:`train_seconds` and :obj:`seconds` in all, and :obj:`machine`.
    """
    start = time.perf_counter()
    if experiment.accelerator == "gpu" and not torch.cuda.is_available():
        raise ValueError("'accelerator' must be 'cpu': torch finds no GPU here (got 'gpu')")
    torch.set_num_threads(experiment.threads)
    config = experiment.full_config()
    data: TactileDataModule = instantiate_module(TactileDataModule, config["data"])
    data.setup()
    _warm_up(experiment.accelerator)
    memory = PeakMemory("cuda" if experiment.accelerator == "gpu" else "cpu")
    memory.start()
    L.seed_everything(experiment.seed, verbose=False)
    classifier = classifier_from_config(config["model"], data)
    clock = _Clock()
    with quiet():
        trainer = _trainer(callbacks=[clock], **config["trainer"])
        trainer.fit(classifier, datamodule=data)
    peak = memory.stop()
    score, y = _test(classifier, data, trainer.strategy.root_device)
    num_train, num_test = len(data.dataset), len(y)
    multilabel = classifier.task == "multilabel"
    return {
        "metrics": _finite(classification_metrics(score, y, classifier.task)),
        "label_names": data.class_names if multilabel else None,
        "num_train": num_train,
        "num_test": num_test,
        "frames_per_second": num_train * experiment.epochs / clock.seconds,
        "peak_memory_mb": peak if math.isfinite(peak) else None,
        "measures": memory.measure,
        "num_parameters": sum(p.numel() for p in classifier.model.parameters()),
        "train_seconds": clock.seconds,
        "seconds": time.perf_counter() - start,
        "machine": machine(experiment.accelerator, experiment.threads),
    }


def _trainer(**arguments: Any) -> L.Trainer:
    return L.Trainer(
        devices=1,
        logger=False,
        enable_checkpointing=False,
        enable_progress_bar=False,
        enable_model_summary=False,
        **arguments,
    )


@cache
def _warm_up(accelerator: str) -> None:
    # What is loaded at a process's first training is not to count as memory or time of a model.
    batch = StaticData(x=torch.zeros(2, 1, 2), y=torch.tensor([0, 1]), edge_index=_NO_EDGES)
    classifier = TactileClassifier(_Linear())
    with quiet():
        trainer = _trainer(max_epochs=1, accelerator=accelerator)
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


def _test(
    classifier: TactileClassifier, data: TactileDataModule, device: torch.device
) -> tuple[Tensor, Tensor]:
    classifier.to(device).eval()
    scores, targets = [], []
    with torch.inference_mode():
        for batch in data.test_dataloader():
            logits = classifier(batch.to(device))
            scores.append(classifier.probability(logits).cpu())
            targets.append(batch.y.cpu())
    return torch.cat(scores), torch.cat(targets)


def _finite(metrics: dict[str, float]) -> dict[str, float | None]:
    return {name: value if math.isfinite(value) else None for name, value in metrics.items()}


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
