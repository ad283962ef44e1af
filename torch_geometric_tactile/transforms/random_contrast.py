r"""Random changes of the contrast of grey images."""

import math

import torch
from torch import Tensor
from torch_geometric.data import Data
from torch_geometric.data.datapipes import functional_transform

from torch_geometric_tactile.transforms._random import RandomTransform, check_generator, uniform
from torch_geometric_tactile.transforms._segments import samples_of_rows, segment_means


@functional_transform("random_contrast")
class RandomContrast(RandomTransform):
    r"""Stretches the grey values of each sample about a centre by a random factor (functional name:
    :obj:`random_contrast`). Use this augmentation in a :obj:`train_transform`.

    .. math::
        x'_i = \min(\max(c + g \, (x_i - c), 0), 1), \qquad g \sim \mathcal{U}(low, high)

    Grey values lie between 0 and 1 before and after the transform. The paper of the letter array
    mentions contrast enhancement but gives no formula; this formula is our choice.

    Args:
        low (float): The smallest factor :math:`g`.
        high (float): The largest factor; factors above one enhance the contrast.
        center (float, optional): The grey value :math:`c` that does not change. The default is the
            mean of each sample and channel, which keeps the dark background of a small contact
            dark.
        generator (torch.Generator, optional): The random number generator. If left out,
            PyTorch's default generator is used.

    Shapes:
        - **input:** readings :math:`(N, F)`, :math:`(B, N, F)` or a PyG batch :math:`(B \cdot N,
          F)`
        - **output:** the same shape. Missing readings (NaN) stay missing and are left out of the
          mean.

    Raises:
        ValueError: If the factors are negative, not finite or in the wrong order, :obj:`center` is
            not finite, or there are no readings.

    Examples:
        >>> transform = RandomContrast(2.0, 2.0)
        >>> transform(Data(x=torch.tensor([[0.0], [0.25], [0.5]]))).x.view(-1)
        tensor([0.0000, 0.2500, 0.7500])
    """

    def __init__(
        self,
        low: float = 1.0,
        high: float = 1.5,
        center: float | None = None,
        generator: torch.Generator | None = None,
    ) -> None:
        if not 0 <= low <= high < math.inf:
            raise ValueError(
                f"'low' must be at least 0 and at most 'high', both finite (got {low} and {high})"
            )
        if center is not None and not math.isfinite(center):
            raise ValueError(f"'center' must be a grey value or None (got {center})")
        self.low = float(low)
        self.high = float(high)
        self.center = None if center is None else float(center)
        self.generator = check_generator(generator)

    def changed(self, data: Data, x: Tensor) -> Tensor:
        r"""Returns the stretched readings."""
        sample, count = samples_of_rows(data, x)
        factor = self.low + (self.high - self.low) * uniform(count, x, self.generator)
        rows = x.reshape(-1, x.size(-1))
        center: Tensor | float | None = self.center
        if center is None:
            center = segment_means(rows.double(), sample, count)[sample]
        stretched = center + factor.to(x)[sample].unsqueeze(1) * (rows - center)
        return stretched.to(x).clamp(0, 1).reshape(x.shape)
