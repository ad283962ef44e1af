r"""Predictions as a file."""

import csv
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import lightning as L
from lightning.pytorch.callbacks import BasePredictionWriter
from torch import Tensor

from torch_geometric_tactile.files import atomic_path


class PredictionWriter(BasePredictionWriter):
    r"""Writes what a model predicts to a CSV file, a row for each sample, beginning with its index.

    For classes follow the predicted class and the probabilities of all; for labels, all labels with
    a probability above one half, joined by :obj:`;`, and the probabilities; for a regression, the
    predicted numbers, headed :obj:`prediction`, or, of several targets, by their names.

    In training on several machines each process writes a file of its own.

    Args:
        path (str): The file; relative to the folder of the run's logs.
    """

    def __init__(self, path: str = "predictions.csv") -> None:
        super().__init__(write_interval="epoch")
        self.path = path

    def write_on_epoch_end(
        self,
        trainer: L.Trainer,
        pl_module: L.LightningModule,
        predictions: Sequence[Any],
        batch_indices: Sequence[Any],
    ) -> None:
        r"""Writes the file, whole or not at all."""
        path = Path(trainer.log_dir or trainer.default_root_dir) / self.path
        if trainer.world_size > 1:
            path = path.with_name(f"{path.stem}_{trainer.global_rank}{path.suffix}")
        dataset = getattr(getattr(trainer, "datamodule", None), "dataset", None)
        names = getattr(dataset, "class_names", [])
        task = getattr(pl_module, "task", "multiclass")
        with atomic_path(path) as temporary, temporary.open("w", newline="") as file:
            writer = csv.writer(file)
            header_written = False
            for indices, outputs in _batches(batch_indices, predictions):
                if not header_written:
                    width = outputs.size(1)
                    labels = names if len(names) == width else [str(i) for i in range(width)]
                    writer.writerow(["index", *_header(labels, task)])
                    header_written = True
                for index, row in zip(indices, outputs, strict=True):
                    writer.writerow([index, *_row(row, labels, task)])
        self.written = path


def _batches(
    batch_indices: Sequence[Any], predictions: Sequence[Any]
) -> list[tuple[Sequence[int], Tensor]]:
    # Lightning nests the indices by loader always, the predictions only where there are several.
    if predictions and isinstance(predictions[0], list):
        predictions = predictions[0]
    return list(zip(batch_indices[0], predictions, strict=True))


def _header(labels: Sequence[str], task: str) -> list[str]:
    if task != "regression":
        return ["prediction", *(f"p_{label}" for label in labels)]
    return ["prediction"] if len(labels) == 1 else [f"prediction_{label}" for label in labels]


def _row(row: Tensor, labels: Sequence[str], task: str) -> list[str]:
    if task == "regression":
        return [f"{value:.6g}" for value in row.tolist()]
    best = (row > 0.5).nonzero() if task == "multilabel" else row.argmax()
    prediction = ";".join(labels[i] for i in best.view(-1).tolist())
    return [prediction, *(f"{value:.6f}" for value in row.tolist())]
