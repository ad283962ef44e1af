r"""The training step of a classifier."""

from collections.abc import Mapping
from typing import Any

import lightning as L
import torch
import torch.nn.functional as F
from lightning.pytorch.cli import LRSchedulerCallable, OptimizerCallable, instantiate_module
from lightning.pytorch.utilities.types import OptimizerLRScheduler
from torch import Tensor, nn
from torch_geometric.data import Data
from torchmetrics import Metric, MetricCollection
from torchmetrics.classification import MulticlassAccuracy, MulticlassF1Score

from torch_geometric_tactile.sensors import TaxelLayout


class TactileClassifier(L.LightningModule):
    r"""Trains a model to name the class of a sample, and measures its accuracy and F1 score.

    Batches may be :class:`~torch_geometric_tactile.data.StaticData` or PyG's
    :class:`~torch_geometric.data.Batch`. A checkpoint carries the layout of the sensor that it was
    trained on, and refuses to be loaded for another.

    The F1 score is that of class 1 for two classes, and the mean over the classes for more.

    Args:
        model (torch.nn.Module): Called as :obj:`model(x, edge_index)`; returns logits
            :math:`(B, C)`.
        optimizer (callable): Makes an optimizer of parameters.
        lr_scheduler (callable, optional): Makes a scheduler of an optimizer, stepped every epoch.
        num_classes (int): Number of classes :math:`C`.

    Raises:
        ValueError: If a checkpoint of another layout is loaded.
    """

    def __init__(
        self,
        model: nn.Module,
        optimizer: OptimizerCallable = torch.optim.Adam,
        lr_scheduler: LRSchedulerCallable | None = None,
        num_classes: int = 2,
    ) -> None:
        super().__init__()
        self.model = model
        self.optimizer = optimizer
        self.lr_scheduler = lr_scheduler
        self.num_classes = num_classes
        self.layout: TaxelLayout | None = None
        self.test_sessions: dict[int, str] = {}
        metrics = MetricCollection(
            {
                "accuracy": MulticlassAccuracy(num_classes, average="micro"),
                "f1": MulticlassF1Score(
                    num_classes, average="none" if num_classes == 2 else "macro"
                ),
            }
        )
        self.val_metrics = metrics.clone()
        self.test_metrics = metrics.clone()
        self.session_accuracy = nn.ModuleList()

    def setup(self, stage: str) -> None:
        r"""Takes the layout of the sensor from the data module."""
        self.layout = getattr(self._datamodule(), "layout", None)
        if stage == "test":
            # Every process must hold the same metrics, whatever sessions its own batches have.
            self.test_sessions = dict(getattr(self._datamodule(), "test_sessions", {}))
            self.session_accuracy = nn.ModuleList(
                MulticlassAccuracy(self.num_classes, average="micro") for _ in self.test_sessions
            ).to(self.device)

    def forward(self, batch: Data) -> Tensor:
        r"""Returns the logits of a batch :math:`(B, C)`."""
        logits: Tensor = self.model(batch.x, batch.edge_index)
        return logits

    def training_step(self, batch: Data, batch_idx: int) -> Tensor:
        r"""Returns the cross entropy of a batch."""
        loss = F.cross_entropy(self(batch), batch.y)
        self.log("train/loss", loss, batch_size=len(batch.y), on_epoch=True, on_step=False)
        return loss

    def validation_step(self, batch: Data, batch_idx: int) -> None:
        r"""Measures a batch of the validation part."""
        logits = self(batch)
        self.val_metrics.update(logits, batch.y)
        loss = F.cross_entropy(logits, batch.y)
        self.log("val/loss", loss, batch_size=len(batch.y), sync_dist=True)

    def on_validation_epoch_end(self) -> None:
        r"""Logs accuracy and F1 score of the validation part."""
        self._log_metrics("val", self.val_metrics)

    def test_step(self, batch: Data, batch_idx: int) -> None:
        r"""Measures a batch of the test part, also by recording session."""
        logits = self(batch)
        self.test_metrics.update(logits, batch.y)
        if "session" in batch:
            for session, metric in zip(self.test_sessions, self.session_accuracy, strict=True):
                assert isinstance(metric, Metric)
                of_session = batch.session == session
                if of_session.any():
                    metric.update(logits[of_session], batch.y[of_session])

    def on_test_epoch_end(self) -> None:
        r"""Logs accuracy and F1 score of the test part, and the accuracy of each session."""
        self._log_metrics("test", self.test_metrics)
        for name, metric in zip(self.test_sessions.values(), self.session_accuracy, strict=True):
            assert isinstance(metric, Metric)
            self.log(f"test/accuracy_{name}", metric.compute(), sync_dist=True)
            metric.reset()

    def predict_step(self, batch: Data, batch_idx: int) -> Tensor:
        r"""Returns the probabilities of the classes :math:`(B, C)`."""
        return self(batch).softmax(dim=-1)

    def configure_optimizers(self) -> OptimizerLRScheduler:
        r"""Makes the optimizer and its scheduler."""
        optimizer = self.optimizer(self.parameters())
        if self.lr_scheduler is None:
            return optimizer
        return {"optimizer": optimizer, "lr_scheduler": self.lr_scheduler(optimizer)}

    def on_save_checkpoint(self, checkpoint: dict[str, Any]) -> None:
        r"""Puts the layout into the checkpoint."""
        if self.layout is not None:
            checkpoint["layout"] = self.layout.to_dict()

    def on_load_checkpoint(self, checkpoint: dict[str, Any]) -> None:
        r"""Takes the layout from the checkpoint, or compares it with that of the data."""
        if "layout" not in checkpoint:
            return
        trained_on = TaxelLayout.from_dict(checkpoint["layout"])
        if self.layout is not None and not self.layout.matches(trained_on):
            raise ValueError(
                f"the checkpoint must be of layout '{self.layout.name}' with "
                f"{self.layout.num_taxels} taxels, as the data (got '{trained_on.name}' with "
                f"{trained_on.num_taxels}); train anew, or load the data it was trained on"
            )
        self.layout = trained_on

    def _log_metrics(self, stage: str, metrics: MetricCollection) -> None:
        value = metrics.compute()
        f1 = value["f1"][1] if self.num_classes == 2 else value["f1"]
        self.log(f"{stage}/accuracy", value["accuracy"], prog_bar=True, sync_dist=True)
        self.log(f"{stage}/f1", f1, prog_bar=True, sync_dist=True)
        metrics.reset()

    def _datamodule(self) -> Any:
        return None if self._trainer is None else getattr(self.trainer, "datamodule", None)


def classifier_from_config(config: Mapping[str, Any]) -> TactileClassifier:
    r"""Builds a classifier from the :obj:`model` section of a configuration, such that
    :meth:`TactileClassifier.load_from_checkpoint` can build it again.

    Args:
        config (Mapping): The arguments of :class:`TactileClassifier`, classes as
            :obj:`{"class_path", "init_args"}`.
    """
    classifier: TactileClassifier = instantiate_module(TactileClassifier, dict(config))
    keep_config(classifier, config)
    return classifier


def keep_config(classifier: TactileClassifier, config: Mapping[str, Any]) -> None:
    r"""Stores a configuration in a classifier's checkpoints, as plain data.

    Args:
        classifier (TactileClassifier): The classifier.
        config (Mapping): The :obj:`model` section that it was built from.
    """
    classifier.save_hyperparameters(
        {**config, "_instantiator": "lightning.pytorch.cli.instantiate_module"}, logger=False
    )
