r"""The base class of transforms that simulate dead taxels."""

from typing import Any

import torch
from torch import Tensor
from torch_geometric.data import Data

from torch_geometric_tactile.transforms._attributes import add_mark, require_floats
from torch_geometric_tactile.transforms._random import check_generator, check_probability, uniform
from torch_geometric_tactile.transforms.tactile_transform import TactileTransform

_DEFAULT_P = 0.1


class DeadTaxels(TactileTransform):
    r"""The base class of transforms that set the readings of taxels to a value and mark these
    taxels as :obj:`dropped`. The taxels are drawn, or selected by the user.

    Args:
        p (float, optional): The probability of a draw; 0.1 if :obj:`selection` is left out as well.
        selection (Any, optional): The selection that replaces the draw.
        selection_name (str): Name of the argument of the subclass that holds the selection.
        value (float): The reading of a dead taxel.
        generator (torch.Generator, optional): The source of random numbers.

    Raises:
        ValueError: If :obj:`p` is not a probability, or both :obj:`p` and :obj:`selection` are
            given.
    """

    reads = writes = ("x", "dropped")
    per_frame = True

    @property
    def is_random(self) -> bool:
        r"""Whether taxels are drawn at random, not selected by the user."""
        return self.p is not None

    def __init__(
        self,
        p: float | None,
        selection: Any,
        selection_name: str,
        value: float,
        generator: torch.Generator | None,
    ) -> None:
        if p is not None and selection is not None:
            raise ValueError(f"only one of 'p' and '{selection_name}' may be given (got both)")
        self.p = (
            None if selection is not None else check_probability(_DEFAULT_P if p is None else p)
        )
        self.value = float(value)
        self.generator = check_generator(generator)

    def draw(self, count: int, x: Tensor) -> Tensor:
        r"""Draws booleans that are true with the probability :obj:`p`.

        Args:
            count (int): Number of booleans.
            x (torch.Tensor): The readings; the output is on the same device.

        Shapes:
            - **output:** :math:`(count,)`
        """
        assert self.p is not None
        return uniform(count, x, self.generator) < self.p

    def dead(self, data: Data, x: Tensor) -> Tensor:
        r"""Returns which taxels are dropped.

        Args:
            data (torch_geometric.data.Data): The samples.
            x (torch.Tensor): Readings :math:`(N, F)` or :math:`(B, N, F)`.

        Shapes:
            - **output:** booleans :math:`(N,)` or :math:`(B, N)`
        """
        raise NotImplementedError

    def forward(self, data: Data) -> Data:
        r"""Sets :obj:`x` and :obj:`dropped`."""
        x = require_floats(self, data)
        is_dead = self.dead(data, x)
        data.x = x.masked_fill(is_dead.unsqueeze(-1), self.value)
        add_mark(data, "dropped", is_dead)
        return data
