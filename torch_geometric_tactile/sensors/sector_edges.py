r"""The nearest neighbour of each taxel in every direction."""

import math
from typing import Literal, NamedTuple

import torch
from torch import Tensor

from torch_geometric_tactile._checks import need
from torch_geometric_tactile.sensors._checks import check_segment
from torch_geometric_tactile.sensors.layout import TaxelLayout

# Relative difference below which distances and angles are equal: positions are single precision.
_TOLERANCE = 1e-4
_MAX_PAIRS = 1 << 22  # distances at a time, to limit memory
_MAX_SECTORS = 360
_RADIUS_FACTOR = 3.0  # default radius over the distance between neighbours


class SectorEdges(NamedTuple):
    r"""Edges, and the sector of each edge.

    Args:
        edge_index (torch.Tensor): Edges from the neighbour to the taxel :math:`(2,
            |\mathcal{E}|)`, sorted by taxel and sector.
        sector (torch.Tensor): Sector of each edge :math:`(|\mathcal{E}|,)`.

    Examples:
        >>> from torch_geometric_tactile.sensors import grid
        >>> layout = grid(3, 3, pitch=0.004)
        >>> edges = sector_edges(layout.pos, layout.axes())
        >>> edges.edge_index.shape[1] == len(edges.sector)
        True
    """

    edge_index: Tensor
    sector: Tensor


def sector_edges(
    pos: Tensor,
    axes: Tensor,
    num_sectors: int = 8,
    radius: float | None = None,
    group: Tensor | None = None,
) -> SectorEdges:
    r"""Connects each taxel with its nearest neighbour in each sector of its tangent plane.

    The offset :math:`\mathbf{d} = \mathbf{p}_j - \mathbf{p}_i` of a neighbour is projected on the
    axes :math:`\mathbf{u}_i, \mathbf{v}_i` of the taxel. Its angle
    :math:`\operatorname{atan2}(\mathbf{v}_i \cdot \mathbf{d}, \mathbf{u}_i \cdot \mathbf{d})`
    determines the sector. Sector 0 is centred on the :math:`x` axis, and the others follow
    counter-clockwise as seen from the tip of :math:`\mathbf{u}_i \times \mathbf{v}_i`. The border
    between two sectors belongs to the following sector. On a grid whose pitches differ by a factor
    of at most 2.4, the eight sectors contain the eight surrounding cells.

    The nearest neighbour has the smallest distance in space. Among neighbours at the same distance
    (within a relative difference of 1e-4), the neighbour closest to the middle of the sector is
    used, then the neighbour with the lowest index. Taxels exactly above or below a taxel are in no
    sector.

    Args:
        pos (torch.Tensor): Positions in metres :math:`(N, 3)`.
        axes (torch.Tensor): Unit axes of each taxel as rows :math:`(N, 3, 3)` or :math:`(N, 2, 3)`,
            such as :obj:`layout.axes()`. The first two axes are used.
        num_sectors (int): Number of sectors.
        radius (float, optional): Largest distance of a neighbour in metres. By default three times
            the distance of the taxel to its nearest neighbour or the median of these distances in
            its group, whichever is larger.
        group (torch.Tensor, optional): An integer for each taxel, such as its patch :math:`(N,)`.
            Neighbours are in the same group. By default all taxels are in one group.

    Returns:
        SectorEdges: :obj:`edge_index` and :obj:`sector`.

    Raises:
        ValueError: If :obj:`pos` or :obj:`axes` has a wrong shape, :obj:`num_sectors` is below one,
            or :obj:`radius` is not positive.

    Examples:
        >>> from torch_geometric_tactile.sensors import grid
        >>> layout = grid(2, 2, pitch=0.002)
        >>> edge_index, sector = sector_edges(layout.pos, torch.eye(3).expand(4, 3, 3))
        >>> edge_index[:, :3].tolist(), sector[:3].tolist()
        ([[1, 3, 2], [0, 0, 0]], [0, 1, 2])
    """
    if pos.dim() != 2 or pos.size(1) != 3:
        raise ValueError(f"'pos' must have shape (num_taxels, 3) (got {tuple(pos.shape)})")
    num_taxels = len(pos)
    if axes.dim() != 3 or tuple(axes.shape) not in ((num_taxels, 2, 3), (num_taxels, 3, 3)):
        raise ValueError(
            f"'axes' must have shape ({num_taxels}, 3, 3), the axes of each taxel of 'pos' "
            f"(got {tuple(axes.shape)})"
        )
    need(num_sectors >= 1, "'num_sectors' must be at least 1", num_sectors)
    need(
        num_sectors <= _MAX_SECTORS,
        f"'num_sectors' must be at most {_MAX_SECTORS}, one for each degree",
        num_sectors,
    )
    need(radius is None or radius > 0, "'radius' must be positive metres", radius)
    if group is None:
        group = torch.zeros(num_taxels, dtype=torch.long)
    group = check_segment(group, num_taxels, "'group'", gaps=True)
    pos, axes = pos.double(), axes.double()
    neighbour = torch.full((num_taxels, num_sectors), -1, dtype=torch.long, device=pos.device)
    for index in group.unique():
        nodes = (group == index).nonzero().view(-1)
        limit = _max_distance(pos[nodes], radius)
        for rows in _row_blocks(len(nodes)):
            nearest = _nearest(pos[nodes], axes[nodes[rows]], rows, limit[rows], num_sectors)
            neighbour[nodes[rows]] = torch.where(nearest < 0, nearest, nodes[nearest])
    target, sector = (neighbour >= 0).nonzero(as_tuple=True)
    return SectorEdges(torch.stack([neighbour[target, sector], target]), sector)


