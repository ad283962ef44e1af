r"""How well the features of nodes form clusters by segment."""

from typing import Literal, NamedTuple

import torch
from sklearn.metrics import silhouette_samples
from torch import Tensor

from torch_geometric_tactile.analysis.embedding import node_matrix


class SegmentClustering(NamedTuple):
    r"""The result of :func:`segment_clustering`: how well the segments of nodes form clusters in
    the space of their features.

    Args:
        silhouette (float): Mean silhouette over the nodes: 1 if segments are tight and far apart, 0
            if they overlap, negative if nodes are nearer to another segment than to their own.
        by_segment (torch.Tensor): Mean silhouette of each segment :math:`(S,)`; NaN if a segment
            has no node.
        neighbor_share (float): Share of the nearest neighbours that are in the node's own segment.
        chance_share (float): The share if features were independent of segments.

    Examples:
        >>> features = torch.tensor([[0.0], [0.1], [5.0], [5.1]])
        >>> found = segment_clustering(features, torch.tensor([0, 0, 1, 1]), num_neighbors=1)
        >>> found.neighbor_share, found.by_segment.shape
        (1.0, torch.Size([2]))
    """

    silhouette: float
    by_segment: Tensor
    neighbor_share: float
    chance_share: float


def segment_clustering(
    features: Tensor,
    segment: Tensor,
    frames: Literal["joined", "mean"] = "joined",
    num_neighbors: int = 10,
) -> SegmentClustering:
    r"""Measures clusters by segment in the space of the features, by Euclidean distance;
    a picture of :func:`embed_nodes` only suggests them.

    Convolution alone makes neighbours on the graph alike, and segments with weights of their own
    differ before any training. Only the difference from the readings themselves
    and from an untrained model was learnt.

    Args:
        features (torch.Tensor): Node features of some frames, or of one.
        segment (torch.Tensor): The segment of each node, such as
            :meth:`layout.segments("patch") <torch_geometric_tactile.sensors.TaxelLayout.segments>`.
        frames (str): How frames are joined; see
            :func:`~torch_geometric_tactile.analysis.node_matrix`, which also scales.
        num_neighbors (int): Number of nearest neighbours that are counted.

    Shapes:
        - **features:** :math:`(B, N, C)` or :math:`(N, C)`
        - **segment:** :math:`(N,)`

    Raises:
        ValueError: If :obj:`segment` does not fit, all nodes are of one segment or each is of its
            own, :obj:`num_neighbors` is not between 1 and the number of other nodes, or as
            :func:`~torch_geometric_tactile.analysis.node_matrix`.

    Examples:
        >>> features = torch.tensor([[0.0], [0.1], [5.0], [5.1]])
        >>> found = segment_clustering(features, torch.tensor([0, 0, 1, 1]), num_neighbors=1)
        >>> round(found.silhouette, 2), found.neighbor_share, round(found.chance_share, 2)
        (0.98, 1.0, 0.33)
    """
    rows = node_matrix(features, frames)
    segment = segment.detach().cpu().long()
    num_nodes = len(rows)
    if segment.shape != (num_nodes,) or int(segment.min()) < 0:
        raise ValueError(
            f"'segment' must hold {num_nodes} numbers from 0, one for each node "
            f"(got shape {tuple(segment.shape)})"
        )
    count = len(segment.unique())
    if not 1 < count < num_nodes:
        raise ValueError(
            f"'segment' must name between 2 and {num_nodes - 1} segments (got {count})"
        )
    if not 1 <= num_neighbors < num_nodes:
        raise ValueError(
            f"'num_neighbors' must be between 1 and {num_nodes - 1} (got {num_neighbors})"
        )
    silhouette = torch.from_numpy(silhouette_samples(rows.numpy(), segment.numpy())).double()
    size = segment.bincount()
    by_segment = torch.zeros(len(size), dtype=torch.double).index_add(0, segment, silhouette) / size
    distance = torch.cdist(rows.double(), rows.double()).fill_diagonal_(torch.inf)
    nearest = distance.topk(num_neighbors, largest=False).indices
    own = (segment[nearest] == segment.view(-1, 1)).double().mean()
    return SegmentClustering(
        silhouette=float(silhouette.mean()),
        by_segment=by_segment.float(),
        neighbor_share=float(own),
        chance_share=float(((size - 1) * size).sum() / (num_nodes * (num_nodes - 1))),
    )
