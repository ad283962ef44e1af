r"""The content that a module adds to its checkpoints and restores from them."""

import warnings
from collections.abc import Mapping
from typing import Any, Self

import lightning as L
import torch
from torch import Tensor, nn

from torch_geometric_tactile._typing import PathLike, ThresholdMetric
from torch_geometric_tactile.data import StaticDataset
from torch_geometric_tactile.loader._random_states import RandomStates
from torch_geometric_tactile.predictor import checkpoint_entry, model_entry
from torch_geometric_tactile.sensors import TaxelLayout
from torch_geometric_tactile.training._checkpoint_file import load_module
from torch_geometric_tactile.training._collected_metrics import Task
from torch_geometric_tactile.training._threshold import BestThreshold

_STATES = "random_states"


class CheckpointedModule(L.LightningModule):
    r"""A Lightning module with a decision threshold. Its checkpoints contain the layout of the
    sensor and the description of the predictor, and are read without executing code from the file.

    Checkpoints also contain the states of all random number generators. A training that is resumed
    at the end of an epoch gives, on a CPU, exactly the weights of an uninterrupted training.
    """

    model: nn.Module
    task: Task
    layout: TaxelLayout | None
    decision_threshold: float | None
    #: The configuration of the module, stored in checkpoints for :func:`compare_settings`.
    config: Mapping[str, Any] | None = None
    threshold: float | ThresholdMetric | None
    val_threshold: BestThreshold | None
    _random_states: dict[str, Any] | None = None

    def arguments(self) -> dict[str, Any]:
        r"""Returns the arguments of the constructor that checkpoints store: all except model,
        optimizer and scheduler, as plain values.
        """
        raise NotImplementedError

    def on_save_checkpoint(self, checkpoint: dict[str, Any]) -> None:
        r"""Adds the layout, the description of the model, the states of the random number
        generators and the description of the :class:`~torch_geometric_tactile.predictor.Predictor`.
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
                f"{self.layout.num_taxels} taxels, as the data (got '{layout.name}' with "
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
        # Up to version 0.2.1, checkpoints held states of our loaders, which no longer have a state.
        fit_loop = checkpoint.get("loops", {}).get("fit_loop", {})
        loaders = fit_loop.get("state_dict", {}).get("combined_loader", [])
        loaders[:] = [state for state in loaders if "num_batches" not in state]
        if self.trainer.strategy.restore_checkpoint_after_setup:  # on_fit_start has already run
            self._restore_random_states()

    def on_fit_start(self) -> None:
        r"""Restores the random states, after the model is built and before the first batch."""
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
        r"""Loads a module, without the transforms of its data. For live use, see
        :class:`~torch_geometric_tactile.predictor.Predictor`.

        Checksums are verified, and no code from the file is executed: models of this package are
        built by their names, any other is passed as :obj:`model`.

        Args:
            checkpoint_path (str or PathLike): The checkpoint.
            map_location (optional): Device of the tensors; the CPU if left out.
            hparams_file (optional): Not supported.
            strict (bool, optional): If :obj:`False`, missing and unexpected weights are ignored.
            weights_only (bool, optional): Must not be :obj:`False`.
            **kwargs (optional): Arguments of the module that replace those in the checkpoint, such
                as :obj:`model` (it is copied), and :obj:`optimizer` and :obj:`lr_scheduler`, which
                a checkpoint does not store.

        Raises:
            FileNotFoundError: If there is no such file.
            ValueError: If the file is damaged, is not a checkpoint or is one of an older version,
                or its model is neither a class of this package nor passed as :obj:`model`.
        """
        for name, is_set in (
            ("weights_only", weights_only is False),
            ("hparams_file", hparams_file),
        ):
            if is_set:
                raise ValueError(f"'{name}' must be left out, since it may run code")
        return load_module(cls, checkpoint_path, map_location, strict, kwargs)

    def _datamodule(self) -> Any:
        return None if self._trainer is None else getattr(self.trainer, "datamodule", None)

    def set_threshold(self, threshold: float | ThresholdMetric | None) -> None:
        r"""Sets the decision threshold, or the metric by which it is chosen.

        Args:
            threshold (float or str, optional): The threshold, or the name of a metric.
        """
        self.threshold = threshold
        self.decision_threshold = None if isinstance(threshold, str) else threshold
        self.val_threshold = BestThreshold(threshold) if isinstance(threshold, str) else None

    def choose_threshold(self) -> None:
        r"""Chooses and logs the threshold at the end of a validation epoch of training."""
        if self.val_threshold is None:
            return
        if self.trainer.state.fn == "fit":  # a trained model keeps its threshold
            self.decision_threshold = float(self.val_threshold.compute())
            self.log("val/threshold", self.decision_threshold, sync_dist=True)
        self.val_threshold.reset()

    def probability(self, logits: Tensor) -> Tensor:
        r"""Returns the probabilities of the classes or of each label :math:`(B, C)`. The numbers of
        a regression are returned unchanged.

        Args:
            logits (torch.Tensor): Outputs of the model :math:`(B, C)`.
        """
        if self.task == "regression":
            return logits
        return logits.sigmoid() if self.task == "multilabel" else logits.softmax(dim=-1)


def _warn_of_missing_transforms(checkpoint: Mapping[str, Any]) -> None:
    r"""Warns if the model of a checkpoint was trained on readings changed by fitted transforms,
    such as scalers.
    """
    names = fitted_names(checkpoint)
    if names:
        warnings.warn(
            f"this model was trained on readings transformed by {', '.join(names)}, but a module "
            "from a checkpoint has no transforms: for raw readings use "
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
    while pending:  # no recursion: a hostile file could nest deeper than its limit
        node = pending.pop()
        if isinstance(node, Mapping):
            if node.get("state") and isinstance(node.get("class"), str):
                names.append(node["class"])
            pending += reversed(list(node.values()))
        elif isinstance(node, list):
            pending += reversed(node)
    return names
