r"""Clustering of neighbouring taxels into a coarser layout."""

from collections.abc import Sequence
from typing import Literal, NamedTuple

import torch
from torch import Tensor

from torch_geometric_tactile.sensors.layout import TaxelLayout

# Fraction of a voxel that a taxel may be below the border of the next voxel and still belong to it:
# positions are single precision.
_BORDER_TOLERANCE = 1e-3
# Length of a mean of unit vectors below which they cancel out.
_MIN_MEAN_LENGTH = 0.1


class TaxelClusters(NamedTuple):
    r"""The cluster of each taxel, and the layout of the clusters.

    Args:
        cluster (torch.Tensor): Cluster index of each taxel :math:`(N,)`.
        layout (TaxelLayout): The layout of the :math:`M` clusters.

    Examples:
        >>> from torch_geometric_tactile.sensors import allegro_uskin
        >>> clusters = taxel_clusters(allegro_uskin(), "patch")
        >>> clusters.cluster.shape, clusters.layout.num_taxels
        (torch.Size([384]), 22)
    """

    cluster: Tensor
    layout: TaxelLayout


def taxel_clusters(
    layout: TaxelLayout, by: Literal["patch", "digit"] | float | Sequence[float]
) -> TaxelClusters:
    r"""Groups the taxels of a layout into clusters: its patches, its digits or voxels.

    Voxels begin at the corner of each patch. Their axes are the mean axes of the patch's taxels, or
    the axes of the link if the normals cancel out. A voxel never joins taxels of different patches
    or links. Clusters are numbered by their first taxel.

    The position and normal of a cluster are the means over its taxels. Its link, patch and digit
    are taken from its first taxel. The position of a digit that spans several links is not
    meaningful, since each link has a separate frame.

    Args:
        layout (TaxelLayout): The layout.
        by (str, float or sequence of float): :obj:`"patch"`, :obj:`"digit"`, or the edge length of
            a voxel in metres: one number, or two for :math:`x` and :math:`y`. The larger number is
            the height.

    Raises:
        ValueError: If :obj:`by` is unknown, or a length is not positive.

    Examples:
        >>> from torch_geometric_tactile.sensors import grid
        >>> taxel_clusters(grid(2, 4, pitch=0.002), 0.004).cluster.tolist()
        [0, 0, 1, 1, 0, 0, 1, 1]
    """
    if isinstance(by, str):
        segment = layout.segments(_checked_name(by))
    else:
        segment = _voxels(layout, _checked_size(by))
    cluster = _number_by_first(segment)
    return TaxelClusters(cluster, _cluster_layout(layout, cluster))


def _checked_name(by: str) -> Literal["patch", "digit"]:
    if by in ("patch", "digit"):
        return by  # type: ignore[return-value]
    raise ValueError(f"'by' must be 'patch', 'digit' or lengths in metres (got {by!r})")


def _checked_size(by: float | Sequence[float]) -> Tensor:
    lengths = tuple(by) if isinstance(by, Sequence) else (by, by)
    if len(lengths) != 2 or not all(0 < length < float("inf") for length in lengths):
        raise ValueError(
            f"'by' must be one positive length in metres, or two for x and y (got {by!r})"
        )
    return torch.tensor([*lengths, max(lengths)], dtype=torch.double)


def _voxels(layout: TaxelLayout, size: Tensor) -> Tensor:
    # The index of each taxel's voxel (N,).
    axes, pos = layout.axes().double(), layout.pos.double()
    assert layout.link is not None
    assert layout.patch is not None
    pair = torch.stack([layout.link, layout.patch])
    group = pair.unique(dim=1, return_inverse=True)[1]
    voxel = torch.zeros(len(pos), 4, dtype=torch.long)
    voxel[:, 0] = group
    for index in range(int(group.max()) + 1):
        nodes = group == index
        local_pos = pos[nodes] @ _mean_axes(axes[nodes]).t()
        voxel[nodes, 1:] = (
            ((local_pos - local_pos.amin(dim=0)) / size + _BORDER_TOLERANCE).floor().long()
        )
    return voxel.unique(dim=0, return_inverse=True)[1]


def _mean_axes(axes: Tensor) -> Tensor:
    # The mean axes of a patch as rows (3, 3).
    normal, x = axes[:, 2].mean(dim=0), axes[:, 0].mean(dim=0)
    x = x - normal * (x @ normal) / normal.dot(normal).clamp(min=1e-12)
    if min(normal.norm(), x.norm()) < _MIN_MEAN_LENGTH:
        return torch.eye(3, dtype=axes.dtype)
    normal, x = normal / normal.norm(), x / x.norm()
    return torch.stack([x, torch.linalg.cross(normal, x), normal])


def _number_by_first(segment: Tensor) -> Tensor:
    # The segments numbered from zero without gaps, in the order of their first taxels.
    _, inverse = segment.unique(return_inverse=True)
    first = torch.full((int(inverse.max()) + 1,), len(segment)).scatter_reduce(
        0, inverse, torch.arange(len(segment)), "amin"
    )
    return first.argsort().argsort()[inverse]


def _cluster_layout(layout: TaxelLayout, cluster: Tensor) -> TaxelLayout:
    count = cluster.bincount()
    first = torch.full_like(count, len(cluster)).scatter_reduce(
        0, cluster, torch.arange(len(cluster)), "amin"
    )

    def mean(values: Tensor) -> Tensor:
        total = torch.zeros(len(count), *values.shape[1:], dtype=torch.double)
        return total.index_add(0, cluster, values.double()) / count.view(-1, 1)

    axes = layout.axes()
    normal, x = mean(axes[:, 2]), mean(axes[:, 0])
    # If the axes of a cluster cancel out, it takes the axes of its first taxel.
    cancels = normal.norm(dim=1) < _MIN_MEAN_LENGTH
    normal[cancels] = axes[first[cancels], 2].double()
    normal = normal / normal.norm(dim=1, keepdim=True)
    x = x - normal * (x * normal).sum(dim=1, keepdim=True)
    cancels = x.norm(dim=1) < _MIN_MEAN_LENGTH
    x[cancels] = _project_axis(normal[cancels], axes[first[cancels]].double())
    x = x / x.norm(dim=1, keepdim=True)
    tangent = torch.stack([x, torch.linalg.cross(normal, x)], dim=1)
    indices = {key: getattr(layout, key)[first] for key in ("link", "patch", "digit")}
    return TaxelLayout(
        name=f"{layout.name}_{len(count)}",
        pos=mean(layout.pos).float(),
        normal=normal.float(),
        tangent=tangent.float(),
        **indices,
        link_names=layout.link_names,
        patch_names=layout.patch_names,
        digit_names=layout.digit_names,
        source=f"clusters of '{layout.name}'",
    )


def _project_axis(normal: Tensor, axes: Tensor) -> Tensor:
    # The x or y axis of each taxel that is closer to the plane of the normal, projected onto it.
    cosine = torch.einsum("ni,nki->nk", normal, axes[:, :2]).abs()
    axis = axes[torch.arange(len(axes)), cosine.argmin(dim=1)]
    return axis - normal * (axis * normal).sum(dim=1, keepdim=True)
