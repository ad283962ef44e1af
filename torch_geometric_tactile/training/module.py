r"""The training, validation and test steps of a model."""

import warnings
from collections.abc import Mapping
from typing import Any, Self

import lightning as L
import torch
from lightning.pytorch.cli import LRSchedulerCallable, OptimizerCallable, instantiate_module
from lightning.pytorch.utilities.types import OptimizerLRScheduler
from torch import Tensor, nn
from torch_geometric.data import Data
from torchmetrics import Metric, MetricCollection

from torch_geometric_tactile._typing import PathLike, ThresholdMetric
from torch_geometric_tactile.data import StaticDataset
from torch_geometric_tactile.loader._random_states import RandomStates
from torch_geometric_tactile.nn.models._calls import call_model
from torch_geometric_tactile.nn.models._inputs import needed_inputs
from torch_geometric_tactile.predictor._content import checkpoint_entry, model_entry
from torch_geometric_tactile.sensors import TaxelLayout
from torch_geometric_tactile.training._checkpoint_file import load_module
from torch_geometric_tactile.training._checks import (
    EDGE_SOURCE,
    check_data,
    check_has_threshold,
    num_outputs,
    train_weights,
)
from torch_geometric_tactile.training._collected_metrics import (
    Task,
    check_task,
    make_metrics,
    predicted_classes,
    read_metrics,
    session_metric,
    update_metrics,
)
from torch_geometric_tactile.training._finite import BatchCheck
from torch_geometric_tactile.training._layout_text import plain_section
from torch_geometric_tactile.training._losses import (
    ClassWeights,
    RegressionLoss,
    check_loss,
    check_num_weights,
    numbers_like,
    task_loss,
)
from torch_geometric_tactile.training._sizes import DataSizes, fill_sizes
from torch_geometric_tactile.training._threshold import BestThreshold, check_threshold
from torch_geometric_tactile.training.cosine_annealing import CosineAnnealing
from torch_geometric_tactile.training.data_module import TactileDataModule

_STATES = "random_states"  # the key in checkpoints