def layout_sectors(
    layout: TaxelLayout,
    num_sectors: int = 8,
    radius: float | None = None,
    within: Literal["patch", "link"] = "patch",
) -> SectorEdges:
    r"""Connects each taxel of a layout with its nearest neighbour in each sector (see
    :func:`sector_edges`). The axes of the layout define the sectors.

    Args:
        layout (TaxelLayout): The layout.
        num_sectors (int): Number of sectors.
        radius (float, optional): As in :func:`sector_edges`.
        within (str): Whether neighbours must be on the same :obj:`"patch"` or on the same
            :obj:`"link"`. Positions on different links are in different frames.

    Raises:
        ValueError: If :obj:`within` is unknown, or an argument is invalid in :func:`sector_edges`.

    Examples:
        >>> from torch_geometric_tactile.sensors import grid
        >>> layout_sectors(grid(2, 3, pitch=0.002)).sector.bincount().tolist()
        [4, 2, 3, 2, 4, 2, 3, 2]
    """
    need(within in ("patch", "link"), f"'within' must be 'patch' or 'link' (got {within!r})")
    assert layout.link is not None
    assert layout.patch is not None
    group = layout.link
    if within == "patch":
        group = torch.stack([layout.link, layout.patch]).unique(dim=1, return_inverse=True)[1]
    return sector_edges(layout.pos, layout.axes(), num_sectors, radius, group)


def _row_blocks(num_taxels: int) -> tuple[Tensor, ...]:
    return torch.arange(num_taxels).split(max(1, _MAX_PAIRS // max(1, num_taxels)))


def _max_distance(pos: Tensor, radius: float | None) -> Tensor:
    # The largest distance of a neighbour for each taxel (N,).
    if radius is not None:
        return pos.new_full((len(pos),), radius)
    nearest = torch.cat(
        [_distance(pos[rows], pos, rows).amin(dim=1) for rows in _row_blocks(len(pos))]
    )
    return _RADIUS_FACTOR * nearest.clamp(min=float(nearest.median()))


def _distance(rows_pos: Tensor, pos: Tensor, rows: Tensor) -> Tensor:
    # The distances between the taxels of some rows and all taxels (R, N), infinite to themselves.
    # The faster mode of cdist, by a matrix product, is not precise enough for short distances.
    distance = torch.cdist(rows_pos, pos, compute_mode="donot_use_mm_for_euclid_dist")
    distance[torch.arange(len(rows)), rows] = math.inf
    return distance


def _nearest(pos: Tensor, axes: Tensor, rows: Tensor, limit: Tensor, num_sectors: int) -> Tensor:
    # The nearest neighbour in each sector of the taxels of some rows (R, S), or -1.
    distance = _distance(pos[rows], pos, rows)
    offset = torch.einsum("rki,rni->krn", axes[:, :2], pos - pos[rows].unsqueeze(1))
    width = 2 * math.pi / num_sectors
    angle = torch.atan2(offset[1], offset[0]) / width  # in sectors
    sector = (angle + 0.5 + _TOLERANCE).floor()
    from_middle = (angle - sector).abs()
    planar_distance = offset.square().sum(dim=0).sqrt()
    is_near = (distance <= limit.unsqueeze(1) * (1 + _TOLERANCE)) & (
        planar_distance > _TOLERANCE * distance
    )
    sector = sector.long() % num_sectors
    neighbours = []
    for index in range(num_sectors):
        is_candidate = is_near & (sector == index)
        # Keep the nearest candidates, with a relative tolerance, and of these the candidates
        # closest to the middle of the sector, with an absolute tolerance.
        for criterion, relative in ((distance, _TOLERANCE), (from_middle, 0.0)):
            criterion = criterion.masked_fill(~is_candidate, math.inf)
            minimum = criterion.amin(dim=1, keepdim=True)
            is_candidate = is_candidate & (
                criterion <= minimum * (1 + relative) + _TOLERANCE * (relative == 0)
            )
        first = is_candidate.int().argmax(dim=1)
        neighbours.append(torch.where(is_candidate.any(dim=1), first, -1))
    return torch.stack(neighbours, dim=1)
