r"""What a training has come to, as text."""

import os
from pathlib import Path

import lightning as L
from lightning.pytorch.callbacks import ModelCheckpoint
from tabulate import tabulate

from torch_geometric_tactile.training.data_module import TactileDataModule


def fit_summary(trainer: L.Trainer, folder: str | None = None) -> str:
    r"""Returns the last metrics of the validation part as a small table, the paths of the
    checkpoints, and the command that tests the last one. The test part is not looked at.
    """
    values = {key: float(value) for key, value in trainer.callback_metrics.items()}
    rows = [(key, values[key]) for key in sorted(values) if key.startswith("val/")]
    text = ["", f"After {trainer.current_epoch} epochs:", ""]
    if not rows:
        text[1] += " (there is no validation part)"
    if "train/loss" in values:
        rows.insert(0, ("train/loss", values["train/loss"]))
    text += [tabulate(rows, headers=("metric", "value"), floatfmt=".4f"), ""]
    checkpoint = None
    for callback in trainer.checkpoint_callbacks:
        if isinstance(callback, ModelCheckpoint):
            last, best = callback.last_model_path, callback.best_model_path
            checkpoint = checkpoint or last or best
            if callback.monitor and best:
                text.append(f"Best checkpoint by {callback.monitor}: {_short(best)}")
            if last:
                text.append(f"Last checkpoint: {_short(last)}")
    if checkpoint:
        text.append(_next_step(trainer, checkpoint, folder))
    return "\n".join(text)


def _next_step(trainer: L.Trainer, checkpoint: str, folder: str | None) -> str:
    data = getattr(trainer, "datamodule", None)
    if isinstance(data, TactileDataModule) and not len(data.part("test")):
        return "There is no test part: give 'data.test_dataset', or a 'data.test' above 0."
    config = None if folder is None else Path(folder) / "config.yaml"
    named = _short(config) if config is not None and config.is_file() else "CONFIG"
    short = _short(checkpoint)
    return (
        f"Test it:\n  tactile test --config {named} --ckpt_path {short}\n"
        "Use it on raw readings (scaling included), or on a robot without PyTorch:\n"
        f"  tactile predict {short} RECORDING\n  tactile export {short} model.onnx"
    )


def _short(path: str | Path) -> str:
    relative = os.path.relpath(path)
    return str(path) if relative.startswith("..") else relative
