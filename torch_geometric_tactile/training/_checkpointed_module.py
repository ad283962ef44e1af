r"""What a module writes into its checkpoints, and takes from them."""

from collections.abc import Mapping
from typing import Any, Self

from torch import nn

from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile.data import StaticDataset
from torch_geometric_tactile.predictor import checkpoint_entry, model_entry
from torch_geometric_tactile.sensors import TaxelLayout
from torch_geometric_tactile.training._bare_model import warn_of_scaling
from torch_geometric_tactile.training._resume import ResumableModule
from torch_geometric_tactile.training.checkpoint import load_module
from torch_geometric_tactile.training.metrics import Task


class CheckpointedModule(ResumableModule):
    r"""A module whose checkpoints carry the layout of the sensor and what a predictor needs, and
    are read without running what is in them.
    """

    model: nn.Module
    task: Task
    layout: TaxelLayout | None
    decision_threshold: float | None
    #: The configuration that the module was built from: checkpoints keep it to be compared.
    config: Mapping[str, Any] | None = None

    def arguments(self) -> dict[str, Any]:
        r"""Returns the arguments of the constructor, but for model, optimizer and scheduler, that
        checkpoints keep: plain values.
        """
        raise NotImplementedError

    def on_save_checkpoint(self, checkpoint: dict[str, Any]) -> None:
        r"""Puts into the checkpoint the layout, the description of the model, and what
        :class:`~torch_geometric_tactile.predictor.Predictor` needs beside the weights.
        """
        super().on_save_checkpoint(checkpoint)
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
        super().on_load_checkpoint(checkpoint)
        if self._trainer is None:
            warn_of_scaling(checkpoint)
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
