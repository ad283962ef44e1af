r"""Readings as images."""

from collections.abc import Sequence

import torch
from torch import Tensor
from torch.nn import Module

from torch_geometric_tactile.nn.models._inputs import check_no_edges
from torch_geometric_tactile.sensors import TaxelLayout


class TaxelImage(Module):
    r"""Puts the readings of the taxels into the cells of the map of their layout. Cells without a
    taxel are zero.

    Shapes:
        - **input:** readings :math:`(B, N, F)`
        - **output:** images :math:`(B, F, H, W)`; a view of readings of one channel if the
          taxels fill all cells row by row
    """

    cell: Tensor

    def __init__(self, layout: TaxelLayout) -> None:
        super().__init__()
        image_map = checked_map(layout, ())
        rows, columns = (image_map.amax(dim=0) + 1).tolist()
        cell = image_map[:, 0] * columns + image_map[:, 1]
        self.size = (rows, columns)
        self.is_full = torch.equal(cell, torch.arange(rows * columns))
        self.register_buffer("cell", cell, persistent=False)

    def forward(self, x: Tensor) -> Tensor:
        r"""Returns the images."""
        rows, columns = self.size
        image = x
        if not self.is_full:
            image = x.new_zeros(x.size(0), rows * columns, x.size(2)).index_copy(1, self.cell, x)
        return image.transpose(1, 2).reshape(-1, x.size(2), rows, columns)

    def __repr__(self) -> str:
        return f"{type(self).__name__}({len(self.cell)}, size={self.size})"


def checked_map(layout: TaxelLayout, inputs: Sequence[str]) -> Tensor:
    r"""Returns row and column of each taxel on the map of a hand :math:`(N, 2)`."""
    check_no_edges(inputs)
    if layout.image_map is None:
        raise ValueError(f"'layout' must have an image_map (got none in '{layout.name}')")
    return layout.image_map
