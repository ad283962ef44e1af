r"""Division of readings by their root mean square."""

from torch_geometric.data import Data
from torch_geometric.data.datapipes import functional_transform

from torch_geometric_tactile.transforms._attributes import require_floats
from torch_geometric_tactile.transforms._segments import (
    repeat_rows,
    samples_of_rows,
    segment_means,
)
from torch_geometric_tactile.transforms.tactile_transform import TactileTransform


@functional_transform("normalize_rms")
class NormalizeRMS(TactileTransform):
    r"""Divides the readings of each sample by their root mean square over all taxels and channels
    (functional name: :obj:`normalize_rms`).

    The result shows the shape of a touch but not its strength: a light and a heavy person on a mat
    have the same readings. In a sample without a touch, noise becomes as large as a touch. Readings
    must be zero at rest; otherwise, apply :class:`~torch_geometric_tactile.transforms.Tare` first.
    A window is one sample, so that changes in strength within a window are preserved.

    Shapes:
        - **input:** readings :math:`(N, F)`, :math:`(B, N, F)` or a PyG batch :math:`(B \cdot N,
          F)`
        - **output:** the same shape. Missing readings (NaN) stay missing, and zeros stay zero.

    Raises:
        ValueError: If there are no readings.

    Examples:
        >>> import torch
        >>> NormalizeRMS()(Data(x=torch.tensor([[3.0], [0.0], [0.0], [4.0]]))).x.view(-1)
        tensor([1.2000, 0.0000, 0.0000, 1.6000])
    """

    reads = writes = ("x",)
    per_frame = False

    def forward(self, data: Data) -> Data:
        r"""Sets :obj:`x`."""
        x = require_floats(self, data)
        rows = x.reshape(-1, x.size(-1)).double()
        sample, count = samples_of_rows(data, x)
        sample = repeat_rows(sample, x.size(-1))
        square = segment_means(rows.square().reshape(-1, 1), sample, count)
        rms = square.sqrt()[sample].reshape(rows.shape)
        # A sample that is zero everywhere stays zero.
        data.x = (rows / rms.masked_fill(rms == 0, 1.0)).to(x).reshape(x.shape)
        return data
