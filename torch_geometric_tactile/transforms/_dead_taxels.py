r"""The base class of transforms that simulate dead taxels."""

from typing import Any

import torch
from torch import Tensor
from torch_geometric.data import Data

from torch_geometric_tactile.transforms._attributes import add_mark, require_x
from torch_geometric_tactile.transforms._random import check_probability, uniform
from torch_geometric_tactile.transforms.tactile_transform import TactileTransform

_P = 0.1


class DeadTaxels(TactileTransform):
    r"""Sets the readings of some taxels to a value and marks them as :obj:`dropped`.

    Args:
        p (float, optional): Probability to drop each.
        chosen (object, optional): What is dropped always, in place of :obj:`p`. If both are left
            out, :obj:`p` is 0.1.
        chosen_name (str): The name of the argument :obj:`chosen`, for messages.
        value (float): The reading of a dead taxel.
        generator (torch.Generator, optional): The source of random numbers.
    """

    reads = writes = ("x", "dropped")
    per_frame = True

    @property
    def is_random(self) -> bool:
        r"""Whether taxels are drawn, and not chosen."""
        return self.p is not None

    def __init__(
        self,
        p: float | None,
        chosen: Any,
        chosen_name: str,
        value: float,
        generator: torch.Generator | None,
    ) -> None:
        if p is not None and chosen is not None:
            raise ValueError(f"only one of 'p' and '{chosen_name}' may be given (got both)")
        self.p = None if chosen is not None else check_probability(_P if p is None else p)
        self.value = float(value)
        self.generator = generator

    def draw(self, count: int, x: Tensor) -> Tensor:
        r"""Returns which of some things are dropped, each with the probability :obj:`p`.

        Args:
            count (int): Their number.
            x (torch.Tensor): The readings, for the device.

        Shapes:
            - **output:** booleans :math:`(count,)`, the same for one seed however samples are
              arranged
        """
        assert self.p is not None
        return uniform(count, x, self.generator) < self.p

    def dead(self, data: Data, x: Tensor) -> Tensor:
        r"""Returns which taxels are dropped.

        Args:
            data (torch_geometric.data.Data): The data.
            x (torch.Tensor): Its readings :math:`(N, F)` or :math:`(B, N, F)`.

        Shapes:
            - **output:** booleans :math:`(N,)` or :math:`(B, N)`
        """
        raise NotImplementedError

    def forward(self, data: Data) -> Data:
        r"""Sets :obj:`x` and :obj:`dropped`."""
        x = require_x(self, data)
        dead = self.dead(data, x)
        x = x if x.is_floating_point() else x.float()  # counts may be integers
        data.x = x.masked_fill(dead.unsqueeze(-1), self.value)
        add_mark(data, "dropped", dead)
        return data
