r"""Gains of fingers."""

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor
from torch_geometric.data import Data
from torch_geometric.data.datapipes import functional_transform
from torch_geometric.transforms import BaseTransform

from torch_geometric_tactile.sensors import TaxelLayout
from torch_geometric_tactile.transforms._attributes import require_x
from torch_geometric_tactile.transforms._random import check_deviation, normal
from torch_geometric_tactile.transforms._segments import Segments
from torch_geometric_tactile.typing import PathLike


@functional_transform("random_gain")
class RandomGain(BaseTransform):
    r"""Multiplies the readings of each segment, such as a finger, by a gain of its own in each
    sample and channel (functional name: :obj:`random_gain`), as an augmentation: a
    :obj:`train_transform`.

    .. math::
        x'_i = x_i \, e^{\sigma g}, \qquad g \sim \mathcal{N}(0, 1)

    A gain has a meaning where zero has: on readings that were tared, or scaled with their mean as
    zero.

    Args:
        std (float): Standard deviation :math:`\sigma` of the logarithm of the gains: about their
            relative deviation, while it is small.
        segments (str or sequence of int, optional): What has one in common: :obj:`"digit"` or
            :obj:`"patch"` of the layout, or a whole number for each taxel :math:`(N,)`; all taxels
            of a sample if left out.
        layout (TaxelLayout or str or PathLike, optional): The taxels: a layout, the name of one
            that comes with the package, or a layout file; needed for :obj:`"digit"` and
            :obj:`"patch"`.
        generator (torch.Generator, optional): The source of random numbers; PyTorch's own if left
            out.

    Shapes:
        - **input:** readings :math:`(N, F)`, :math:`(B, N, F)` or a PyG batch :math:`(B \cdot N,
          F)`
        - **output:** the same shape. Missing readings (NaN) stay missing.

    Raises:
        ValueError: If :obj:`std` is negative or not finite, :obj:`segments` is none of these or
            comes without a layout that it needs, or a sample has another number of taxels or no
            readings.

    Examples:
        >>> RandomGain(0.0)(Data(x=torch.ones(2, 1))).x.view(-1)
        tensor([1., 1.])
    """

    supports_static = True

    def __init__(
        self,
        std: float = 0.1,
        segments: str | Sequence[int] | Tensor | None = None,
        layout: TaxelLayout | PathLike | None = None,
        generator: torch.Generator | None = None,
    ) -> None:
        self.std = check_deviation(std)
        self.generator = generator
        self._segments = Segments(segments, layout)

    def arguments(self) -> dict[str, Any]:
        r"""Returns the arguments of the constructor; segments that were given are numbered anew."""
        rest = self._segments.arguments()
        return {"std": self.std, **rest, "generator": self.generator}

    def forward(self, data: Data) -> Data:
        r"""Multiplies by the gains."""
        x = require_x(self, data)
        x = x if x.is_floating_point() else x.float()  # counts may be integers
        segment, count = self._segments.of_rows(data, x)
        drawn = normal(count * x.size(-1), x, self.generator).view(count, x.size(-1))
        gain = (self.std * drawn).exp()
        data.x = x * gain[segment].view(x.shape).to(x)
        return data

    def __repr__(self) -> str:
        segments = f", {self._segments!r}" if self._segments.segment is not None else ""
        return f"{type(self).__name__}(std={self.std}{segments})"
