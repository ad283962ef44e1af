r"""Shifted images of taxels."""

import torch
from torch import Tensor
from torch_geometric.data import Data
from torch_geometric.data.datapipes import functional_transform

from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile.sensors import TaxelLayout
from torch_geometric_tactile.transforms._attributes import check_num_taxels
from torch_geometric_tactile.transforms._image_map import require_map, taxels_at
from torch_geometric_tactile.transforms._random import (
    RandomTransform,
    check_generator,
    check_whole,
    uniform,
)

_MOST_STEPS = 100


@functional_transform("random_shift")
class RandomShift(RandomTransform):
    r"""Shifts the image of the taxels of each sample by a random number of cells (functional name:
    :obj:`random_shift`), as an augmentation: a :obj:`train_transform`. Each taxel takes the reading
    of the taxel that many rows and columns away on the image map of the layout.

    On a hand the cells of other patches are neighbours, too: it is meant for grids.

    Args:
        layout (TaxelLayout or str or PathLike): The taxels, with an image map: a layout, the name
            of one that comes with the package, or a layout file.
        rows (int): By how many rows at most, in either direction; all from none to these are drawn
            equally often.
        columns (int): By how many columns at most, likewise.
        value (float): What taxels read that nothing is shifted to: that of rest. Behind a scaler or
            a tare, zero is the mean or rest of a taxel.
        generator (torch.Generator, optional): The source of random numbers; PyTorch's own if left
            out.

    Shapes:
        - **input:** readings :math:`(N, F)`, :math:`(B, N, F)` or a PyG batch :math:`(B \cdot N,
          F)`
        - **output:** the same shape. Missing readings (NaN) stay missing.

    Raises:
        ValueError: If the layout has no image map, :obj:`rows` or :obj:`columns` is not 0 to 100,
            or a sample has another number of taxels or no readings.

    Examples:
        >>> from torch_geometric_tactile.sensors import grid
        >>> transform = RandomShift(grid(1, 3, 0.01), rows=0, columns=0)
        >>> transform(Data(x=torch.tensor([[1.0], [2.0], [3.0]]))).x.view(-1)
        tensor([1., 2., 3.])
    """

    def __init__(
        self,
        layout: TaxelLayout | PathLike,
        rows: int = 1,
        columns: int = 1,
        value: float = 0.0,
        generator: torch.Generator | None = None,
    ) -> None:
        self.rows = check_whole("rows", rows, 0, _MOST_STEPS)
        self.columns = check_whole("columns", columns, 0, _MOST_STEPS)
        self.layout, self._map = require_map(self, layout)
        self.value = float(value)
        self.generator = check_generator(generator)

    def changed(self, data: Data, x: Tensor) -> Tensor:
        r"""Shifts the readings."""
        num_taxels = self.layout.num_taxels
        check_num_taxels(data, num_taxels, f"layout '{self.layout.name}'")
        rows = x.reshape(-1, num_taxels, x.size(-1))
        counts = torch.tensor([2 * self.rows + 1, 2 * self.columns + 1])
        drawn = uniform(2 * len(rows), x, self.generator).cpu().view(-1, 2)
        steps = torch.minimum((drawn * counts).long(), counts - 1) - counts // 2
        kinds, number = steps.unique(dim=0, return_inverse=True)
        source = self._sources(kinds).to(x.device)[number.to(x.device)].unsqueeze(-1)
        moved = rows.gather(1, source.clamp(min=0).expand_as(rows))
        return moved.masked_fill(source < 0, self.value).reshape(x.shape)

    def _sources(self, steps: Tensor) -> Tensor:
        # The taxel whose reading each one takes, for each of some steps; -1 where there is none.
        cells = self._map - steps.unsqueeze(1)
        return taxels_at(self._map, cells.view(-1, 2)).view(len(steps), len(self._map))
