r"""Means of weights over the last steps of a training, and where the training should end."""

from collections.abc import Callable
from typing import Any, NamedTuple

import lightning as L
import torch
from torch import Tensor
from torch.optim.swa_utils import get_ema_multi_avg_fn

from torch_geometric_tactile.training.predictions import Predictions, collect_predictions

_DECAY = 0.99  # of the last hundred steps, about


class AveragedWeights(L.Callback):
    r"""Keeps an exponential mean of the weights and of the running statistics, and takes it over at
    the end of the training: what a decaying learning rate does, without knowing the end before.

    Args:
        decay (float): How much of the mean is kept in a step, after the first steps.
    """

    def __init__(self, decay: float = _DECAY) -> None:
        self.decay = decay
        self._steps = 0
        self._mean: dict[str, Tensor] = {}
        self._state: dict[str, Tensor] = {}

    def on_train_batch_end(self, trainer: L.Trainer, pl_module: Any, *_: Any) -> None:
        r"""Adds the weights of a step."""
        decay = min(self.decay, (1 + self._steps) / (10 + self._steps))
        self._steps += 1
        if not self._mean:
            # A state's tensors stay the same in training: to look them up in each step would take a
            # tenth of the time of a small model.
            self._state = pl_module.model.state_dict()
            self._mean = {name: value.clone() for name, value in self._state.items()}
        moving = [name for name, value in self._mean.items() if value.is_floating_point()]
        average = get_ema_multi_avg_fn(decay)
        average([self._mean[name] for name in moving], [self._state[name] for name in moving], 1)
        for name in self._mean.keys() - moving:  # numbers of batches
            self._mean[name].copy_(self._state[name])

    def swap(self, pl_module: Any) -> None:
        r"""Exchanges the weights of a model with their mean.

        Args:
            pl_module (TactileClassifier): What trains the model.
        """
        now = {name: value.clone() for name, value in pl_module.model.state_dict().items()}
        pl_module.model.load_state_dict(self._mean)
        self._mean = now

    def on_train_end(self, trainer: L.Trainer, pl_module: Any) -> None:
        r"""Takes over the mean."""
        if self._mean:
            self.swap(pl_module)


class Scored(NamedTuple):
    r"""A score, the higher the better, the loss that decides between equals, and after how many
    epochs they were reached; 0 for models without epochs.
    """

    value: float
    loss: float = 0.0
    epochs: int = 0

    def is_better_than(self, other: "Scored") -> bool:
        r"""Whether the score is higher, or equal at a lower loss.

        Args:
            other (Scored): The other.
        """
        return (self.value, -self.loss) > (other.value, -other.loss)


class EarlyEnd(L.Callback):
    r"""Scores the mean of the weights on a validation part after each epoch, and ends the training
    when the score has not improved for some epochs.

    Args:
        batches (iterable): The validation part.
        average (AveragedWeights): The mean.
        score (callable): Value and loss of :class:`~torch_geometric_tactile.training.Predictions`.
        patience (int): For how many epochs.
    """

    def __init__(
        self,
        batches: Any,
        average: AveragedWeights,
        score: Callable[[Predictions], tuple[float, float]],
        patience: int,
    ) -> None:
        self.batches = batches
        self.average = average
        self.score = score
        self.patience = patience
        self.best = Scored(float("-inf"), float("inf"))

    def on_train_epoch_end(self, trainer: L.Trainer, pl_module: Any) -> None:
        r"""Scores an epoch."""
        self.average.swap(pl_module)
        try:
            with torch.inference_mode():
                said = collect_predictions(pl_module, self.batches)
        finally:
            self.average.swap(pl_module)
        found = Scored(*self.score(said), trainer.current_epoch + 1)
        if found.is_better_than(self.best):
            self.best = found
        trainer.should_stop = found.epochs - self.best.epochs >= self.patience
