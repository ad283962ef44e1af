r"""Neighbouring taxels joined to larger ones."""

from collections.abc import Sequence
from typing import Literal, NamedTuple

import torch
from torch import Tensor

from torch_geometric_tactile.sensors.layout import TaxelLayout

# Of a voxel: positions are single precision, and a taxel on a border belongs to the voxel above.
_TIE = 1e-3
# A patch whose normals cancel out has no plane of its own.
_NO_PLANE = 0.1


class TaxelClusters(NamedTuple):
    r"""The cluster of each taxel, and the layout of the clusters.

    Args:
        cluster (torch.Tensor): The cluster of each taxel :math:`(N,)`.
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
    r"""Clusters the taxels of each patch, digit or voxel.

    A voxel is counted from the corner of its patch, in the patch's own plane: its axes are the
    means of the taxels' axes (those of the link, if the normals cancel out). It never joins taxels
    of different patches or links. Clusters are numbered by their first taxel.

    A cluster lies at the mean of its taxels and has the mean of their normals, and the link, the
    patch and the digit of the first of them: the places of digits on several links say little.

    Args:
        layout (TaxelLayout): The layout.
        by (str, float or sequence of float): :obj:`"patch"`, :obj:`"digit"`, or the edge length of
            a voxel in metres: one number, or two for :math:`x` and :math:`y`, of which the larger
            is the height.

    Raises:
        ValueError: If :obj:`by` is neither, or a length is not positive.

    Examples:
        >>> from torch_geometric_tactile.sensors import grid
        >>> taxel_clusters(grid(2, 4, pitch=0.002), 0.004).cluster.tolist()
        [0, 0, 1, 1, 0, 0, 1, 1]
    """
    if isinstance(by, str):
        number = layout.segments(_checked_name(by))
    else:
        number = _voxels(layout, _checked_size(by))
    cluster = _by_first(number)
    return TaxelClusters(cluster, _coarse(layout, cluster))


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
    axes, pos = layout.axes().double(), layout.pos.double()
    assert layout.link is not None
    assert layout.patch is not None
    pair = torch.stack([layout.link, layout.patch])
    group = pair.unique(dim=1, return_inverse=True)[1]
    voxel = torch.zeros(len(pos), 4, dtype=torch.long)
    voxel[:, 0] = group
    for number in range(int(group.max()) + 1):
        nodes = group == number
        place = pos[nodes] @ _plane(axes[nodes]).t()
        voxel[nodes, 1:] = ((place - place.amin(dim=0)) / size + _TIE).floor().long()
    return voxel.unique(dim=0, return_inverse=True)[1]


def _plane(axes: Tensor) -> Tensor:
    # The mean axes of a patch as rows (3, 3).
    normal, x = axes[:, 2].mean(dim=0), axes[:, 0].mean(dim=0)
    x = x - normal * (x @ normal) / normal.dot(normal).clamp(min=1e-12)
    if min(normal.norm(), x.norm()) < _NO_PLANE:
        return torch.eye(3, dtype=axes.dtype)
    normal, x = normal / normal.norm(), x / x.norm()
    return torch.stack([x, torch.linalg.cross(normal, x), normal])


def _by_first(number: Tensor) -> Tensor:
    # Numbers from zero without gaps, by the first taxel that has each.
    _, inverse = number.unique(return_inverse=True)
    first = torch.full((int(inverse.max()) + 1,), len(number)).scatter_reduce(
        0, inverse, torch.arange(len(number)), "amin"
    )
    return first.argsort().argsort()[inverse]


def _coarse(layout: TaxelLayout, cluster: Tensor) -> TaxelLayout:
    count = cluster.bincount()
    first = torch.full_like(count, len(cluster)).scatter_reduce(
        0, cluster, torch.arange(len(cluster)), "amin"
    )

    def mean(values: Tensor) -> Tensor:
        total = torch.zeros(len(count), *values.shape[1:], dtype=torch.double)
        return total.index_add(0, cluster, values.double()) / count.view(-1, 1)

    axes = layout.axes()
    normal, x = mean(axes[:, 2]), mean(axes[:, 0])
    lost = normal.norm(dim=1) < _NO_PLANE
    normal[lost] = axes[first[lost], 2].double()
    normal = normal / normal.norm(dim=1, keepdim=True)
    x = x - normal * (x * normal).sum(dim=1, keepdim=True)
    lost = x.norm(dim=1) < _NO_PLANE
    x[lost] = _across(normal[lost], axes[first[lost]].double())
    x = x / x.norm(dim=1, keepdim=True)
    tangent = torch.stack([x, torch.linalg.cross(normal, x)], dim=1)
    numbers = {key: getattr(layout, key)[first] for key in ("link", "patch", "digit")}
    return TaxelLayout(
        name=f"{layout.name}_{len(count)}",
        pos=mean(layout.pos).float(),
        normal=normal.float(),
        tangent=tangent.float(),
        **numbers,
        link_names=layout.link_names,
        patch_names=layout.patch_names,
        digit_names=layout.digit_names,
        source=f"clusters of '{layout.name}'",
    )


def _across(normal: Tensor, axes: Tensor) -> Tensor:
    # The axis of each first taxel that is closest to the plane at right angles to a normal.
    angle = torch.einsum("ni,nki->nk", normal, axes[:, :2]).abs()
    axis = axes[torch.arange(len(axes)), angle.argmin(dim=1)]
    return axis - normal * (axis * normal).sum(dim=1, keepdim=True)
