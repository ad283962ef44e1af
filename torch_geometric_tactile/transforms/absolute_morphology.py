r"""Distances and directions of the taxels from a point."""

import math
from collections.abc import Sequence

import torch
from torch_geometric.data import Data
from torch_geometric.data.datapipes import functional_transform

from torch_geometric_tactile.transforms._attributes import require_pos, require_x
from torch_geometric_tactile.transforms.tactile_transform import TactileTransform


@functional_transform("absolute_morphology")
class AbsoluteMorphology(TactileTransform):
    r"""Describes each taxel by its distance and its vector from a point (functional name:
    :obj:`absolute_morphology`).

    .. math::
        \mathbf{a}_i = [d, v_x, v_y, v_z], \qquad
        \mathbf{v} = \mathbf{p}_i - \mathbf{o}, \qquad d = \lVert \mathbf{v} \rVert

    Args:
        origin (tuple of float): The point :math:`\mathbf{o}` in metres, in the frame of :obj:`pos`.
        cat (bool): If :obj:`True`, the features are appended to the readings :obj:`x` and converted
            to their precision; otherwise, they are stored as :obj:`absolute`.

    Shapes:
        - **input:** positions in metres :math:`(N, 3)` or :math:`(B, N, 3)`, or a PyG batch of
          positions; with :obj:`cat` also readings :math:`(N, F)` or :math:`(B, N, F)`
        - **output:** :obj:`absolute` in metres :math:`(N, 4)` or :math:`(B, N, 4)`; with
          :obj:`cat`, :obj:`x` with :math:`F + 4` features

    Raises:
        ValueError: If :obj:`origin` is not a point, there are no positions, or, with :obj:`cat`,
            the readings are missing or have a different number of taxels.

    Examples:
        >>> AbsoluteMorphology()(Data(pos=torch.tensor([[0.0, 0.03, 0.04]]))).absolute
        tensor([[0.0500, 0.0000, 0.0300, 0.0400]])
    """

    @property
    def reads(self) -> tuple[str, ...]:
        r"""The positions, and also the readings if the features are appended to them."""
        return ("pos", "x") if self.cat else ("pos",)

    @property
    def writes(self) -> tuple[str, ...]:
        r"""The attribute with the features."""
        return ("x",) if self.cat else ("absolute",)

    @property
    def per_frame(self) -> bool:
        r"""Whether the readings stay unchanged; appended columns occur once in a window."""
        return not self.cat

    def __init__(self, origin: Sequence[float] = (0.0, 0.0, 0.0), cat: bool = False) -> None:
        self.origin = tuple(float(number) for number in origin)
        if len(self.origin) != 3 or not all(map(math.isfinite, self.origin)):
            raise ValueError(f"'origin' must be three finite numbers (got {self.origin})")
        self.cat = cat

    def forward(self, data: Data) -> Data:
        r"""Sets :obj:`absolute`, or :obj:`x` if :obj:`cat`."""
        pos = require_pos(self, data)
        vector = pos - pos.new_tensor(self.origin)
        length = torch.linalg.vector_norm(vector, dim=-1, keepdim=True)
        absolute = torch.cat([length, vector], dim=-1)
        if not self.cat:
            data.absolute = absolute
            return data
        x = require_x(self, data)
        if x.size(-2) != pos.size(-2):
            raise ValueError(f"'x' must have {pos.size(-2)} taxels, like 'pos' (got {x.size(-2)})")
        x = x if x.is_floating_point() else x.to(pos.dtype)  # counts may be integers
        shape = torch.broadcast_shapes(x.shape[:-1], absolute.shape[:-1])
        parts = [x.expand(*shape, -1), absolute.to(x.dtype).expand(*shape, -1)]
        data.x = torch.cat(parts, dim=-1)
        return data
