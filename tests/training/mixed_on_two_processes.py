r"""Trains on samples of different sensors in two processes, and writes down what each of them saw:

python mixed_on_two_processes.py OUT
"""

import json
import sys
import warnings
from pathlib import Path

import pytest
import torch

pytest.importorskip("lightning", reason="needs the extra 'train'")

import lightning as L
from mixed_sensors import gloves
from own_models import Attention

from torch_geometric_tactile.data import Protocol
from torch_geometric_tactile.training import TactileDataModule, TactileModule
from torch_geometric_tactile.transforms import ZScore

EPOCHS = 3


def data() -> TactileDataModule:
    """Gloves, split by subject and scaled."""
    protocol = Protocol("group", val=0.25, test=0.25)
    transform = ZScore(per="channel")
    return TactileDataModule(
        gloves(12, 12), split=protocol, transform=transform, batch_size=8, num_workers=0
    )


class Seen(L.Callback):
    """Writes down the trials and the number of taxels of each batch."""

    def __init__(self) -> None:
        self.train: list[list[int]] = []
        self.loss: list[list[float]] = []
        self.sizes: set[int] = set()

    def on_train_epoch_start(self, trainer, pl_module):
        """Begins a list."""
        self.train.append([])
        self.loss.append([])

    def on_train_batch_end(self, trainer, pl_module, outputs, batch, batch_idx):
        """Adds a batch."""
        self.train[-1] += batch.trial.tolist()
        self.loss[-1].append(float(outputs["loss"]))
        self.sizes |= {*batch.ptr.diff().tolist()}


def main() -> None:
    """Trains and tests."""
    warnings.simplefilter("ignore")
    L.seed_everything(0, verbose=False)
    seen, parts = Seen(), data()
    model = TactileModule(Attention(2, 2), lambda weights: torch.optim.Adam(weights, lr=0.02))
    off = ("logger", "enable_checkpointing", "enable_progress_bar", "enable_model_summary")
    trainer = L.Trainer(
        **dict.fromkeys(off, False),
        max_epochs=EPOCHS,
        accelerator="cpu",
        strategy="ddp",
        devices=2,
        callbacks=[seen],
    )
    trainer.fit(model, parts)
    (metrics,) = trainer.test(model, parts, verbose=False)
    found = {
        "train": seen.train,
        "loss": seen.loss,
        "sizes": sorted(seen.sizes),
        "accuracy": metrics["test/accuracy"],
        "weights": [value.double().sum().item() for value in model.parameters()],
    }
    (Path(sys.argv[1]) / f"rank{trainer.global_rank}.json").write_text(json.dumps(found))
    # Without this, a thread of the group may abort the process at its exit.
    torch.distributed.destroy_process_group()


if __name__ == "__main__":
    torch.set_num_threads(1)
    main()
