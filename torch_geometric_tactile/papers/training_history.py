r"""How a network of a table learnt."""

import statistics
from typing import Any

import lightning as L
import torch
from torch.nn import functional as F

from torch_geometric_tactile.experiments.studies import Study, Trained
from torch_geometric_tactile.training._predictions import collect_predictions

_QUANTILES = (0.05, 0.25, 0.5, 0.75, 0.95)


class TrainingHistory(Study):
    r"""Records losses and accuracy after every epoch, and how large the gradients of each layer
    are. Nothing is chosen by them. The losses are cross entropies, that of the training is the mean
    over the batches of an epoch.

    The gradient of a layer is its root mean square over the weights of the layer, one number a
    step; of all steps, the quantiles 0.05, 0.25, 0.5, 0.75 and 0.95 are kept.
    """

    def __init__(self) -> None:
        self._watch: _Watch | None = None

    def callback(self, data: Any) -> L.Callback:
        r"""Returns what watches the training."""
        self._watch = _Watch(data)
        return self._watch

    def measure(self, trained: Trained) -> dict[str, Any] | None:
        r"""Returns :obj:`train_loss`, :obj:`test_loss`, :obj:`test_accuracy` (one number an epoch)
        and :obj:`gradients`, the quantiles of each layer.
        """
        if self._watch is None or not trained.is_network:
            return None
        return self._watch.found()


class _Watch(L.Callback):
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
            if weight.dim() > 1 and weight.grad is not None:
                layer = name.removeprefix("model.").rpartition(".")[0] or name
                size = float(weight.grad.detach().square().mean().sqrt())
                self._gradients.setdefault(layer, []).append(size)

    def on_train_epoch_end(self, trainer: L.Trainer, pl_module: L.LightningModule) -> None:
        said = collect_predictions(pl_module, self._data.test_dataloader())  # type: ignore[arg-type]
        right = said.probability.argmax(dim=1) == said.y
        self._epoch["train_loss"].append(statistics.fmean(self._losses))
        self._epoch["test_loss"].append(float(F.cross_entropy(said.logits, said.y)))
        self._epoch["test_accuracy"].append(float(right.double().mean()))
        self._losses = []

    def found(self) -> dict[str, Any]:
        wanted = torch.tensor(_QUANTILES)
        gradients = {
            layer: torch.tensor(sizes).quantile(wanted).tolist()
            for layer, sizes in self._gradients.items()
        }
        return {**self._epoch, "gradients": gradients}
