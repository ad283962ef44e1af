r"""Converts readings to images."""

from collections.abc import Sequence

import torch
from torch import Tensor
from torch.nn import Module

from torch_geometric_tactile.nn.models._inputs import check_no_edges
from torch_geometric_tactile.sensors import TaxelLayout


class TaxelImage(Module):
    r"""Converts readings to images on the image map of a layout. Cells without a taxel are zero.

    Args:
        layout (TaxelLayout): The layout.

    Shapes:
        - **input:** readings :math:`(B, N, F)`
        - **output:** images :math:`(B, F, H, W)`. For one channel, the images are a view of the
          readings if the taxels fill all cells row by row.
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
        r"""Returns the images.

        Args:
            x (torch.Tensor): Readings.
        """
        rows, columns = self.size
        image = x
        if not self.is_full:
            image = x.new_zeros(x.size(0), rows * columns, x.size(2)).index_copy(1, self.cell, x)
        return image.transpose(1, 2).reshape(-1, x.size(2), rows, columns)

    def __repr__(self) -> str:
        return f"{type(self).__name__}({len(self.cell)}, size={self.size})"


def checked_map(layout: TaxelLayout, inputs: Sequence[str]) -> Tensor:
    r"""Returns the row and column of each taxel on the image map of a layout :math:`(N, 2)`.

    Args:
        layout (TaxelLayout): The layout.
        inputs (sequence of str): Inputs of the model.

    Raises:
        ValueError: If the layout has no image map, or if edge features are an input.
    """
    check_no_edges(inputs)
    if layout.image_map is None:
        raise ValueError(f"'layout' must have an image_map (got none in '{layout.name}')")
    return layout.image_map
