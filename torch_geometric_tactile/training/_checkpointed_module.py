r"""What a module writes into its checkpoints, and takes from them."""

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
    r"""A module that decides by a threshold, and whose checkpoints carry the layout of the sensor
    and what a predictor needs, and are read without running what is in them.

    They keep the states of the sources of random numbers as well: resumed from a checkpoint of the
    end of an epoch, weights are those of the training that was never stopped, bit by bit on a CPU.
    """

    model: nn.Module
    task: Task
    layout: TaxelLayout | None
    decision_threshold: float | None
    #: The configuration that the module was built from: checkpoints keep it to be compared.
    config: Mapping[str, Any] | None = None
    threshold: float | ThresholdMetric | None
    val_threshold: BestThreshold | None
    _random_states: dict[str, Any] | None = None

    def arguments(self) -> dict[str, Any]:
        r"""Returns the arguments of the constructor, but for model, optimizer and scheduler, that
        checkpoints keep: plain values.
        """
        raise NotImplementedError

    def on_save_checkpoint(self, checkpoint: dict[str, Any]) -> None:
        r"""Puts into the checkpoint the layout, the description of the model, and what
        :class:`~torch_geometric_tactile.predictor.Predictor` needs beside the weights.
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
        r"""Takes the layout from the checkpoint, or compares it with that of the data."""
        self._take_random_states(checkpoint)
        if self._trainer is None:
            _warn_of_scaling(checkpoint)
        if "decision_threshold" in checkpoint:
            self.decision_threshold = float(checkpoint["decision_threshold"])
        if "layout" not in checkpoint:
            return
        trained_on = TaxelLayout.from_dict(checkpoint["layout"])
        if self.layout is not None and not self.layout.matches(trained_on):
            raise ValueError(
                f"the checkpoint must be of layout '{self.layout.name}' with "
                f"{self.layout.num_taxels} taxels, as the data (got '{trained_on.name}' with "
                f"{trained_on.num_taxels}); train again, or load the data it was trained on"
            )
        self.layout = trained_on

    def _take_random_states(self, checkpoint: dict[str, Any]) -> None:
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
        # Up to version 0.2.1, checkpoints held states of our loaders, which no longer take any.
        fit_loop = checkpoint.get("loops", {}).get("fit_loop", {})
        loaders = fit_loop.get("state_dict", {}).get("combined_loader", [])
        loaders[:] = [state for state in loaders if "num_batches" not in state]
        if self.trainer.strategy.restore_checkpoint_after_setup:  # then training starts next
            self._restore_random_states()

    def on_fit_start(self) -> None:
        r"""Restores the random states: models and optimizers are built, and no batch is drawn."""
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
        r"""Loads a module, without the transforms of its data (for live use, take
        :class:`~torch_geometric_tactile.predictor.Predictor`). Its checksums are compared, and
        nothing in the file runs: models of this package are built by their names, any other is
        given as :obj:`model`.

        Args:
            checkpoint_path (str or PathLike): The checkpoint.
            map_location (optional): Where to put the tensors: the CPU if left out.
            hparams_file (optional): Not supported.
            strict (bool, optional): Whether all weights must be there and known; yes if left out.
            weights_only (bool, optional): Must not be :obj:`False`.
            **kwargs (optional): Arguments of the module, instead of those in the checkpoint:
                :obj:`model` (it is copied), and :obj:`optimizer` and :obj:`lr_scheduler`, which a
                checkpoint does not keep.

        Raises:
            FileNotFoundError: If there is no such file.
            ValueError: If the file is damaged, is no checkpoint or one of an older version, or its
                model is not of this package and not given.
        """
        for name, value in (
            ("weights_only", weights_only is False),
            ("hparams_file", hparams_file),
        ):
            if value:
                raise ValueError(f"'{name}' must be left out, since it may run code (got it)")
        return load_module(cls, checkpoint_path, map_location, strict, kwargs)

    def _datamodule(self) -> Any:
        return None if self._trainer is None else getattr(self.trainer, "datamodule", None)

    def set_threshold(self, threshold: float | ThresholdMetric | None) -> None:
        r"""Sets the threshold, or the metric that chooses it.

        Args:
            threshold (float or str, optional): The threshold, or a metric.
        """
        self.threshold = threshold
        self.decision_threshold = None if isinstance(threshold, str) else threshold
        self.val_threshold = BestThreshold(threshold) if isinstance(threshold, str) else None

    def choose_threshold(self) -> None:
        r"""Chooses and logs the threshold at the end of a validation in training."""
        if self.val_threshold is None:
            return
        if self.trainer.state.fn == "fit":  # a trained model keeps what it was trained with
            self.decision_threshold = float(self.val_threshold.compute())
            self.log("val/threshold", self.decision_threshold, sync_dist=True)
        self.val_threshold.reset()

    def probability(self, logits: Tensor) -> Tensor:
        r"""Returns the probabilities of the classes or of each label :math:`(B, C)`; the numbers of
        a regression as they are.

        Args:
            logits (torch.Tensor): What the model returned :math:`(B, C)`.
        """
        if self.task == "regression":
            return logits
        return logits.sigmoid() if self.task == "multilabel" else logits.softmax(dim=-1)


def _warn_of_scaling(checkpoint: Mapping[str, Any]) -> None:
    r"""Warns if the model of a checkpoint was trained on readings that fitted transforms, such as
    scalers, had changed.
    """
    names = fitted_names(checkpoint)
    if names:
        warnings.warn(
            f"this model was trained on readings that {', '.join(names)} transformed, but a module "
            "from a checkpoint has no transforms: for raw readings use "
            "Predictor.from_checkpoint(path); to test it, use "
            "trainer.test(module, datamodule=data, ckpt_path=path)",
            stacklevel=3,
        )


def fitted_names(checkpoint: Mapping[str, Any]) -> list[str]:
    r"""Returns the classes of the fitted transforms that a checkpoint holds for the predictor."""
    entry = checkpoint.get("predictor")
    header = entry.get("header") if isinstance(entry, Mapping) else None
    left = [header.get("transform")] if isinstance(header, Mapping) else []
    names = []
    while left:  # not by recursion, whose depth a received file could choose
        value = left.pop()
        if isinstance(value, Mapping):
            if value.get("state") and isinstance(value.get("class"), str):
                names.append(value["class"])
            left += reversed(list(value.values()))
        elif isinstance(value, list):
            left += reversed(value)
    return names
