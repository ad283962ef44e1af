r"""A learning rate that rises and falls once in a training, step by step."""

from typing import Any

import lightning as L
from torch.optim.lr_scheduler import OneCycleLR

from torch_geometric_tactile._checks import need


class OneCycle(L.Callback):
    r"""Steps the learning rate through :class:`torch.optim.lr_scheduler.OneCycleLR`: up to the
    optimizer's own rate in the first third of the training steps, and down to nearly zero. The last
    weights are then the ones to use: no part has to be held out for early stopping.

    The scheduler of a configuration is stepped by epoch and has to know their number; this one asks
    the trainer.

    Args:
        part (float): Which part of the steps the rate rises in.

    Raises:
        ValueError: If :obj:`part` is not between 0 and 1, or the training has no known end.

    Examples:
        >>> OneCycle()
        OneCycle(part=0.3)
    """

    def __init__(self, part: float = 0.3) -> None:
        need(0 < part < 1, "'part' must be between 0 and 1", part)
        self.part = part
        self.scheduler: OneCycleLR | None = None

    def on_train_start(self, trainer: L.Trainer, pl_module: L.LightningModule) -> None:
        r"""Begins the cycle.

        Args:
            trainer (lightning.Trainer): The trainer.
            pl_module (lightning.LightningModule): What it trains.
        """
        steps = trainer.estimated_stepping_batches
        need(steps != float("inf"), "'max_epochs' must be given for OneCycle (got -1, no end)")
        (optimizer,) = trainer.optimizers
        rates = [group["lr"] for group in optimizer.param_groups]
        # It keeps the betas: cycling the momentum is of no use to Adam here.
        self.scheduler = OneCycleLR(
            optimizer, rates, int(steps), pct_start=self.part, cycle_momentum=False
        )

    def on_train_batch_end(self, trainer: L.Trainer, *_: Any) -> None:
        r"""Steps the rate.

        Args:
            trainer (lightning.Trainer): The trainer.
        """
        scheduler = self.scheduler
        if scheduler is not None and scheduler.last_epoch + 1 < scheduler.total_steps:
            scheduler.step()

    def __repr__(self) -> str:
        return f"{type(self).__name__}(part={self.part})"
