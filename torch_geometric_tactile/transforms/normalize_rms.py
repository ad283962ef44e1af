r"""Readings in units of how much is felt in the same moment."""

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
    r"""Divides the readings of each sample, all taxels and channels together, by their root mean
    square (functional name: :obj:`normalize_rms`).

    What is left is the shape of a touch, whatever its strength: a light and a heavy person on a mat
    look alike. It destroys how strong the touch is, and where nothing is felt, it makes noise as
    large as a touch. Zero must be rest before: put a :class:`~torch_geometric_tactile.transforms.
    Tare` in front where it is not. A window is one sample, and keeps the course of its strength.

    Shapes:
        - **input:** readings :math:`(N, F)`, :math:`(B, N, F)` or a PyG batch :math:`(B \cdot N,
          F)`
        - **output:** the same shape. Missing readings (NaN) stay missing, and zeros zero.

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
        size = square.sqrt()[sample].reshape(rows.shape)
        data.x = (rows / size.masked_fill(size == 0, 1.0)).to(x).reshape(x.shape)
        return data
