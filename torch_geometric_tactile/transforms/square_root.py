r"""Square roots of counts and pressures."""

from torch_geometric.data import Data
from torch_geometric.data.datapipes import functional_transform

from torch_geometric_tactile.transforms._attributes import require_x
from torch_geometric_tactile.transforms.tactile_transform import TactileTransform


@functional_transform("square_root")
class SquareRoot(TactileTransform):
    r"""Takes the square root of the size of each reading and keeps its sign (functional name:
    :obj:`square_root`).

    The spread of a count grows with its square root, which is then the same for small and large
    ones; of pressures, light touch is heard beside a hard one. It comes before a scaler, and behind
    a tare if zero is not rest already.

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
