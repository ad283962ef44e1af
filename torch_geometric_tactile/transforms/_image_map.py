r"""Taxels on a two-dimensional map, and where a step on it leads."""

import torch
from torch import Tensor

from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile.sensors import TaxelLayout, as_layout


def require_map(transform: object, layout: TaxelLayout | PathLike) -> tuple[TaxelLayout, Tensor]:
    r"""Returns a layout and its image map."""
    layout = as_layout(layout)
    if layout.image_map is None:
        raise ValueError(
            f"{type(transform).__name__} needs a layout with an image map (got none in "
            f"'{layout.name}'); give each taxel a 'cell'"
        )
    return layout, layout.image_map


def taxels_at(image_map: Tensor, cells: Tensor) -> Tensor:
    r"""Returns the number of the taxel in each cell, -1 where there is none.

    Shapes:
        - **image_map:** Row and column of each taxel :math:`(N, 2)`.
        - **cells:** Rows and columns :math:`(M, 2)`, also beyond the map.
        - **output:** taxels :math:`(M,)`
    """
    width = int(image_map.max()) + 1
    codes, order = (image_map @ torch.tensor([width, 1])).sort()
    wanted = cells @ torch.tensor([width, 1])
    place = torch.searchsorted(codes, wanted).clamp(max=len(codes) - 1)
    is_there = (codes[place] == wanted) & ((cells >= 0) & (cells < width)).all(dim=1)
    return torch.where(is_there, order[place], -1)
