r"""Random inversion of grey images."""

import math

import torch
from torch import Tensor
from torch_geometric.data import Data
from torch_geometric.data.datapipes import functional_transform

from torch_geometric_tactile.transforms._random import (
    RandomTransform,
    check_generator,
    check_probability,
    uniform,
)
from torch_geometric_tactile.transforms._segments import samples_of_rows


@functional_transform("random_inversion")
class RandomInversion(RandomTransform):
    r"""Inverts the grey values of randomly drawn samples, so that black becomes white (functional
    name: :obj:`random_inversion`). Use this augmentation in a :obj:`train_transform`.

    .. math::
        x'_i = low + high - x_i

    The "A Novel Bilinear Feature and Multi-Layer Fused Convolutional Neural Network for Tactile
    Shape Recognition" paper (Sensors 2020, 20, 5822) does not define its "random inversion". This
    transform is one interpretation; :class:`RandomMirror` is another. Here, taxels at rest get the
    highest grey value, which does not happen on a real sensor.

    Args:
        p (float): Probability with which each sample is inverted, in all channels.
        low (float): The lowest grey value.
        high (float): The highest grey value.
        generator (torch.Generator, optional): The random number generator. If left out,
            PyTorch's default generator is used.

    Shapes:
        - **input:** readings :math:`(N, F)`, :math:`(B, N, F)` or a PyG batch :math:`(B \cdot N,
          F)`
        - **output:** the same shape. Missing readings (NaN) stay missing.

    Raises:
        ValueError: If :obj:`p` is not a probability, :obj:`low` is not below :obj:`high`, or there
            are no readings.

    Examples:
        >>> RandomInversion(p=1.0)(Data(x=torch.tensor([[0.0], [0.25]]))).x.view(-1)
        tensor([1.0000, 0.7500])
    """

    def __init__(
        self,
        p: float = 0.5,
        low: float = 0.0,
        high: float = 1.0,
        generator: torch.Generator | None = None,
    ) -> None:
        if not -math.inf < low < high < math.inf:
            raise ValueError(f"'low' must be below 'high', both finite (got {low} and {high})")
        self.p = check_probability(p)
        self.low = float(low)
        self.high = float(high)
        self.generator = check_generator(generator)

    def changed(self, data: Data, x: Tensor) -> Tensor:
        r"""Returns the readings, inverted in the drawn samples."""
        sample, count = samples_of_rows(data, x)
        is_inverted = (uniform(count, x, self.generator) < self.p)[sample]
        inverted = self.low + self.high - x
        return torch.where(is_inverted.view(*x.shape[:-1], 1), inverted, x)
