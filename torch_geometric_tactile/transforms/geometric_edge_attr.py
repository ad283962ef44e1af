r"""Geometrical edge features: lengths and directions of the edges."""

import math

import torch
from torch import Tensor
from torch_geometric.data import Batch, Data
from torch_geometric.data.datapipes import functional_transform
from torch_geometric.utils import scatter

from torch_geometric_tactile.transforms._attributes import require, require_pos
from torch_geometric_tactile.transforms.tactile_transform import TactileTransform


@functional_transform("geometric_edge_attr")
class GeometricEdgeAttr(TactileTransform):
    r"""Describes each edge by its length and its vector (functional name:
    :obj:`geometric_edge_attr`). These are the geometrical edge features of the "Tactile Object
    Property Recognition using Geometrical Graph Edge Features and Multi-Thread Graph Convolutional
    Network" paper.

    .. math::
        \mathbf{e}_{ij} = [d, v_x, v_y, v_z], \qquad
        \mathbf{v} = \mathbf{p}_j - \mathbf{p}_i, \qquad d = \lVert \mathbf{v} \rVert

    The neighbour :math:`j` is in the first row of :obj:`edge_index`, and the target :math:`i` in
    the second row.

    The paper uses the features in metres, without scaling. If they are scaled to the magnitude of
    the readings (:class:`~torch_geometric_tactile.transforms.ZScore`), they seem to dominate the
    readings: on a simulated hand, the paper's GCN with readings and edge features in one thread had
    an accuracy of 58 % with scaling and of 82 % in metres (five splits;
    ``docs/results/hand_tables.md``).

    Args:
        norm (bool): If :obj:`True`, divides by the longest edge of the same sample, so that results
            do not depend on batching.
        max_value (float, optional): Length in metres by which to divide instead of the longest
            edge.
        cat (bool): If :obj:`True`, the features are appended to an existing :obj:`edge_attr`;
            otherwise, they replace it.

    Shapes:
        - **input:** positions in metres :math:`(N, 3)` or :math:`(B, N, 3)`, or a PyG batch, and
          :obj:`edge_index` :math:`(2, |\mathcal{E}|)`
        - **output:** :obj:`edge_attr` :math:`(|\mathcal{E}|, 4)` or :math:`(B, |\mathcal{E}|, 4)`
          in metres, or without a unit with :obj:`norm`. Existing features come first.

    Raises:
        ValueError: If there are no positions or edges, :obj:`edge_attr` does not have one row for
            each edge, or :obj:`max_value` is not positive or is given without :obj:`norm`.

    Examples:
        >>> pos = torch.tensor([[0.0, 0.0, 0.0], [0.03, 0.04, 0.0]])
        >>> data = Data(pos=pos, edge_index=torch.tensor([[0, 1], [1, 0]]))
        >>> GeometricEdgeAttr()(data).edge_attr
        tensor([[ 0.0500, -0.0300, -0.0400,  0.0000],
                [ 0.0500,  0.0300,  0.0400,  0.0000]])
    """

    reads, writes = ("pos", "edge_index", "edge_attr"), ("edge_attr",)
    per_frame = True

    def __init__(
        self, norm: bool = False, max_value: float | None = None, cat: bool = True
    ) -> None:
        if max_value is not None and not norm:
            raise ValueError(f"'max_value' requires norm=True (got {max_value} without it)")
        if max_value is not None and not 0 < max_value < math.inf:
            raise ValueError(f"'max_value' must be a positive length in metres (got {max_value})")
        self.norm = norm
        self.max_value = max_value
        self.cat = cat

    def forward(self, data: Data) -> Data:
        r"""Sets :obj:`edge_attr`."""
        pos = require_pos(self, data)
        edge_index = require(self, data, "edge_index")
        source, target = edge_index
        vector = pos.index_select(-2, source) - pos.index_select(-2, target)
        length = torch.linalg.vector_norm(vector, dim=-1, keepdim=True)
        edge_attr = torch.cat([length, vector], dim=-1)
        if self.norm:
            edge_attr = edge_attr / self._norm_length(data, length, source)
        old_edge_attr = getattr(data, "edge_attr", None)
        if old_edge_attr is not None and self.cat:
            old_edge_attr = old_edge_attr.view(-1, 1) if old_edge_attr.dim() == 1 else old_edge_attr
            if old_edge_attr.size(-2) != edge_attr.size(-2):
                raise ValueError(
                    f"'edge_attr' must have {edge_attr.size(-2)} rows, one for each edge "
                    f"(got {old_edge_attr.size(-2)})"
                )
            lead = torch.broadcast_shapes(old_edge_attr.shape[:-1], edge_attr.shape[:-1])
            edge_attr = torch.cat(
                [old_edge_attr.expand(*lead, -1), edge_attr.expand(*lead, -1)], dim=-1
            )
        data.edge_attr = edge_attr
        return data

    def _norm_length(self, data: Data, length: Tensor, source: Tensor) -> Tensor | float:
        # Returns the length by which the features of each edge are divided.
        if self.max_value is not None:
            return self.max_value
        if length.numel() == 0:
            return 1.0
        if isinstance(data, Batch):
            graph = data.batch[source]
            longest = scatter(length, graph, dim_size=data.num_graphs, reduce="max")[graph]
        else:
            longest = length.amax(dim=-2, keepdim=True)
        return torch.where(longest > 0, longest, 1.0)  # zero if all edges are self-loops
