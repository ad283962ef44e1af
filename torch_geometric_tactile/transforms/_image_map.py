r"""Finds taxels by their cells on the image map of a layout."""

import torch
from torch import Tensor

from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile.sensors import TaxelLayout, as_layout


def require_map(transform: object, layout: TaxelLayout | PathLike) -> tuple[TaxelLayout, Tensor]:
    r"""Returns a layout and its image map :math:`(N, 2)`: row and column of each taxel.

    Raises:
        ValueError: If the layout has no image map; the message names the transform.
    """
    layout = as_layout(layout)
    if layout.image_map is None:
        raise ValueError(
            f"{type(transform).__name__} needs a layout with an image map (got none in "
            f"'{layout.name}'); define a 'cell' for each taxel"
        )
    return layout, layout.image_map


def taxels_at(image_map: Tensor, cells: Tensor) -> Tensor:
    r"""Returns the number of the taxel in each cell; -1 for a cell without a taxel.

    Shapes:
        - **image_map:** Row and column of each taxel :math:`(N, 2)`.
        - **cells:** Rows and columns :math:`(M, 2)`, which may be outside the map.
        - **output:** taxel numbers :math:`(M,)`
    """
    width = int(image_map.max()) + 1
    taxel_codes, order = (image_map @ torch.tensor([width, 1])).sort()
    cell_codes = cells @ torch.tensor([width, 1])
    place = torch.searchsorted(taxel_codes, cell_codes).clamp(max=len(taxel_codes) - 1)
    # A cell outside the map may have the code of a cell in the next or previous row.
    is_taxel = (taxel_codes[place] == cell_codes) & ((cells >= 0) & (cells < width)).all(dim=1)
    return torch.where(is_taxel, order[place], -1)
