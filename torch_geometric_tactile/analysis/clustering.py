r"""Clustering of node features by segment."""

from typing import Literal, NamedTuple

import torch
from sklearn.metrics import silhouette_samples
from torch import Tensor

from torch_geometric_tactile.analysis.embedding import node_matrix


class SegmentClustering(NamedTuple):
    r"""The result of :func:`segment_clustering`: measures of how well the segments of nodes form
    clusters in feature space.

    Args:
        silhouette (float): Mean silhouette over the nodes. It is 1 if segments are compact and far
            apart, 0 if they overlap, and negative if nodes are nearer to a different segment.
        by_segment (torch.Tensor): Mean silhouette of each segment :math:`(S,)`, NaN if a segment
            has no node.
        neighbor_share (float): Fraction of the nearest neighbours that are in the same segment.
        chance_share (float): Fraction that would be expected if features were independent of
            segments.

    Examples:
        >>> features = torch.tensor([[0.0], [0.1], [5.0], [5.1]])
        >>> clusters = segment_clustering(features, torch.tensor([0, 0, 1, 1]), num_neighbors=1)
        >>> clusters.neighbor_share, clusters.by_segment.shape
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
    r"""Measures how well segments form clusters in feature space, based on Euclidean distance.
    Unlike an image from :func:`embed_nodes`, these measures do not depend on an embedding.

    Segments may form clusters even without training: convolutions make neighbours on the graph
    similar, and segments with separate weights differ. Compare the measures with those for the
    readings and for an untrained model to find out what was learnt.

    Args:
        features (torch.Tensor): Node features of several frames or of one frame.
        segment (torch.Tensor): Segment of each node, such as
            :meth:`layout.segments("patch") <torch_geometric_tactile.sensors.TaxelLayout.segments>`.
        frames (str): How to combine the frames. See
            :func:`~torch_geometric_tactile.analysis.node_matrix`, which also scales the features.
        num_neighbors (int): Number of nearest neighbours for :obj:`neighbor_share`.

    Shapes:
        - **features:** :math:`(B, N, C)` or :math:`(N, C)`
        - **segment:** :math:`(N,)`

    Raises:
        ValueError: If :obj:`segment` has the wrong shape, all nodes are in one segment, each node
            is in a separate segment, :obj:`num_neighbors` is not between 1 and the number of nodes
            minus one, or :func:`~torch_geometric_tactile.analysis.node_matrix` would reject an
            argument.

    Examples:
        >>> features = torch.tensor([[0.0], [0.1], [5.0], [5.1]])
        >>> clusters = segment_clustering(features, torch.tensor([0, 0, 1, 1]), num_neighbors=1)
        >>> round(clusters.silhouette, 2), clusters.neighbor_share
        (0.98, 1.0)
        >>> round(clusters.chance_share, 2)
        0.33
    """
    rows = node_matrix(features, frames)
    segment = segment.detach().cpu().long()
    num_nodes = len(rows)
    if segment.shape != (num_nodes,) or int(segment.min()) < 0:
        raise ValueError(
            f"'segment' must hold {num_nodes} numbers of at least 0, one for each node "
            f"(got shape {tuple(segment.shape)})"
        )
    num_segments = len(segment.unique())
    if not 1 < num_segments < num_nodes:
        raise ValueError(
            f"'segment' must name between 2 and {num_nodes - 1} segments (got {num_segments})"
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
    neighbor_share = (segment[nearest] == segment.view(-1, 1)).double().mean()
    return SegmentClustering(
        silhouette=float(silhouette.mean()),
        by_segment=by_segment.float(),
        neighbor_share=float(neighbor_share),
        chance_share=float(((size - 1) * size).sum() / (num_nodes * (num_nodes - 1))),
    )
