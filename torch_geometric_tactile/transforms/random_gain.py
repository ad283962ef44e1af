r"""Random gains of segments, such as fingers."""

from torch import Tensor
from torch_geometric.data.datapipes import functional_transform

from torch_geometric_tactile.transforms._random import SegmentDraws


@functional_transform("random_gain")
class RandomGain(SegmentDraws):
    r"""Multiplies the readings of each segment, such as a finger, by a random gain (functional
    name: :obj:`random_gain`). A gain is drawn for each sample and channel; all frames of a window
    share one gain. Use this augmentation in a :obj:`train_transform`.

    .. math::
        x'_i = x_i \, e^{\sigma g}, \qquad g \sim \mathcal{N}(0, 1)

    Requires readings with a meaningful zero: tared readings, or readings scaled to mean zero.

    Args:
        std (float): Standard deviation :math:`\sigma` of the logarithm of the gains. If it is
            small, it is close to the relative deviation of the gains.
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
        >>> RandomGain(0.0)(Data(x=torch.ones(2, 1))).x.view(-1)
        tensor([1., 1.])
    """

    def combined(self, x: Tensor, segment: Tensor, draws: Tensor) -> Tensor:
        r"""Returns the readings multiplied by the gains of their segments."""
        return x * draws.exp()[segment].view(x.shape).to(x)
