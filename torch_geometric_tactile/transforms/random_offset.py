r"""Offsets of fingers."""

from torch import Tensor
from torch_geometric.data.datapipes import functional_transform

from torch_geometric_tactile.transforms._random import SegmentDraws


@functional_transform("random_offset")
class RandomOffset(SegmentDraws):
    r"""Adds a random offset to the readings of each segment, such as a finger, drawn for each
    sample and channel (functional name: :obj:`random_offset`), as an augmentation: a
    :obj:`train_transform`. All frames of a window share one offset.

    What a network should not heed can also be taken out:
    :class:`~torch_geometric_tactile.transforms.CommonMode` subtracts it.

    Args:
        std (float): Standard deviation of the offsets, in the unit of the readings; behind a
            scaler, in deviations.
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
        >>> import torch
        >>> from torch_geometric.data import Data
        >>> RandomOffset(0.0)(Data(x=torch.ones(2, 1))).x.view(-1)
        tensor([1., 1.])
    """

    def combined(self, x: Tensor, segment: Tensor, drawn: Tensor) -> Tensor:
        r"""Adds the offsets."""
        return x + drawn[segment].view(x.shape).to(x)
