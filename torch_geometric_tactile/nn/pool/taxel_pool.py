r"""Pooling over clusters of taxels."""

from collections.abc import Sequence
from typing import Literal, Union

import torch
from torch import Tensor
from torch.nn.functional import max_pool2d

from torch_geometric_tactile._checks import need
from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile.nn._sizes import has_taxels
from torch_geometric_tactile.sensors import TaxelLayout, as_layout
from torch_geometric_tactile.sensors._taxel_clusters import taxel_clusters


class TaxelPool(torch.nn.Module):
    r"""Pools the features of the taxels in each cluster. A cluster is a patch, a digit, or a voxel
    of a fixed size. The attribute :obj:`coarse` is the layout of the clusters, for use in further
    convolutions.

    .. math::
        \mathbf{x}'_c = \max_{i \in c} \mathbf{x}_i \qquad \text{or} \qquad
        \mathbf{x}'_c = \frac{1}{|c|} \sum_{i \in c} \mathbf{x}_i

    Args:
        layout (TaxelLayout, str or PathLike): The layout, the name of a stock layout, or the path
            of a layout file.
        by (str, float or sequence of float): Clusters, as in
            :func:`~torch_geometric_tactile.sensors._taxel_clusters`: :obj:`"patch"`,
            :obj:`"digit"`, or the edge length of voxels in metres, as one number or as a pair of
            numbers for :math:`x` and :math:`y`. On a grid, twice the pitch pools :math:`2 \times 2`
            taxels.
        aggr (str): :obj:`"max"` or :obj:`"mean"`.

    Shapes:
        - **input:** features :math:`(N, F)`, :math:`(B, N, F)` or, for a PyG batch,
          :math:`(B \cdot N, F)`
        - **output:** features of the :math:`M` clusters :math:`(M, F)`, :math:`(B, M, F)` or, for a
          PyG batch, :math:`(B \cdot M, F)`

    Raises:
        ValueError: If :obj:`by` or :obj:`aggr` is unknown, or :obj:`x` has the wrong number of
            taxels.

    Examples:
        >>> from torch_geometric_tactile.sensors import grid
        >>> pool = TaxelPool(grid(2, 4, pitch=0.002), by=0.004)
        >>> pool
        TaxelPool(8, 2, by=0.004, aggr='max')
        >>> pool(torch.arange(8.0).view(8, 1)).view(-1)
        tensor([5., 7.])
    """

    members: Tensor
    share: Tensor

    def __init__(
        self,
        layout: Union[TaxelLayout, PathLike],
        by: Union[Literal["patch", "digit"], float, Sequence[float]],
        aggr: Literal["max", "mean"] = "max",
    ) -> None:
        super().__init__()
        need(aggr in ("max", "mean"), f"'aggr' must be 'max' or 'mean' (got {aggr!r})")
        with torch.device("cpu"):  # on the meta device, a layout would lose its values
            clusters = taxel_clusters(as_layout(layout), by)
            members, share = _cluster_members(clusters.cluster)
        self.by = by if isinstance(by, str | float | int) else tuple(by)
        self.aggr = aggr
        self.coarse = clusters.layout
        self.num_taxels = len(clusters.cluster)
        self.num_clusters = clusters.layout.num_taxels
        self._has_padding = bool((share == 0).any())
        # Not saved in the state, since they are computed from the arguments.
        self.register_buffer("members", members, persistent=False)
        self.register_buffer("share", share, persistent=False)

    def forward(self, x: Tensor) -> Tensor:
        r"""Returns the pooled features of each cluster.

        Args:
            x (torch.Tensor): Features.
        """
        num_taxels = self.num_taxels
        if not has_taxels(x, num_taxels):
            raise ValueError(
                f"'x' must have {num_taxels} taxels, like the layout (got shape {tuple(x.shape)})"
            )
        rows = x if x.dim() == 3 else x.reshape(-1, num_taxels, x.size(-1))
        # The memory is ordered by sample or, after some layers, by taxel. In both cases, the
        # selection copies contiguous rows.
        is_taxel_major = not rows.is_contiguous()
        if is_taxel_major:
            rows = rows.transpose(0, 1).flatten(1).unsqueeze(0)
        members = rows.index_select(1, self.members.view(-1))
        members = members.unflatten(1, (self.num_clusters, -1))
        if self.aggr == "max":
            # Pooling a channels-last image is twice as fast as taking the maximum over one
            # dimension.
            out = max_pool2d(members.permute(0, 3, 1, 2), (1, members.size(2)))
            out = out.permute(0, 2, 3, 1).squeeze(2)
        else:
            members = members * self.share.to(x.dtype).unsqueeze(-1)
            if self._has_padding:  # padding has a share of zero, and zero times infinity is NaN
                members = members.masked_fill((self.share == 0).unsqueeze(-1), 0.0)
            out = members.sum(dim=2)
        if is_taxel_major:
            out = out.view(self.num_clusters, -1, x.size(-1)).transpose(0, 1)
        return out if x.dim() == 3 else out.reshape(-1, x.size(-1))

    def __repr__(self) -> str:
        return (
            f"{type(self).__name__}({self.num_taxels}, {self.num_clusters}, by={self.by!r}, "
            f"aggr={self.aggr!r})"
        )


def _cluster_members(cluster: Tensor) -> tuple[Tensor, Tensor]:
    # Returns the taxels of each cluster (M, K), padded with the first taxel of the cluster, and the
    # weight of each taxel in the mean (M, K), which is zero for padding.
    count = cluster.bincount()
    order = cluster.argsort(stable=True)
    column = torch.arange(len(cluster)) - (count.cumsum(0) - count)[cluster[order]]
    members = order[count.cumsum(0) - count].unsqueeze(1).repeat(1, int(count.max()))
    share = torch.zeros(members.shape)
    members[cluster[order], column] = order
    share[cluster[order], column] = 1 / count[cluster[order]].float()
    return members, share
