r"""Sectors that are the neighbours in an image: there a convolution over sectors is one of images,
which PyTorch has been made fast for."""

from typing import NamedTuple, Optional

import torch
import torch.nn.functional as F
from torch import Tensor
from torch_geometric.typing import OptTensor


class SectorImage(NamedTuple):
    r"""Nodes that are the pixels of an image, row by row, and sectors that are its directions."""

    rows: int
    cols: int
    sectors: tuple[int, ...]
    places: tuple[int, ...]

    @classmethod
    def of(
        cls, source: Tensor, target: Tensor, sector: Tensor, num_nodes: int
    ) -> Optional["SectorImage"]:
        r"""Returns the image that nodes are, or :obj:`None` if they are none: if an edge runs to no
        direct neighbour, one is missing, or a sector holds two directions.
        """
        steps, sectors = {}, sector.unique().tolist()
        for number in sectors:
            step = (source - target)[sector == number]
            steps[number] = int(step[0])
            if bool((step != step[0]).any()):
                return None
        if not steps:
            return None
        widths = {abs(step) + near for step in steps.values() for near in (-1, 0, 1)}
        for cols in sorted({*widths, num_nodes}):  # a single row tells nothing of its length
            if cols > 2 and num_nodes % cols == 0:
                found = cls._of_width(steps, target, sector, num_nodes // cols, cols)
                if found is not None:
                    return found
        return None

    @classmethod
    def _of_width(
        cls, steps: dict[int, int], target: Tensor, sector: Tensor, rows: int, cols: int
    ) -> Optional["SectorImage"]:
        places = []
        for number, step in steps.items():
            down = round(step / cols)
            right = step - down * cols
            if abs(down) > 1 or abs(right) > 1:
                return None
            at = target[sector == number]
            row, col = at // cols + down, at % cols + right
            inside = (row >= 0) & (row < rows) & (col >= 0) & (col < cols)
            whole = (rows - abs(down)) * (cols - abs(right))
            if not bool(inside.all()) or len(at) != whole or len(at.unique()) != whole:
                return None
            places.append(3 * (down + 1) + right + 1)
        return cls(rows, cols, tuple(steps), tuple(places))

    def product(self, x: Tensor, weight: Tensor, bias: OptTensor) -> Tensor:
        r"""Maps each node by the first matrix and each of its neighbours by that of its sector, and
        adds up.

        Shapes:
            - **x:** Node features :math:`(B, N, F)`.
            - **weight:** The matrices :math:`(1 + S, F, O)`, of the node itself first.
            - **bias:** The biases :math:`(O,)`.
        """
        kernel = weight.new_zeros(9, *weight.shape[1:])
        used = torch.tensor([0, *(1 + sector for sector in self.sectors)])
        kernel = kernel.index_add(0, torch.tensor([4, *self.places]), weight[used])
        kernel = kernel.view(3, 3, *weight.shape[1:]).permute(3, 2, 0, 1)
        # Channels last: pixel by pixel, as nodes lie, so that nothing is copied.
        image = x.contiguous().view(len(x), self.rows, self.cols, -1).permute(0, 3, 1, 2)
        out = F.conv2d(image, kernel, bias, padding=1)
        return out.permute(0, 2, 3, 1).reshape(len(x), self.rows * self.cols, -1)
