r"""Random noise on the readings."""

import torch
from torch import Tensor
from torch_geometric.data import Data
from torch_geometric.data.datapipes import functional_transform

from torch_geometric_tactile.transforms._random import (
    RandomTransform,
    check_deviation,
    check_generator,
    normal,
)


@functional_transform("random_noise")
class RandomNoise(RandomTransform):
    r"""Adds independent normal noise to each reading (functional name: :obj:`random_noise`). Use
    this augmentation in a :obj:`train_transform`.

    Args:
        std (float): Standard deviation of the noise in the unit of the readings; after a scaler, in
            standard deviations.
        generator (torch.Generator, optional): The random number generator. If left out,
            PyTorch's default generator is used.

    Shapes:
        - **input:** readings :math:`(N, F)`, :math:`(B, N, F)` or a PyG batch :math:`(B \cdot N,
          F)`
        - **output:** the same shape. Missing readings (NaN) stay missing.

    Raises:
        ValueError: If :obj:`std` is negative or not finite, or there are no readings.

    Examples:
        >>> RandomNoise(0.0)(Data(x=torch.ones(2, 1))).x.view(-1)
        tensor([1., 1.])
    """

    per_frame = True

    def __init__(self, std: float = 0.1, generator: torch.Generator | None = None) -> None:
        self.std = check_deviation(std)
        self.generator = check_generator(generator)

    def changed(self, data: Data, x: Tensor) -> Tensor:
        r"""Returns the readings plus noise."""
        noise = normal(x.numel(), x, self.generator).view(x.shape)
        return x + self.std * noise.to(x)
