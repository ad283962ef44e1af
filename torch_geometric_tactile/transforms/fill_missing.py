r"""Numbers in place of readings that are missing."""

import math

from torch_geometric.data import Data
from torch_geometric.data.datapipes import functional_transform

from torch_geometric_tactile._checks import need
from torch_geometric_tactile.transforms._attributes import FRAMES, add_mark, require_x
from torch_geometric_tactile.transforms._windows import padded_frames
from torch_geometric_tactile.transforms.tactile_transform import TactileTransform


@functional_transform("fill_missing")
class FillMissing(TactileTransform):
    r"""Replaces missing readings (NaN) by a number, and marks their taxels as :obj:`missing`
    (functional name: :obj:`fill_missing`).

    Behind a scaler, zero is the mean of the taxel. Infinite readings stay as they are. The padding
    of ragged windows is filled, too, but makes no taxel missing.

    Args:
        value (float): The number.

    Shapes:
        - **input:** readings :math:`(N, F)`, :math:`(B, N, F)` or a PyG batch :math:`(B \cdot N,
          F)`
        - **output:** the same shape, and booleans :obj:`missing` :math:`(N,)`, :math:`(B, N)` or
          :math:`(B \cdot N,)`: whether a feature was missing now or is marked already

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
        nan = x.isnan()
        if x.is_floating_point():  # whole counts cannot be missing
            data.x = x.masked_fill(nan, self.value)
        padding = padded_frames(self, data)
        add_mark(data, "missing", (nan if padding is None else nan & ~padding).any(dim=-1))
        return data
