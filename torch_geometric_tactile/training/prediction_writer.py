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
    r"""Writes what a model predicts to a CSV file: a row for each sample, with its index, predicted
    class and the probabilities of all classes. Of a multi-label model the prediction is all labels
    with a probability above one half, :obj:`;` between them, and empty if there is none.

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
        multilabel = getattr(pl_module, "task", None) == "multilabel"
        with atomic_path(path) as temporary, temporary.open("w", newline="") as file:
            writer = csv.writer(file)
            header_written = False
            for indices, probability in _batches(batch_indices, predictions):
                if not header_written:
                    num_classes = probability.size(1)
                    has_names = len(names) == num_classes
                    labels = names if has_names else [str(i) for i in range(num_classes)]
                    writer.writerow(["index", "prediction", *(f"p_{name}" for name in labels)])
                    header_written = True
                for index, row in zip(indices, probability, strict=True):
                    values = [f"{value:.6f}" for value in row.tolist()]
                    best = (row > 0.5).nonzero() if multilabel else row.argmax()
                    prediction = ";".join(labels[i] for i in best.view(-1).tolist())
                    writer.writerow([index, prediction, *values])
        self.written = path


def _batches(
    batch_indices: Sequence[Any], predictions: Sequence[Any]
) -> list[tuple[Sequence[int], Tensor]]:
    # Lightning nests the indices by loader always, the predictions only where there are several.
    if predictions and isinstance(predictions[0], list):
        predictions = predictions[0]
    return list(zip(batch_indices[0], predictions, strict=True))
