r"""A callback with the one-cycle learning rate policy."""

from typing import Any

import lightning as L
from torch.optim.lr_scheduler import OneCycleLR

from torch_geometric_tactile._checks import need


class OneCycle(L.Callback):
    r"""A callback that updates the learning rate after every step with
    :class:`torch.optim.lr_scheduler.OneCycleLR`. The rate rises to the optimizer's learning rate in
    the first part of the training steps, and then falls to nearly zero. The last weights can be
    used directly, so that no data has to be held out for early stopping.

    A scheduler in a configuration is stepped once per epoch and needs the number of epochs in
    advance. This callback takes the number of steps from the trainer instead.

    Args:
        part (float): Fraction of the steps in which the learning rate rises.

    Raises:
        ValueError: If :obj:`part` is not between 0 and 1, or the number of steps is not limited.

    Examples:
        >>> OneCycle()
        OneCycle(part=0.3)
    """

    def __init__(self, part: float = 0.3) -> None:
        need(0 < part < 1, "'part' must be between 0 and 1", part)
        self.part = part
        self.scheduler: OneCycleLR | None = None

    def on_train_start(self, trainer: L.Trainer, pl_module: L.LightningModule) -> None:
        r"""Builds the scheduler at the start of the training.

        Args:
            trainer (lightning.Trainer): The trainer.
            pl_module (lightning.LightningModule): The module to train.
        """
        num_steps = trainer.estimated_stepping_batches
        need(num_steps != float("inf"), "'max_epochs' must be given for OneCycle (got -1, no end)")
        (optimizer,) = trainer.optimizers
        rates = [group["lr"] for group in optimizer.param_groups]
        # Adam's betas stay constant: cycling the momentum brought no gain.
        self.scheduler = OneCycleLR(
            optimizer, rates, int(num_steps), pct_start=self.part, cycle_momentum=False
        )

    def on_train_batch_end(self, trainer: L.Trainer, *_: Any) -> None:
        r"""Updates the learning rate.

        Args:
            trainer (lightning.Trainer): The trainer.
        """
        scheduler = self.scheduler
        if scheduler is not None and scheduler.last_epoch + 1 < scheduler.total_steps:
            scheduler.step()

    def __repr__(self) -> str:
        return f"{type(self).__name__}(part={self.part})"
