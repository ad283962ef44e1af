r"""Random shifts of the images of taxels."""

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
    check_integer,
    uniform,
)

_MAX_STEPS = 100


@functional_transform("random_shift")
class RandomShift(RandomTransform):
    r"""Shifts the taxel image of each sample by a random number of cells (functional name:
    :obj:`random_shift`). Each taxel gets the reading of the taxel that is this number of rows and
    columns away on the image map of the layout. Use this augmentation in a :obj:`train_transform`.

    The transform is meant for grids: on the image map of a hand, cells of different patches are
    neighbours.

    Args:
        layout (TaxelLayout or str or PathLike): The taxels, with an image map: a layout, the name
            of a layout of this package, or a layout file.
        rows (int): The largest shift in rows, in both directions. All shifts are equally likely.
        columns (int): The largest shift in columns, in both directions.
        value (float): The reading of taxels that get no shifted reading. It should be the reading
            at rest: zero after a tare. After a scaler, zero is the mean of a taxel.
        generator (torch.Generator, optional): The random number generator. If left out,
            PyTorch's default generator is used.

    Shapes:
        - **input:** readings :math:`(N, F)`, :math:`(B, N, F)` or a PyG batch :math:`(B \cdot N,
          F)`
        - **output:** the same shape. Missing readings (NaN) stay missing.

    Raises:
        ValueError: If the layout has no image map, :obj:`rows` or :obj:`columns` is not between 0
            and 100, or a sample has the wrong number of taxels or no readings.

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
        self.rows = check_integer("rows", rows, 0, _MAX_STEPS)
        self.columns = check_integer("columns", columns, 0, _MAX_STEPS)
        self.layout, self._map = require_map(self, layout)
        self.value = float(value)
        self.generator = check_generator(generator)

    def changed(self, data: Data, x: Tensor) -> Tensor:
        r"""Returns the shifted readings."""
        num_taxels = self.layout.num_taxels
        check_num_taxels(data, num_taxels, f"layout '{self.layout.name}'")
        rows = x.reshape(-1, num_taxels, x.size(-1))
        counts = torch.tensor([2 * self.rows + 1, 2 * self.columns + 1])
        draws = uniform(2 * len(rows), x, self.generator).cpu().view(-1, 2)
        # The product may be rounded up to `counts`, which is not a valid step.
        steps = torch.minimum((draws * counts).long(), counts - 1) - counts // 2
        # There are few different steps, so the source taxels are looked up once for each step.
        different_steps, number = steps.unique(dim=0, return_inverse=True)
        source = (
            self._source_taxels(different_steps).to(x.device)[number.to(x.device)].unsqueeze(-1)
        )
        shifted = rows.gather(1, source.clamp(min=0).expand_as(rows))
        return shifted.masked_fill(source < 0, self.value).reshape(x.shape)

    def _source_taxels(self, steps: Tensor) -> Tensor:
        # Returns, for each step, the taxel whose reading each taxel gets (K, N); -1 if there is
        # none.
        cells = self._map - steps.unsqueeze(1)
        return taxels_at(self._map, cells.view(-1, 2)).view(len(steps), len(self._map))
