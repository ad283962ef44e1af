r"""Square roots of readings."""

from torch_geometric.data import Data
from torch_geometric.data.datapipes import functional_transform

from torch_geometric_tactile.transforms._attributes import require_x
from torch_geometric_tactile.transforms.tactile_transform import TactileTransform


@functional_transform("square_root")
class SquareRoot(TactileTransform):
    r"""Replaces each reading by the square root of its absolute value and keeps its sign
    (functional name: :obj:`square_root`).

    The standard deviation of a count grows with the square root of the count; after this transform,
    it is the same for small and large counts. In pressure readings, a light touch stays visible
    beside a hard one. Apply it before a scaler, and after a tare unless the readings are zero at
    rest.

    Shapes:
        - **input:** readings :math:`(N, F)`, :math:`(B, N, F)` or a PyG batch :math:`(B \cdot N,
          F)`
        - **output:** the same shape

    Raises:
        ValueError: If there are no readings.

    Examples:
        >>> import torch
        >>> SquareRoot()(Data(x=torch.tensor([[4.0, -9.0], [0.0, 1.0]]))).x
        tensor([[ 2., -3.],
                [ 0.,  1.]])
    """

    reads = ("x",)
    writes = ("x",)
    per_frame = True

    def forward(self, data: Data) -> Data:
        r"""Sets :obj:`x`."""
        x = require_x(self, data)
        data.x = x.abs().sqrt() * x.sign()
        return data
