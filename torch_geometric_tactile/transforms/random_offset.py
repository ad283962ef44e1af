r"""Random offsets of segments, such as fingers."""

from torch import Tensor
from torch_geometric.data.datapipes import functional_transform

from torch_geometric_tactile.transforms._random import SegmentDraws


@functional_transform("random_offset")
class RandomOffset(SegmentDraws):
    r"""Adds a random offset to the readings of each segment, such as a finger (functional name:
    :obj:`random_offset`). An offset is drawn for each sample and channel; all frames of a window
    share one offset. Use this augmentation in a :obj:`train_transform`.

    Alternatively, :class:`~torch_geometric_tactile.transforms.CommonMode` subtracts such offsets.

    Args:
        std (float): Standard deviation of the offsets in the unit of the readings; after a scaler,
            in standard deviations.
        segments (str or sequence of int, optional): The segments: :obj:`"digit"` or :obj:`"patch"`
            of the layout, or an integer for each taxel :math:`(N,)`. If left out, all taxels of a
            sample are one segment.
        layout (TaxelLayout or str or PathLike, optional): The taxels: a layout, the name of a
            layout of this package, or a layout file; required for :obj:`"digit"` and
            :obj:`"patch"`.
        generator (torch.Generator, optional): The random number generator. If left out,
            PyTorch's default generator is used.

    Shapes:
        - **input:** readings :math:`(N, F)`, :math:`(B, N, F)` or a PyG batch :math:`(B \cdot N,
          F)`
        - **output:** the same shape. Missing readings (NaN) stay missing.

    Raises:
        ValueError: If :obj:`std` is negative or not finite, :obj:`segments` is invalid or requires
            a layout, or a sample has the wrong number of taxels or no readings.

    Examples:
        >>> import torch
        >>> from torch_geometric.data import Data
        >>> RandomOffset(0.0)(Data(x=torch.ones(2, 1))).x.view(-1)
        tensor([1., 1.])
    """

    def combined(self, x: Tensor, segment: Tensor, draws: Tensor) -> Tensor:
        r"""Returns the readings plus the offsets of their segments."""
        return x + draws[segment].view(x.shape).to(x)
