r"""Training a classifier quietly, and how long it takes."""

import copy
import math
import time
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from typing import Any

import lightning as L
import torch
from torch import Tensor
from torch.utils.data import DataLoader

from torch_geometric_tactile.data import StaticData
from torch_geometric_tactile.training.checkpoint import AtomicCheckpointIO
from torch_geometric_tactile.training.data_module import TactileDataModule
from torch_geometric_tactile.training.module import TactileClassifier, classifier_from_config
from torch_geometric_tactile.training.quiet import quiet_lightning

_NO_EDGES = torch.zeros(2, 0, dtype=torch.long)
_PLAIN = {"accelerator", "limit_val_batches"}


def fit_classifier(
    model: dict[str, Any],
    data: TactileDataModule,
    seed: int,
    settings: dict[str, Any],
    epochs: int,
    *callbacks: L.Callback,
) -> TactileClassifier:
    r"""Trains the classifier of a configuration; nothing is shown, logged or kept."""
    L.seed_everything(seed, verbose=False)
    # jsonargparse writes into the configuration.
    classifier = classifier_from_config(copy.deepcopy(model), data)
    with _quiet():
        trainer = _trainer(settings, max_epochs=epochs, callbacks=list(callbacks))
        _fit(trainer, classifier, datamodule=data)
    return classifier


def _fit(trainer: L.Trainer, *arguments: Any, **options: Any) -> None:
    try:
        trainer.fit(*arguments, **options)
    except SystemExit as stop:  # Lightning's answer to Ctrl-C
        raise KeyboardInterrupt from stop


def _trainer(settings: dict[str, Any], **arguments: Any) -> L.Trainer:
    arguments = {**settings, **arguments, "devices": 1, "plugins": [AtomicCheckpointIO()]}
    if set(settings) <= _PLAIN:  # logging would take a tenth of the time of small models
        return L.Trainer(barebones=True, **arguments)
    off = ("logger", "enable_checkpointing", "enable_progress_bar", "enable_model_summary")
    return L.Trainer(**{**arguments, **dict.fromkeys(off, False)})


@cache
def warm_up(accelerator: str) -> None:
    r"""Trains a tiny model once in a process."""
    # What is loaded at a process's first training is not to count as memory or time of a model.
    batch = StaticData(x=torch.zeros(2, 1, 2), y=torch.tensor([0, 1]), edge_index=_NO_EDGES)
    classifier = TactileClassifier(_Linear())
    with _quiet():
        trainer = _trainer({"accelerator": accelerator}, max_epochs=1)
        batches: Any = [batch]
        _fit(trainer, classifier, DataLoader(batches, batch_size=None))


class _Linear(torch.nn.Module):
    def __init__(self) -> None:
        super().__init__()
        self.lin = torch.nn.Linear(2, 2)

    def forward(self, x: Tensor, edge_index: Tensor) -> Tensor:
        logits: Tensor = self.lin(x).mean(dim=1)
        return logits


class Clock(L.Callback):
    r"""Measures the seconds of training."""

    seconds = math.nan

    def on_train_start(self, trainer: L.Trainer, pl_module: L.LightningModule) -> None:
        r"""Begins."""
        self._start = time.perf_counter()

    def on_train_end(self, trainer: L.Trainer, pl_module: L.LightningModule) -> None:
        r"""Ends."""
        if trainer.strategy.root_device.type == "cuda":
            torch.cuda.synchronize()
        self.seconds = time.perf_counter() - self._start


@contextmanager
def _quiet() -> Iterator[None]:
    # Lightning explains itself at every start: hundreds of trainings would drown in it.
    with quiet_lightning(), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield
