r"""Scaling of readings to a range."""

import math
from collections.abc import Iterable
from typing import Literal

import torch
from torch import Tensor
from torch_geometric.data.datapipes import functional_transform

from torch_geometric_tactile.transforms.base import FittedTransform


@functional_transform("normalize_range")
class Normalize(FittedTransform):
    r"""Scales each taxel and channel so that its readings lie between :obj:`low` and :obj:`high`
    (functional name: :obj:`normalize_range`). The lowest and highest readings are fitted on
    samples, which should be the training part.

    .. math::
        x' = l + (h - l) \frac{x - x_{\min}}{x_{\max} - x_{\min}}

    A taxel that never changes is shifted to the middle of the range. Readings outside the fitted
    range are scaled to values outside the range from :obj:`low` to :obj:`high`.

    Args:
        low (float): The lower end :math:`l`.
        high (float): The upper end :math:`h`.
        attr (str): The attribute to scale: :obj:`"x"`, or another attribute of floating-point
            numbers.
        per (str): The numbers that share a range:

            * :obj:`"taxel"`: each taxel and channel has a separate range.
            * :obj:`"channel"`: all taxels of a channel (the last dimension of :obj:`attr`) share
              one.
            * :obj:`"signal"`: all frames of a taxel and channel in a window share one.

    Shapes:
        - **input:** readings :math:`(N, F)`, :math:`(B, N, F)` or a PyG batch :math:`(B \cdot N,
          F)`
        - **output:** the same shape

    Raises:
        RuntimeError: If the transform was not fitted.
        ValueError: If :obj:`low` is not below :obj:`high`, :obj:`per` is unknown, or the readings
            have different taxels (except with :obj:`per="channel"`) or channels than the fitted
            samples.

    Examples:
        >>> from torch_geometric_tactile.data import StaticData
        >>> data = StaticData(x=torch.tensor([10.0, 15.0, 30.0]).view(3, 1, 1))
        >>> Normalize().fit(data)(data).x.view(-1)
        tensor([-1.0000, -0.5000,  1.0000])
    """

    def __init__(
        self,
        low: float = -1.0,
        high: float = 1.0,
        attr: str = "x",
        per: Literal["taxel", "channel", "signal"] = "taxel",
    ) -> None:
        if not -math.inf < low < high < math.inf:
            raise ValueError(f"'low' must be below 'high', both finite (got {low} and {high})")
        super().__init__(attr=attr, per=per)
        self.low = float(low)
        self.high = float(high)

    def moments(self, parts: Iterable[Tensor]) -> tuple[Tensor, Tensor]:
        r"""Returns centre and scale in double precision: the reading that becomes zero, and the
        difference that becomes one.

        Args:
            parts (iterable of torch.Tensor): The readings in parts, as in
                :meth:`FittedTransform.moments`.
        """
        lows, highs = zip(*(_extremes(part) for part in parts), strict=True)
        lowest, highest = torch.stack(lows).amin(0), torch.stack(highs).amax(0)
        is_missing = lowest > highest  # all readings are missing
        lowest, highest = lowest.masked_fill(is_missing, 0.0), highest.masked_fill(is_missing, 0.0)
        is_changing = highest - lowest > self.noise(torch.maximum(lowest.abs(), highest.abs()))
        scale = torch.where(is_changing, (highest - lowest) / (self.high - self.low), 1.0)
        middle = (self.low + self.high) / 2
        center = torch.where(is_changing, lowest - self.low * scale, lowest - middle)
        return center, scale

    def __repr__(self) -> str:
        return f"{type(self).__name__}(low={self.low}, high={self.high}{self._attr_repr()})"


def _extremes(part: Tensor) -> tuple[Tensor, Tensor]:
    is_missing = part.isnan()
    lowest = part.masked_fill(is_missing, torch.inf).amin(0)
    return lowest, part.masked_fill(is_missing, -torch.inf).amax(0)
