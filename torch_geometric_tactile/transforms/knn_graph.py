r"""Nearest-neighbour graphs without compiled packages."""

from itertools import pairwise

import torch
from torch import Tensor
from torch_geometric.data import Batch, Data
from torch_geometric.data.datapipes import functional_transform
from torch_geometric.utils import coalesce

from torch_geometric_tactile._checks import need
from torch_geometric_tactile.transforms._attributes import EDGES, require
from torch_geometric_tactile.transforms._segments import repeat_rows
from torch_geometric_tactile.transforms.tactile_transform import TactileTransform

# Distances count as equal if they differ by less than this part of the largest distance. The
# rounding of positions in single precision, a few sensor lengths from the origin, is smaller.
_TIE_TOLERANCE = 1e-5


@functional_transform("taxel_knn_graph")
class KNNGraph(TactileTransform):
    r"""Connects each taxel to its :math:`k` nearest neighbours in three dimensions, as in the
    "Tactile Grasp Stability Classification Based on Graph Convolutional Networks" paper (functional
    name: :obj:`taxel_knn_graph`, since PyG already has a :obj:`knn_graph`).

    Unlike :class:`torch_geometric.transforms.KNNGraph`, this transform needs no compiled package
    and breaks ties in the same way on all machines. Distances that differ by less than a hundred
    thousandth of the sensor's size count as equal. Among equally distant taxels, the taxel with the
    lower number comes first.

    Args:
        k (int): Number of neighbours.
        symmetric (bool): Whether to add the reverse of each edge, as in the paper. Otherwise, edges
            only run from the neighbour to the taxel.

    Shapes:
        - **input:** positions in metres :math:`(N, 3)`, or a PyG batch
        - **output:** :obj:`edge_index` :math:`(2, |\mathcal{E}|)`, sorted by source

    Raises:
        ValueError: If :obj:`k` is below one or not below the number of taxels, or there are no
            positions.

    Examples:
        >>> from torch_geometric_tactile.sensors import grid
        >>> data = KNNGraph(k=1, symmetric=False)(Data(pos=grid(1, 3, pitch=0.002).pos))
        >>> data.edge_index
        tensor([[0, 1, 1],
                [1, 0, 2]])
    """

    reads, writes = ("pos", *EDGES), EDGES
    per_frame = True

    def __init__(self, k: int, symmetric: bool = True) -> None:
        need(k >= 1, "'k' must be at least 1", k)
        self.k = k
        self.symmetric = symmetric

    def forward(self, data: Data) -> Data:
        r"""Sets :obj:`edge_index`, and deletes :obj:`edge_attr` and :obj:`edge_weight`."""
        pos = require(self, data, "pos")
        if pos.dim() != 2 or pos.size(1) != 3:
            raise ValueError(
                f"'pos' must have shape (num_taxels, 3), the same for all samples "
                f"(got {tuple(pos.shape)})"
            )
        ptr = data.ptr.tolist() if isinstance(data, Batch) else [0, pos.size(0)]
        parts = [self._edges(pos[start:stop]) + start for start, stop in pairwise(ptr)]
        data.edge_index = torch.cat(parts, dim=1) if parts else pos.new_empty(2, 0).long()
        for key in ("edge_attr", "edge_weight"):
            if key in data:
                del data[key]
        return data

    def _edges(self, pos: Tensor) -> Tensor:
        num_taxels = pos.size(0)
        need(self.k < num_taxels, f"'k' must be below the number of taxels, {num_taxels}", self.k)
        pos = pos.double()
        # Without a matrix product, which would lose digits of small distances.
        distance = torch.cdist(pos, pos, compute_mode="donot_use_mm_for_euclid_dist")
        tolerance = _TIE_TOLERANCE * distance.max()
        distance, order = distance.fill_diagonal_(torch.inf).sort(dim=1)
        # A step above the tolerance begins the next rank. Rounding the distances to multiples of
        # the tolerance would separate equal distances on both sides of a rounding boundary.
        rank = (distance.diff(dim=1, prepend=distance[:, :1]) > tolerance).cumsum(dim=1)
        neighbour = (rank * num_taxels + order).sort(dim=1).values[:, : self.k] % num_taxels
        target = repeat_rows(torch.arange(num_taxels, device=pos.device), self.k)
        edge_index = torch.stack([neighbour.reshape(-1), target])
        if self.symmetric:
            edge_index = torch.cat([edge_index, edge_index.flip(0)], dim=1)
        out: Tensor = coalesce(edge_index, num_nodes=num_taxels)
        return out
