r"""A study of losses, accuracy and gradients during training."""

import statistics
from typing import Any

import lightning as L
import torch
from torch.nn import functional as F

from torch_geometric_tactile.experiments.studies import Study, Trained
from torch_geometric_tactile.training._predictions import collect_predictions

_QUANTILES = (0.05, 0.25, 0.5, 0.75, 0.95)


class TrainingHistory(Study):
    r"""Records losses and accuracy after every epoch, and the size of the gradients of each layer.
    These numbers are not used for any selection. The losses are cross entropies. The training loss
    is the mean over the batches of an epoch.

    The size of a gradient is its root mean square over the weights of the layer, which is one
    number per step. The study records the 0.05, 0.25, 0.5, 0.75 and 0.95 quantiles over all steps.
    """

    def __init__(self) -> None:
        self._recorder: _Recorder | None = None

    def callback(self, data: Any) -> L.Callback:
        r"""Returns the callback that records losses, accuracy and gradients during training."""
        self._recorder = _Recorder(data)
        return self._recorder

    def measure(self, trained: Trained) -> dict[str, Any] | None:
        r"""Returns :obj:`train_loss`, :obj:`test_loss` and :obj:`test_accuracy` (one number per
        epoch), and :obj:`gradients` (the quantiles for each layer).
        """
        if self._recorder is None or not trained.is_network:
            return None
        return self._recorder.history()


class _Recorder(L.Callback):
    def __init__(self, data: Any) -> None:
        self._data = data
        self._epoch: dict[str, list[float]] = {
            "train_loss": [],
            "test_loss": [],
            "test_accuracy": [],
        }
        self._losses: list[float] = []
        self._gradients: dict[str, list[float]] = {}

    def on_train_batch_end(
        self, trainer: L.Trainer, pl_module: L.LightningModule, outputs: Any, *args: Any
    ) -> None:
        self._losses.append(float(outputs["loss"]))

    def on_before_optimizer_step(
        self, trainer: L.Trainer, pl_module: L.LightningModule, optimizer: Any
    ) -> None:
        for name, weight in pl_module.named_parameters():
            # Only matrices are recorded, since gradients of biases have a different scale.
            if weight.dim() > 1 and weight.grad is not None:
                layer = name.removeprefix("model.").rpartition(".")[0] or name
                size = float(weight.grad.detach().square().mean().sqrt())
                self._gradients.setdefault(layer, []).append(size)

    def on_train_epoch_end(self, trainer: L.Trainer, pl_module: L.LightningModule) -> None:
        outputs = collect_predictions(pl_module, self._data.test_dataloader())  # type: ignore[arg-type]
        is_correct = outputs.probability.argmax(dim=1) == outputs.y
        self._epoch["train_loss"].append(statistics.fmean(self._losses))
        self._epoch["test_loss"].append(float(F.cross_entropy(outputs.logits, outputs.y)))
        self._epoch["test_accuracy"].append(float(is_correct.double().mean()))
        self._losses = []

    def history(self) -> dict[str, Any]:
        quantiles = torch.tensor(_QUANTILES)
        gradients = {
            layer: torch.tensor(sizes).quantile(quantiles).tolist()
            for layer, sizes in self._gradients.items()
        }
        return {**self._epoch, "gradients": gradients}
