r"""Cosine annealing of the learning rate over all epochs of a run."""

from typing import Any

from torch.optim import Optimizer
from torch.optim.lr_scheduler import CosineAnnealingLR

from torch_geometric_tactile._checks import need


class CosineAnnealing(CosineAnnealingLR):
    r"""A scheduler that decreases the learning rate along half a cosine over all epochs of the run.

    It is a :class:`torch.optim.lr_scheduler.CosineAnnealingLR` that takes :obj:`T_max` from the
    trainer. In PyTorch's class, the learning rate rises again after :obj:`T_max` epochs.

    Args:
        optimizer (torch.optim.Optimizer): The optimizer.
        T_max (int, optional): Number of epochs. Defaults to the trainer's :obj:`max_epochs`.
        eta_min (float): Learning rate after the last epoch.

    Raises:
        ValueError: If :obj:`T_max` is below 1.

    Examples:
        >>> import torch
        >>> optimizer = torch.optim.SGD([torch.nn.Parameter(torch.zeros(1))], lr=1.0)
        >>> scheduler = CosineAnnealing(optimizer)
        >>> scheduler.follow(max_epochs=2)
        >>> optimizer.step(); scheduler.step(); round(scheduler.get_last_lr()[0], 6)
        0.5
    """

    def __init__(
        self,
        optimizer: Optimizer,
        T_max: int | None = None,  # noqa: N803 - PyTorch's name
        eta_min: float = 0.0,
    ) -> None:
        need(T_max is None or T_max >= 1, "'T_max' must be at least 1", T_max)
        self.follows_run = T_max is None
        super().__init__(optimizer, 1 if T_max is None else T_max, eta_min)

    def follow(self, max_epochs: int | None) -> None:
        r"""Sets the number of epochs of the run, unless :obj:`T_max` was given.

        Args:
            max_epochs (int, optional): The trainer's number of epochs.

        Raises:
            ValueError: If the number is needed but not given.
        """
        if not self.follows_run:
            return
        if max_epochs is None or max_epochs < 1:
            raise ValueError(
                "'max_epochs' must be given for CosineAnnealing without 'T_max' (got "
                f"{max_epochs}, no end)"
            )
        self.T_max = max_epochs

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        r"""Restores the state from a checkpoint, except the number of epochs of its run.

        Args:
            state_dict (dict): The state of another scheduler of this class.
        """
        run_length = {"T_max": self.T_max, "follows_run": self.follows_run}
        super().load_state_dict({**state_dict, **(run_length if self.follows_run else {})})