class TactileModule(L.LightningModule):
    r"""A Lightning module that trains a model for classification (one class or several labels per
    sample) or regression, and computes its metrics.

    Batches may be :class:`~torch_geometric_tactile.data.StaticData` or PyG's
    :class:`~torch_geometric.data.Batch`. With a :class:`TactileDataModule`, labels, outputs and
    attributes are checked before the first batch.

    On the validation and test parts, the module logs the metrics of
    :mod:`torch_geometric_tactile.training.metrics`. Classes and labels that no sample of the part
    has are left out of :obj:`auroc`, which is NaN if no class is left. If the data has label names,
    they are used in the log, as in :obj:`label_accuracy_slippery`.

    Checkpoints contain the layout of the sensor, the description of the predictor and the states of
    all random number generators. They are read without executing code from the file. Loading a
    checkpoint for data with another layout is an error. On a CPU, training that is resumed at the
    end of an epoch gives exactly the same weights as uninterrupted training.

    Args:
        model (torch.nn.Module): The model. It is called as :obj:`model(x, edge_index)` and returns
            logits or numbers :math:`(B, C)`. Further attributes of the batch, such as
            :obj:`edge_attr`, are passed as keyword arguments: the attributes listed in the model's
            :obj:`modalities` or, if it has no :obj:`modalities`, the arguments of its
            :obj:`forward` without a default. If :obj:`forward` has an argument :obj:`batch`, as in
            PyG's models, the model is called as :obj:`model(x, edge_index, batch=batch)` on a PyG
            batch, also for static data. For data without edges, :obj:`edge_index` is :obj:`None`;
            this is an error for models with :obj:`needs_edges = True` and for models that pass
            messages along required edges.
        optimizer (callable): Function that builds an optimizer from parameters.
        lr_scheduler (callable, optional): Function that builds a scheduler from an optimizer. The
            scheduler is stepped every epoch.
            :class:`~torch_geometric_tactile.training.CosineAnnealing` takes the number of epochs
            from the trainer.
        num_classes (int, optional): Number of classes, labels or targets :math:`C`. Defaults to the
            number in the data module, or to two without a data module.
        task (str): The task:

            * :obj:`"multiclass"`: :obj:`y` is one class per sample :math:`(B,)`, trained with the
              cross entropy.
            * :obj:`"multilabel"`: :obj:`y` is 0 or 1 for each label :math:`(B, C)`, trained with
              the binary cross entropy.
            * :obj:`"regression"`: :obj:`y` is one number per sample :math:`(B,)` or several
              :math:`(B, C)`.
        loss (str, optional): Loss of a regression: :obj:`"mse"` (mean squared error, the default),
            :obj:`"l1"` (mean absolute error) or :obj:`"huber"`.
        class_weights (sequence of float or str, optional): Weight of each class in the training
            loss, or of the samples that have each label. :obj:`"balanced"` computes the weights
            from the training part (see
            :func:`~torch_geometric_tactile.training._losses.balanced_weights`).
        label_smoothing (float): Fraction of the target that is distributed over all classes in the
            training loss. Validation and test losses use neither label smoothing nor class weights,
            so that they stay comparable.
        threshold (float or str, optional): For two classes, the probability above which class 1 is
            predicted (default: one half), or a metric: :obj:`"accuracy"`,
            :obj:`"balanced_accuracy"`, :obj:`"f1"` or :obj:`"f1_positive"`. With a metric, the best
            threshold on the validation part is selected after every epoch. The threshold is stored
            in checkpoints and predictors and is used in the test. The validation metrics in the log
            do not use it, because it was selected on this part.

    Raises:
        ValueError: If :obj:`task` is unknown or does not fit the loss or :obj:`y`, if an input of
            the model is missing from a batch, or if a checkpoint with another layout is loaded.

    Examples:
        >>> from torch_geometric_tactile.nn.models import TaxelNet
        >>> model = TaxelNet("biotac_sp", in_channels=3, out_channels=2)
        >>> module = TactileModule(model, num_classes=2)
        >>> module.task
        'multiclass'
    """

    #: The configuration of the module. It is stored in checkpoints and compared on loading.
    config: Mapping[str, Any] | None = None
    class_weight: Tensor | None
    decision_threshold: float | None
    threshold: float | ThresholdMetric | None
    val_threshold: BestThreshold | None
    _random_states: dict[str, Any] | None = None

    def __init__(
        self,
        model: nn.Module,
        optimizer: OptimizerCallable = torch.optim.Adam,
        lr_scheduler: LRSchedulerCallable | None = None,
        *,
        num_classes: int | None = None,
        task: Task = "multiclass",
        loss: RegressionLoss | None = None,
        class_weights: ClassWeights | None = None,
        label_smoothing: float = 0.0,
        threshold: float | ThresholdMetric | None = None,
    ) -> None:
        check_task(task)
        check_loss(task, loss, class_weights, label_smoothing)
        check_threshold(threshold, task)
        super().__init__()
        self.model = model
        self.optimizer = optimizer
        self.lr_scheduler = lr_scheduler
        self.task: Task = task
        self.regression_loss = loss
        self.class_weights = class_weights
        self.label_smoothing = label_smoothing
        self.set_threshold(threshold)
        self.class_names: list[str] = []
        self.layout: TaxelLayout | None = None
        self.test_sessions: dict[int, str] = {}
        self._has_num_classes = num_classes is not None
        if num_classes is None:
            num_classes = 1 if task == "regression" else 2
        self._set_num_classes(num_classes)
        # Only used in training and rebuilt by `setup`, so it is not stored in checkpoints.
        self.register_buffer("class_weight", None, persistent=False)
        if class_weights is not None and not isinstance(class_weights, str):
            self.class_weight = torch.tensor(list(class_weights), dtype=torch.float)
        self.session_metrics = nn.ModuleList()

    def arguments(self) -> dict[str, Any]:
        r"""Returns the constructor arguments that checkpoints store, as plain values. These are all
        arguments except the model, the optimizer and the scheduler.
        """
        weights = self.class_weights
        return {
            "num_classes": self.num_classes,
            "task": self.task,
            "loss": self.regression_loss,
            "class_weights": weights if weights is None or isinstance(weights, str) else [*weights],
            "label_smoothing": self.label_smoothing,
            "threshold": self.threshold,
        }

    def set_threshold(self, threshold: float | ThresholdMetric | None) -> None:
        r"""Sets the decision threshold, or the metric by which it is selected.

        Args:
            threshold (float or str, optional): The threshold, or the name of a metric.
        """
        self.threshold = threshold
        self.decision_threshold = None if isinstance(threshold, str) else threshold
        self.val_threshold = BestThreshold(threshold) if isinstance(threshold, str) else None

    def _set_num_classes(self, num_classes: int) -> None:
        self.num_classes = num_classes
        self.val_metrics = make_metrics(num_classes, self.task).to(self.device)
        self.test_metrics = make_metrics(num_classes, self.task).to(self.device)

    def setup(self, stage: str) -> None:
        r"""Takes the layout and class names from the data module, and checks the data."""
        data = self._datamodule()
        self.layout = getattr(data, "layout", None)
        self.class_names = list(getattr(data, "class_names", ()))
        has_data_module = isinstance(data, TactileDataModule)
        num_classes = num_outputs(data, self.task) if has_data_module else 0
        # A single class gives nothing to learn, and 0 means that the data has no labels.
        if not self._has_num_classes and num_classes > (self.task == "multiclass"):
            self._set_num_classes(num_classes)
        if stage == "test":
            # All processes must have the same metrics, even if their batches cover different
            # sessions.
            self.test_sessions = dict(getattr(data, "test_sessions", {}))
            self.session_metrics = nn.ModuleList(
                session_metric(self.num_classes, self.task) for _ in self.test_sessions
            ).to(self.device)
        if has_data_module:
            check_data(self, data, stage)
        if self.threshold is not None:
            check_has_threshold(self, data, stage)
        if stage == "fit":
            self._set_class_weight(data if has_data_module else None)

    def _set_class_weight(self, data: TactileDataModule | None) -> None:
        if self.class_weights == "balanced":
            weight = train_weights(data, self.task, self.num_classes)
            self.class_weight = weight.to(self.device)
        check_num_weights(self.class_weight, self.num_classes)

    def forward(self, batch: Data) -> Tensor:
        r"""Returns the logits of a batch, or the predicted numbers :math:`(B, C)`."""
        return call_model(self.model, batch, self.inputs(batch))

    def inputs(self, batch: Data) -> dict[str, Any]:
        r"""Returns the attributes of a batch that are passed to the model as keyword arguments.

        Args:
            batch (Data): The batch.

        Raises:
            ValueError: If an attribute is missing, or the model needs edges and there are none.
        """

        def describe_batch() -> str:
            keys = sorted(key for key, value in batch.to_dict().items() if value is not None)
            return f"the batch has {keys}"

        joint = "use a data set with joint angles"
        return needed_inputs(self.model, batch, describe_batch, edge_index=EDGE_SOURCE, joint=joint)

    def probability(self, logits: Tensor) -> Tensor:
        r"""Returns the probabilities of the classes or of each label :math:`(B, C)`. The numbers of
        a regression are returned unchanged.

        Args:
            logits (torch.Tensor): Outputs of the model :math:`(B, C)`.
        """
        if self.task == "regression":
            return logits
        return logits.sigmoid() if self.task == "multilabel" else logits.softmax(dim=-1)

    def loss(self, logits: Tensor, y: Tensor) -> Tensor:
        r"""Returns the loss of a batch, without class weights and label smoothing.

        Args:
            logits (torch.Tensor): Outputs of the model :math:`(B, C)`.
            y (torch.Tensor): Classes :math:`(B,)`, labels :math:`(B, C)` or numbers.
        """
        return task_loss(logits, y, self.task, loss=self.regression_loss)

    def training_step(self, batch: Data, batch_idx: int) -> Tensor:
        r"""Returns the training loss of a batch, which must be finite."""
        check = BatchCheck.from_step(self, "train", batch, batch_idx)
        if self.device.type == "cpu":  # on a GPU this would synchronize; checking the loss suffices
            check.inputs()
        out = self(batch)
        loss = task_loss(
            out,
            batch.y,
            self.task,
            loss=self.regression_loss,
            weights=self.class_weight,
            label_smoothing=self.label_smoothing,
        )
        check.loss(loss, out)
        self.log("train/loss", loss, batch_size=len(batch.y), on_epoch=True, on_step=False)
        return loss

    def validation_step(self, batch: Data, batch_idx: int) -> None:
        r"""Adds a batch of the validation part to the metrics."""
        score, y = self._update_metrics("val", batch, batch_idx, self.val_metrics)
        if self.val_threshold is not None:
            self.val_threshold.update(score, y)

    def on_validation_epoch_end(self) -> None:
        r"""Logs the metrics of the validation part, and selects the threshold."""
        self._log_metrics("val", self.val_metrics)
        self.choose_threshold()

    def choose_threshold(self) -> None:
        r"""Selects and logs the threshold at the end of a validation epoch during training."""
        if self.val_threshold is None:
            return
        if self.trainer.state.fn == "fit":  # a trained model keeps its threshold
            self.decision_threshold = float(self.val_threshold.compute())
            self.log("val/threshold", self.decision_threshold, sync_dist=True)
        self.val_threshold.reset()

    def test_step(self, batch: Data, batch_idx: int) -> None:
        r"""Adds a batch of the test part to the metrics, in total and for each session."""
        threshold = self.decision_threshold
        score, y = self._update_metrics("test", batch, batch_idx, self.test_metrics, threshold)
        if "session" in batch:
            for session, metric in zip(self.test_sessions, self.session_metrics, strict=True):
                assert isinstance(metric, Metric)
                in_session = batch.session == session
                if in_session.any():
                    prediction = score if threshold is None else predicted_classes(score, threshold)
                    metric.update(prediction[in_session], y[in_session])

    def _update_metrics(
        self,
        stage: str,
        batch: Data,
        batch_idx: int,
        metrics: MetricCollection,
        threshold: float | None = None,
    ) -> tuple[Tensor, Tensor]:
        out = self(batch)
        score, y = self.probability(out), batch.y
        BatchCheck.from_step(self, stage, batch, batch_idx).scores(score)
        self.log(f"{stage}/loss", self.loss(out, y), batch_size=len(y), sync_dist=True)
        if self.task == "regression":  # in float64: large numbers may vary little
            score, y = score.double(), numbers_like(y, out).double()
        elif self.task == "multilabel":
            y = y.long()
        update_metrics(metrics, score, y, threshold)
        return score, y

    def on_test_epoch_end(self) -> None:
        r"""Logs the metrics of the test part, and the accuracy or MAE of each session."""
        self._log_metrics("test", self.test_metrics)
        name = "mae" if self.task == "regression" else "accuracy"
        for session, metric in zip(self.test_sessions.values(), self.session_metrics, strict=True):
            assert isinstance(metric, Metric)
            self.log(f"test/{name}_{session}", metric.compute(), sync_dist=True)
            metric.reset()

    def predict_step(self, batch: Data, batch_idx: int) -> Tensor:
        r"""Returns the probabilities of the classes or of each label, or the predicted numbers
        :math:`(B, C)`.
        """
        score = self.probability(self(batch))
        BatchCheck.from_step(self, "predict", batch, batch_idx).warn(score)
        return score

    def configure_optimizers(self) -> OptimizerLRScheduler:
        r"""Builds the optimizer and its scheduler."""
        optimizer = self.optimizer(self.parameters())
        if self.lr_scheduler is None:
            return optimizer
        scheduler = self.lr_scheduler(optimizer)
        if isinstance(scheduler, CosineAnnealing):
            scheduler.follow(self.trainer.max_epochs)
        return {"optimizer": optimizer, "lr_scheduler": scheduler}

    def _log_metrics(self, stage: str, metrics: MetricCollection) -> None:
        names = self.class_names if len(self.class_names) == self.num_classes else ()
        log_names = {f"label_accuracy_{i}": f"label_accuracy_{n}" for i, n in enumerate(names)}
        for name, value in read_metrics(metrics).items():
            is_in_progress_bar = name in ("accuracy", "f1", "mae")
            name = log_names.get(name, name)
            self.log(f"{stage}/{name}", value, prog_bar=is_in_progress_bar, sync_dist=True)
        metrics.reset()

    def on_save_checkpoint(self, checkpoint: dict[str, Any]) -> None:
        r"""Adds the layout, the description of the model, the states of the random number
        generators and the description of the :class:`~torch_geometric_tactile.predictor.Predictor`
        to a checkpoint.
        """
        states = RandomStates.now().to_dict()
        if torch.cuda.is_available() and torch.cuda.is_initialized():
            states["cuda"] = torch.cuda.get_rng_state_all()
        checkpoint[_STATES] = states
        checkpoint["module"] = {
            "arguments": self.arguments(),
            **model_entry(self.model, self.layout),
        }
        if self.config is not None:
            checkpoint["config"] = dict(self.config)
        if self.layout is not None:
            checkpoint["layout"] = self.layout.to_dict()
        if self.decision_threshold is not None:
            checkpoint["decision_threshold"] = self.decision_threshold
        data = self._datamodule()
        dataset = getattr(data, "dataset", None)
        if isinstance(dataset, StaticDataset):
            transform = getattr(data, "transform", None)
            checkpoint["predictor"] = checkpoint_entry(
                self.model, dataset, transform, self.task, self.decision_threshold
            )

    def on_load_checkpoint(self, checkpoint: dict[str, Any]) -> None:
        r"""Restores the layout and the threshold. Raises a :class:`ValueError` if the data has
        another layout.
        """
        self._load_random_states(checkpoint)
        if self._trainer is None:
            _warn_of_missing_transforms(checkpoint)
        if "decision_threshold" in checkpoint:
            self.decision_threshold = float(checkpoint["decision_threshold"])
        if "layout" not in checkpoint:
            return
        layout = TaxelLayout.from_dict(checkpoint["layout"])
        if self.layout is not None and not self.layout.matches(layout):
            raise ValueError(
                f"the checkpoint must have layout '{self.layout.name}' with "
                f"{self.layout.num_taxels} taxels, like the data (got '{layout.name}' with "
                f"{layout.num_taxels}); train again, or load the data it was trained on"
            )
        self.layout = layout

    def _load_random_states(self, checkpoint: dict[str, Any]) -> None:
        self._random_states = None
        if self._trainer is None or self.trainer.state.fn != "fit":
            return
        self._random_states = checkpoint.get(_STATES)
        if self._random_states is not None:
            try:
                RandomStates.from_dict(self._random_states)
            except ValueError as error:
                raise ValueError(
                    f"'{self.trainer.ckpt_path}' cannot be resumed: {error}; train again"
                ) from error
        # Up to version 0.2.1, checkpoints contained states of loaders, which are now stateless.
        fit_loop = checkpoint.get("loops", {}).get("fit_loop", {})
        loaders = fit_loop.get("state_dict", {}).get("combined_loader", [])
        loaders[:] = [state for state in loaders if "num_batches" not in state]
        if self.trainer.strategy.restore_checkpoint_after_setup:  # on_fit_start has already run
            self._restore_random_states()

    def on_fit_start(self) -> None:
        r"""Restores the random states after the model is built and before the first batch."""
        self._restore_random_states()

    def _restore_random_states(self) -> None:
        states, self._random_states = self._random_states, None
        if states is None:
            return
        RandomStates.from_dict(states).restore()
        cuda = states.get("cuda", ())
        if torch.cuda.is_available() and len(cuda) == torch.cuda.device_count():
            torch.cuda.set_rng_state_all([state.cpu() for state in cuda])

    @classmethod
    def load_from_checkpoint(
        cls,
        checkpoint_path: Any,
        map_location: Any = None,
        hparams_file: PathLike | None = None,
        strict: bool | None = None,
        weights_only: bool | None = None,
        **kwargs: Any,
    ) -> Self:
        r"""Returns the module in a checkpoint, without the transforms of its data. For live use,
        see :class:`~torch_geometric_tactile.predictor.Predictor`.

        Checksums are verified, and no code from the file is executed: models of this package are
        built by their names, and any other model must be passed as :obj:`model`.

        Args:
            checkpoint_path (str or PathLike): The checkpoint.
            map_location (optional): Device of the tensors. Defaults to the CPU.
            hparams_file (optional): Not supported.
            strict (bool, optional): If :obj:`False`, missing and unexpected weights are ignored.
            weights_only (bool, optional): Must not be :obj:`False`.
            **kwargs (optional): Arguments of the module that replace arguments in the checkpoint,
                such as :obj:`model` (which is copied). A checkpoint does not store
                :obj:`optimizer` and :obj:`lr_scheduler`.

        Raises:
            FileNotFoundError: If the file does not exist.
            ValueError: If the file is damaged, is not a checkpoint or comes from an older version,
                or if its model is neither a class of this package nor passed as :obj:`model`.
        """
        for name, is_set in (
            ("weights_only", weights_only is False),
            ("hparams_file", hparams_file),
        ):
            if is_set:
                raise ValueError(f"'{name}' must be left out, because it may run code")
        return load_module(cls, checkpoint_path, map_location, strict, kwargs)

    def _datamodule(self) -> Any:
        return None if self._trainer is None else getattr(self.trainer, "datamodule", None)


