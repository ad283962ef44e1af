r"""Trains on windows in two processes, and writes down what each of them saw:

python fit_on_two_processes.py OUT
"""

import json
import sys
import warnings
from pathlib import Path

import pytest
import torch

pytest.importorskip("lightning", reason="needs the extra 'train'")

import lightning as L

from torch_geometric_tactile.data import Protocol, StaticDataset, Windows
from torch_geometric_tactile.loader import StaticLoader, static_loader
from torch_geometric_tactile.nn.models import GraspLSTM
from torch_geometric_tactile.sensors import grid
from torch_geometric_tactile.training import TactileDataModule, TactileModule
from torch_geometric_tactile.transforms import ZScore

LENGTH, HOP = 8, 2
EPOCHS = 3


def moving_windows(num_trials: int = 40, num_frames: int = 120) -> Windows:
    """Windows of trials whose readings rise or fall; the class is which of the two."""
    size = num_trials * num_frames
    trial = torch.arange(num_trials).repeat_interleave(num_frames)
    slope = trial % 2 * 2.0 - 1.0
    frame = torch.arange(size) % num_frames
    noise = torch.randn(size, 4, 1, generator=torch.Generator().manual_seed(0))
    x = (slope * frame % 10)[:, None, None] + 0.3 * noise
    frames = StaticDataset.from_arrays(
        x, trial % 2, trial=trial, number=torch.arange(size), layout=grid(2, 2, 0.002)
    )
    return Windows(frames, LENGTH, HOP, label="trial")


def module() -> TactileModule:
    """A small model, the same in every process."""
    L.seed_everything(0, verbose=False)
    model = GraspLSTM(4, 2, num_fingers=1, hidden_channels=8)
    return TactileModule(model, lambda weights: torch.optim.Adam(weights, lr=0.05))


def data(windows: Windows) -> TactileDataModule:
    """The windows, split by trial and scaled."""
    protocol = Protocol("trial", val=0.2, test=0.2)
    transform = ZScore(per="signal")
    return TactileDataModule(windows, split=protocol, transform=transform, batch_size=128)


class Seen(L.Callback):
    """Writes down which frame ended each window, epoch by epoch, and the training losses."""

    def __init__(self) -> None:
        self.train: list[list[int]] = []
        self.val: list[int] = []
        self.loss: list[list[float]] = []

    def on_train_epoch_start(self, trainer, pl_module):
        """Begins a list."""
        self.train.append([])
        self.loss.append([])
        self.val = []

    def on_train_batch_end(self, trainer, pl_module, outputs, batch, batch_idx):
        """Adds a batch."""
        self.train[-1] += batch.number.tolist()
        self.loss[-1].append(float(outputs["loss"]))

    def on_validation_batch_end(self, trainer, pl_module, outputs, batch, batch_idx, *_):
        """Adds a batch."""
        self.val += batch.number.tolist()

    def told(self, pl_module: torch.nn.Module) -> dict[str, object]:
        """Returns all of it, and the weights."""
        weights = [value.double().sum().item() for value in pl_module.parameters()]
        return {"train": self.train, "val": self.val, "loss": self.loss, "weights": weights}


def trainer(*callbacks: L.Callback, **arguments: object) -> L.Trainer:
    """A quiet trainer."""
    off = ("logger", "enable_checkpointing", "enable_progress_bar", "enable_model_summary")
    settings = {**dict.fromkeys(off, False), "max_epochs": EPOCHS, "accelerator": "cpu"}
    return L.Trainer(**{**settings, **arguments}, callbacks=list(callbacks))


def main() -> None:
    """Trains on data in memory, on data larger than memory, and with a loader that was given."""
    warnings.simplefilter("ignore")
    windows = moving_windows()
    found = {}
    for name in ("random", "larger than memory", "given"):
        seen, trained, parts = Seen(), module(), data(windows)
        on_two = trainer(seen, strategy="ddp", devices=2, num_sanity_val_steps=0)
        static_loader.exceeds_memory = lambda data, name=name: name == "larger than memory"
        if name == "given":
            loader = StaticLoader(windows, 128, shuffle="blocks", keyed=True)
            on_two.fit(trained, loader)
        else:
            on_two.fit(trained, datamodule=parts)
        found[name] = seen.told(trained)
        if name == "larger than memory":
            (metrics,) = on_two.test(trained, parts, verbose=False)
            found[name]["accuracy"] = metrics["test/accuracy"]
    rank = on_two.global_rank
    (Path(sys.argv[1]) / f"rank{rank}.json").write_text(json.dumps(found))
    # Without this, a thread of the group may abort the process at its exit.
    torch.distributed.destroy_process_group()


if __name__ == "__main__":
    torch.set_num_threads(1)
    main()
