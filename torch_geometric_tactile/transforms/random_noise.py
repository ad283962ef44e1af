r"""Noise on the readings."""

import torch
from torch_geometric.data import Data
from torch_geometric.data.datapipes import functional_transform

from torch_geometric_tactile.transforms._attributes import require_x
from torch_geometric_tactile.transforms._random import check_deviation, normal
from torch_geometric_tactile.transforms.tactile_transform import TactileTransform


@functional_transform("random_noise")
class RandomNoise(TactileTransform):
    r"""Adds normal noise to each reading separately (functional name: :obj:`random_noise`), as an
    augmentation: a :obj:`train_transform`.

    Args:
        std (float): Its standard deviation, in the unit of the readings; behind a scaler, in
            deviations.
        generator (torch.Generator, optional): The source of random numbers; PyTorch's own if left
            out.

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

    reads = writes = ("x",)
    per_frame = True
    is_random = True

    def __init__(self, std: float = 0.1, generator: torch.Generator | None = None) -> None:
        self.std = check_deviation(std)
        self.generator = generator

    def forward(self, data: Data) -> Data:
        r"""Adds the noise."""
        x = require_x(self, data)
        x = x if x.is_floating_point() else x.float()  # counts may be integers
        noise = normal(x.numel(), x, self.generator).view(x.shape)
        data.x = x + self.std * noise.to(x)
        return data

    def __repr__(self) -> str:
        return f"{type(self).__name__}(std={self.std})"
