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
from torchmetrics.classification import MulticlassAccuracy, MultilabelExactMatch

from torch_geometric_tactile.data import StaticDataset
from torch_geometric_tactile.predictor import checkpoint_entry
from torch_geometric_tactile.sensors import TaxelLayout
from torch_geometric_tactile.training.metrics import (
    Task,
    check_task,
    make_metrics,
    read_metrics,
)

# What gives a sample the attributes that models ask for.
_SOURCES = {
    "edge_attr": "add GeometricEdgeAttr() to the transform",
    "absolute": "add AbsoluteMorphology() to the transform",
    "pos": "add TaxelPose() to the transform",
    "normal": "add TaxelPose() to the transform",
    "joint": "take a data set with joint angles",
}


class TactileClassifier(L.LightningModule):
    r"""Trains a model to name the class of a sample, or each of its labels, and measures how well
    it does.

    Batches may be :class:`~torch_geometric_tactile.data.StaticData` or PyG's
    :class:`~torch_geometric.data.Batch`. A checkpoint carries the layout of the sensor that it was
    trained on, and refuses to be loaded for another.

    Of validation and test it logs :obj:`accuracy`, :obj:`f1` and :obj:`auroc`, which
    :func:`~torch_geometric_tactile.training.metrics.classification_metrics` describes: a class or
    label that the part lacks does not count in :obj:`auroc`, which is NaN if all are lacking.
    For two classes, :obj:`f1` is that of class 1. With :obj:`task="multilabel"`, :obj:`accuracy`
    asks for all labels of a sample to be right, and :obj:`label_accuracy` is the mean over the
    labels; that of each stands beside it with the label's name, or its number where the data
    has no names.

    Args:
        model (torch.nn.Module): Called as :obj:`model(x, edge_index)`, and with the attributes of
            the batch that its attribute :obj:`modalities` names, if it has one, by keyword; returns
            logits :math:`(B, C)`.
        optimizer (callable): Makes an optimizer of parameters.
        lr_scheduler (callable, optional): Makes a scheduler of an optimizer, stepped every epoch.
        num_classes (int, optional): Number of classes or labels :math:`C`. If left out, that of the
            data module, or two without one.
        task (str): :obj:`"multiclass"`, where :obj:`y` is one class a sample :math:`(B,)`, trained
            with the cross entropy; or :obj:`"multilabel"`, where it is a 0 or 1 for each label
            :math:`(B, C)`, trained with the binary cross entropy.

    Raises:
        ValueError: If :obj:`task` is unknown or does not fit :obj:`y`, a batch lacks what the model
            needs, or a checkpoint of another layout is loaded.
    """

    def __init__(
        self,
        model: nn.Module,
        optimizer: OptimizerCallable = torch.optim.Adam,
        lr_scheduler: LRSchedulerCallable | None = None,
        num_classes: int | None = None,
        task: Task = "multiclass",
    ) -> None:
        check_task(task)
        super().__init__()
        self.model = model
        self.optimizer = optimizer
        self.lr_scheduler = lr_scheduler
        self.task: Task = task
        self.class_names: list[str] = []
        self.layout: TaxelLayout | None = None
        self.test_sessions: dict[int, str] = {}
        self._classes_given = num_classes is not None
        self._set_num_classes(2 if num_classes is None else num_classes)
        self.session_accuracy = nn.ModuleList()

    def _set_num_classes(self, num_classes: int) -> None:
        self.num_classes = num_classes
        self.val_metrics = make_metrics(num_classes, self.task).to(self.device)
        self.test_metrics = make_metrics(num_classes, self.task).to(self.device)

    def setup(self, stage: str) -> None:
        r"""Takes the layout of the sensor and the names of the classes from the data module."""
        data = self._datamodule()
        self.layout = getattr(data, "layout", None)
        self.class_names = list(getattr(data, "class_names", ()))
        num_classes = getattr(data, "num_classes", 0)
        # One class cannot be told from another; and no class is known where there are no labels.
        if not self._classes_given and num_classes > (self.task == "multiclass"):
            self._set_num_classes(num_classes)
        if stage == "test":
            # Every process must hold the same metrics, whatever sessions its own batches have.
            self.test_sessions = dict(getattr(data, "test_sessions", {}))
            self.session_accuracy = nn.ModuleList(self._accuracy() for _ in self.test_sessions).to(
                self.device
            )

    def _accuracy(self) -> Metric:
        if self.task == "multilabel":
            return MultilabelExactMatch(self.num_classes)
        return MulticlassAccuracy(self.num_classes, average="micro")

    def forward(self, batch: Data) -> Tensor:
        r"""Returns the logits of a batch :math:`(B, C)`."""
        needed = getattr(self.model, "modalities", ())
        modalities = {name: getattr(batch, name, None) for name in needed}
        for name, value in modalities.items():
            if value is None:
                there = sorted(key for key, other in batch.to_dict().items() if other is not None)
                source = _SOURCES.get(name, "add a transform that sets it")
                raise ValueError(f"the model needs '{name}' (the batch has {there}): {source}")
        logits: Tensor = self.model(batch.x, batch.edge_index, **modalities)
        return logits

    def probability(self, logits: Tensor) -> Tensor:
        r"""Returns the probabilities of the classes, or of each label :math:`(B, C)`.

        Args:
            logits (torch.Tensor): What the model returned :math:`(B, C)`.
        """
        return logits.sigmoid() if self.task == "multilabel" else logits.softmax(dim=-1)

    def loss(self, logits: Tensor, y: Tensor) -> Tensor:
        r"""Returns the (binary) cross entropy of a batch.

        Args:
            logits (torch.Tensor): What the model returned :math:`(B, C)`.
            y (torch.Tensor): Classes :math:`(B,)`, or labels :math:`(B, C)`.
        """
        expected = logits.shape if self.task == "multilabel" else logits.shape[:1]
        if y.shape != expected:
            other = "multiclass" if self.task == "multilabel" else "multilabel"
            raise ValueError(
                f"'y' must have shape {tuple(expected)} for task='{self.task}' (got "
                f"{tuple(y.shape)}); is it task='{other}', or has the model another number of "
                "outputs?"
            )
        if self.task == "multilabel":
            return F.binary_cross_entropy_with_logits(logits, y.to(logits.dtype))
        return F.cross_entropy(logits, y)

    def training_step(self, batch: Data, batch_idx: int) -> Tensor:
        r"""Returns the loss of a batch."""
        loss = self.loss(self(batch), batch.y)
        self.log("train/loss", loss, batch_size=len(batch.y), on_epoch=True, on_step=False)
        return loss

    def validation_step(self, batch: Data, batch_idx: int) -> None:
        r"""Measures a batch of the validation part."""
        logits = self(batch)
        loss = self.loss(logits, batch.y)
        self.val_metrics.update(self.probability(logits), self._target(batch))
        self.log("val/loss", loss, batch_size=len(batch.y), sync_dist=True)

    def on_validation_epoch_end(self) -> None:
        r"""Logs what was measured on the validation part."""
        self._log_metrics("val", self.val_metrics)

    def test_step(self, batch: Data, batch_idx: int) -> None:
        r"""Measures a batch of the test part, also by recording session."""
        logits = self(batch)
        loss = self.loss(logits, batch.y)
        self.log("test/loss", loss, batch_size=len(batch.y), sync_dist=True)
        probability, y = self.probability(logits), self._target(batch)
        self.test_metrics.update(probability, y)
        if "session" in batch:
            for session, metric in zip(self.test_sessions, self.session_accuracy, strict=True):
                assert isinstance(metric, Metric)
                of_session = batch.session == session
                if of_session.any():
                    metric.update(probability[of_session], y[of_session])

    def _target(self, batch: Data) -> Tensor:
        return batch.y.long() if self.task == "multilabel" else batch.y

    def on_test_epoch_end(self) -> None:
        r"""Logs what was measured on the test part, and the accuracy of each session."""
        self._log_metrics("test", self.test_metrics)
        for name, metric in zip(self.test_sessions.values(), self.session_accuracy, strict=True):
            assert isinstance(metric, Metric)
            self.log(f"test/accuracy_{name}", metric.compute(), sync_dist=True)
            metric.reset()

    def predict_step(self, batch: Data, batch_idx: int) -> Tensor:
        r"""Returns the probabilities of the classes, or of each label :math:`(B, C)`."""
        return self.probability(self(batch))

    def configure_optimizers(self) -> OptimizerLRScheduler:
        r"""Makes the optimizer and its scheduler."""
        optimizer = self.optimizer(self.parameters())
        if self.lr_scheduler is None:
            return optimizer
        return {"optimizer": optimizer, "lr_scheduler": self.lr_scheduler(optimizer)}

    def on_save_checkpoint(self, checkpoint: dict[str, Any]) -> None:
        r"""Puts into the checkpoint the layout, and what
        :class:`~torch_geometric_tactile.predictor.Predictor` needs beside the weights.
        """
        if self.layout is not None:
            checkpoint["layout"] = self.layout.to_dict()
        data = self._datamodule()
        dataset = getattr(data, "dataset", None)
        if isinstance(dataset, StaticDataset):
            transform = getattr(data, "transform", None)
            checkpoint["predictor"] = checkpoint_entry(self.model, dataset, transform, self.task)

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
        names = self.class_names if len(self.class_names) == self.num_classes else ()
        by_number = {f"label_accuracy_{i}": f"label_accuracy_{n}" for i, n in enumerate(names)}
        for name, value in read_metrics(metrics).items():
            shown = name in ("accuracy", "f1")
            name = by_number.get(name, name)
            self.log(f"{stage}/{name}", value, prog_bar=shown, sync_dist=True)
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
