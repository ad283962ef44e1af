r"""Lengths and directions of the edges."""

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
    :obj:`geometric_edge_attr`), the geometrical edge features of the "Tactile Object Property
    Recognition using Geometrical Graph Edge Features and Multi-Thread Graph Convolutional Network"
    paper.

    .. math::
        \mathbf{e}_{ij} = [d, v_x, v_y, v_z], \qquad
        \mathbf{v} = \mathbf{p}_j - \mathbf{p}_i, \qquad d = \lVert \mathbf{v} \rVert

    with the neighbour :math:`j`, the first row of :obj:`edge_index`, and the target :math:`i`, the
    second.

    The paper gives them to its network in metres, without scaling. Scaled to the size of the touch
    (:class:`~torch_geometric_tactile.transforms.ZScore`), they seem to outweigh it: on a simulated
    hand, the paper's GCN with touch and edge features in one thread then had 58 %, and in
    metres 82 % (five splits; ``docs/results/hand_tables.md``).

    Args:
        norm (bool): Whether to divide by the length of the longest edge, of each sample its own:
            only so a sample gets the same numbers alone, in a batch and among many.
        max_value (float, optional): Length in metres to divide by in place of the longest edge.
        cat (bool): Whether to append to the :obj:`edge_attr` that is there. Otherwise it is
            replaced.

    Shapes:
        - **input:** positions in metres :math:`(N, 3)` or :math:`(B, N, 3)`, or a PyG batch of
          them, and :obj:`edge_index` :math:`(2, |\mathcal{E}|)`
        - **output:** :obj:`edge_attr` in metres, or without unit if :obj:`norm`,
          :math:`(|\mathcal{E}|, 4)` or :math:`(B, |\mathcal{E}|, 4)`, behind the features that
          were there

    Raises:
        ValueError: If there are no positions or edges, :obj:`edge_attr` has not one row an edge,
            or :obj:`max_value` is not positive or comes without :obj:`norm`.

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
            raise ValueError(f"'max_value' must come with 'norm=True' (got {max_value} without)")
        if max_value is not None and not 0 < max_value < math.inf:
            raise ValueError(f"'max_value' must be positive metres (got {max_value})")
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
            edge_attr = edge_attr / self._unit(data, length, source)
        old = getattr(data, "edge_attr", None)
        if old is not None and self.cat:
            old = old.view(-1, 1) if old.dim() == 1 else old
            if old.size(-2) != edge_attr.size(-2):
                raise ValueError(
                    f"'edge_attr' must have {edge_attr.size(-2)} rows, one an edge "
                    f"(got {old.size(-2)})"
                )
            lead = torch.broadcast_shapes(old.shape[:-1], edge_attr.shape[:-1])
            edge_attr = torch.cat([old.expand(*lead, -1), edge_attr.expand(*lead, -1)], dim=-1)
        data.edge_attr = edge_attr
        return data

    def _unit(self, data: Data, length: Tensor, source: Tensor) -> Tensor | float:
        if self.max_value is not None:
            return self.max_value
        if length.numel() == 0:
            return 1.0
        if isinstance(data, Batch):
            graph = data.batch[source]
            unit = scatter(length, graph, dim_size=data.num_graphs, reduce="max")[graph]
        else:
            unit = length.amax(dim=-2, keepdim=True)
        return torch.where(unit > 0, unit, 1.0)  # loops only