def _warn_of_missing_transforms(checkpoint: Mapping[str, Any]) -> None:
    r"""Warns if the model of a checkpoint was trained on readings changed by fitted transforms,
    such as scalers.
    """
    names = fitted_names(checkpoint)
    if names:
        warnings.warn(
            f"this model was trained on readings transformed by {', '.join(names)}, but a module "
            "from a checkpoint has no transforms: for raw readings, use "
            "Predictor.from_checkpoint(path); to test it, use "
            "trainer.test(module, datamodule=data, ckpt_path=path)",
            stacklevel=3,
        )


def fitted_names(checkpoint: Mapping[str, Any]) -> list[str]:
    r"""Returns the class names of the fitted transforms in the predictor of a checkpoint."""
    entry = checkpoint.get("predictor")
    header = entry.get("header") if isinstance(entry, Mapping) else None
    pending = [header.get("transform")] if isinstance(header, Mapping) else []
    names = []
    while pending:  # no recursion: a malicious file could exceed the recursion limit
        node = pending.pop()
        if isinstance(node, Mapping):
            if node.get("state") and isinstance(node.get("class"), str):
                names.append(node["class"])
            pending += reversed(list(node.values()))
        elif isinstance(node, list):
            pending += reversed(node)
    return names


def classifier_from_config(
    config: Mapping[str, Any], data: TactileDataModule | DataSizes | None = None
) -> TactileModule:
    r"""Returns a module built from the :obj:`model` section of a configuration.

    The section may name any class, so the configuration must come from a trusted source.

    Args:
        config (Mapping): The arguments of :class:`TactileModule`, with classes as
            :obj:`{"class_path", "init_args"}`.
        data (TactileDataModule or DataSizes, optional): The data. Sizes that are missing from the
            configuration are derived from it (see
            :func:`~torch_geometric_tactile.training._sizes.fill_sizes`).

    Raises:
        ValueError: If a size in the configuration differs from the data, or if the module cannot be
            built.

    Examples:
        >>> from torch_geometric_tactile.datasets import FakeTactileDataset
        >>> data = TactileDataModule(FakeTactileDataset(20))
        >>> module = classifier_from_config({"model": "TaxelNet"}, data)
        >>> type(module.model).__name__
        'TaxelNet'
    """
    if data is not None:
        config = fill_sizes(config, data)
    try:
        classifier: TactileModule = instantiate_module(TactileModule, dict(config))
    except (ImportError, OSError, ValueError):
        raise
    except Exception as error:  # jsonargparse and constructors may raise any error
        reason = " ".join(f"{type(error).__name__}: {error}".split())
        raise ValueError(f"'config' must describe a TactileModule ({reason})") from error
    classifier.config = plain_section(config)
    return classifier
