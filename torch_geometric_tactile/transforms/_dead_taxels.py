r"""The base class of transforms that simulate dead taxels."""

from typing import Any

import torch
from torch import Tensor
from torch_geometric.data import Data

from torch_geometric_tactile.transforms._attributes import add_mark, require_floats
from torch_geometric_tactile.transforms._random import check_generator, check_probability, uniform
from torch_geometric_tactile.transforms.tactile_transform import TactileTransform

_P = 0.1


class DeadTaxels(TactileTransform):
    r"""Sets the readings of some taxels, drawn or :obj:`chosen`, to a value and marks them as
    :obj:`dropped`.
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
        self.generator = check_generator(generator)

    def draw(self, count: int, x: Tensor) -> Tensor:
        r"""Returns which of some things are dropped, each with the probability :obj:`p`.

        Shapes:
            - **output:** booleans :math:`(count,)`
        """
        assert self.p is not None
        return uniform(count, x, self.generator) < self.p

    def dead(self, data: Data, x: Tensor) -> Tensor:
        r"""Returns which taxels are dropped.

        Shapes:
            - **x:** Readings :math:`(N, F)` or :math:`(B, N, F)`.
            - **output:** booleans :math:`(N,)` or :math:`(B, N)`
        """
        raise NotImplementedError

    def forward(self, data: Data) -> Data:
        r"""Sets :obj:`x` and :obj:`dropped`."""
        x = require_floats(self, data)
        dead = self.dead(data, x)
        data.x = x.masked_fill(dead.unsqueeze(-1), self.value)
        add_mark(data, "dropped", dead)
        return data
