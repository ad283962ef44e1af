r"""Replacement of missing readings."""

import math

from torch_geometric.data import Data
from torch_geometric.data.datapipes import functional_transform

from torch_geometric_tactile._checks import need
from torch_geometric_tactile.transforms._attributes import FRAMES, add_mark, require_x
from torch_geometric_tactile.transforms._windows import padding_mask
from torch_geometric_tactile.transforms.tactile_transform import TactileTransform


@functional_transform("fill_missing")
class FillMissing(TactileTransform):
    r"""Replaces missing readings (NaN) by a number and marks their taxels as :obj:`missing`
    (functional name: :obj:`fill_missing`).

    After a scaler, zero is the mean of the taxel. Infinite readings are not changed. Padding of
    windows is replaced as well, but its taxels are not marked as missing.

    Args:
        value (float): The number that replaces missing readings.

    Shapes:
        - **input:** readings :math:`(N, F)`, :math:`(B, N, F)` or a PyG batch :math:`(B \cdot N,
          F)`
        - **output:** the same shape, and booleans :obj:`missing` :math:`(N,)`, :math:`(B, N)` or
          :math:`(B \cdot N,)`: whether a feature of the taxel was missing or the taxel was already
          marked

    Raises:
        ValueError: If :obj:`value` is not finite, or there are no readings.

    Examples:
        >>> import torch
        >>> data = FillMissing()(Data(x=torch.tensor([[1.0, torch.nan], [2.0, 3.0]])))
        >>> data.x
        tensor([[1., 0.],
                [2., 3.]])
        >>> data.missing
        tensor([ True, False])
    """

    reads = ("x", "missing", *FRAMES)
    writes = ("x", "missing")
    per_frame = True

    def __init__(self, value: float = 0.0) -> None:
        self.value = float(value)
        need(math.isfinite(self.value), "'value' must be finite", value)

    def forward(self, data: Data) -> Data:
        r"""Sets :obj:`x` and :obj:`missing`."""
        x = require_x(self, data)
        is_nan = x.isnan()
        if x.is_floating_point():  # integers cannot be missing
            data.x = x.masked_fill(is_nan, self.value)
        padding = padding_mask(self, data)
        add_mark(data, "missing", (is_nan if padding is None else is_nan & ~padding).any(dim=-1))
        return data
