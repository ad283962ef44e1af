r"""The nearest neighbour of each taxel in every direction."""

import math
from typing import Literal, NamedTuple

import torch
from torch import Tensor

from torch_geometric_tactile._checks import need
from torch_geometric_tactile.sensors.checks import check_segment
from torch_geometric_tactile.sensors.layout import TaxelLayout

# Positions are single precision, in metres: distances and angles closer than this are equal.
_TIE = 1e-4
_MOST_PAIRS = 1 << 22  # computed at once
_MAX_SECTORS = 360
_REACH = 3.0  # times the distance between neighbours


class SectorEdges(NamedTuple):
    r"""Edges, and the sector that each lies in.

    Args:
        edge_index (torch.Tensor): Edges from the neighbour to the taxel :math:`(2,
            |\mathcal{E}|)`, sorted by taxel and sector.
        sector (torch.Tensor): The sector of each :math:`(|\mathcal{E}|,)`.

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
    axes :math:`\mathbf{u}_i, \mathbf{v}_i` of the taxel, and its angle
    :math:`\operatorname{atan2}(\mathbf{v}_i \cdot \mathbf{d}, \mathbf{u}_i \cdot \mathbf{d})`
    decides the sector: number 0 is centred on the :math:`x` axis, and the others follow
    counter-clockwise as seen from the tip of :math:`\mathbf{u}_i \times \mathbf{v}_i`. A border
    between two sectors belongs to the one that follows it. On a grid whose pitches differ by a
    factor of 2.4 at most, eight sectors are the eight cells around.

    *Nearest* is the distance in space. Of neighbours at the same distance (to a ten-thousandth) the
    one closer to the middle of the sector is taken, and then the one with the lower number. What
    lies exactly above or below a taxel is in no sector.

    Args:
        pos (torch.Tensor): Positions in metres :math:`(N, 3)`.
        axes (torch.Tensor): Unit axes of each taxel as rows, of which the first two are used, as
            :obj:`layout.axes()` returns them :math:`(N, 3, 3)` or :math:`(N, 2, 3)`.
        num_sectors (int): Number of sectors.
        radius (float, optional): Largest distance of a neighbour in metres. If left out, three
            times the distance of the taxel to its nearest neighbour or the median of these
            distances in its group, whichever is larger.
        group (torch.Tensor, optional): A whole number for each taxel, such as its patch
            :math:`(N,)`; taxels of different groups are no neighbours. All are in one if left out.

    Returns:
        SectorEdges: :obj:`edge_index` and :obj:`sector`.

    Raises:
        ValueError: If :obj:`pos` or :obj:`axes` has another shape, :obj:`num_sectors` is below one,
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
            f"'axes' must have shape ({num_taxels}, 3, 3), those of the taxels of 'pos' "
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
    for number in group.unique():
        nodes = (group == number).nonzero().view(-1)
        limit = _limit(pos[nodes], radius)
        for rows in _blocks(len(nodes)):
            found = _nearest(pos[nodes], axes[nodes[rows]], rows, limit[rows], num_sectors)
            neighbour[nodes[rows]] = torch.where(found < 0, found, nodes[found])
    target, sector = (neighbour >= 0).nonzero(as_tuple=True)
    return SectorEdges(torch.stack([neighbour[target, sector], target]), sector)


def layout_sectors(
    layout: TaxelLayout,
    num_sectors: int = 8,
    radius: float | None = None,
    within: Literal["patch", "link"] = "patch",
) -> SectorEdges:
    r"""Connects each taxel of a layout with its nearest neighbour in each sector, by
    :func:`sector_edges` and the layout's axes.

    Args:
        layout (TaxelLayout): The layout.
        num_sectors (int): Number of sectors.
        radius (float, optional): As in :func:`sector_edges`.
        within (str): What neighbours share: the :obj:`"patch"`, or only the :obj:`"link"`. Places
            of taxels on different links are in different frames.

    Raises:
        ValueError: If :obj:`within` is neither, or :func:`sector_edges` raises it.

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


def _blocks(num_taxels: int) -> tuple[Tensor, ...]:
    return torch.arange(num_taxels).split(max(1, _MOST_PAIRS // max(1, num_taxels)))


def _limit(pos: Tensor, radius: float | None) -> Tensor:
    # The largest distance of a neighbour, of each taxel (N,).
    if radius is not None:
        return pos.new_full((len(pos),), radius)
    nearest = torch.cat([_distance(pos[rows], pos, rows).amin(dim=1) for rows in _blocks(len(pos))])
    return _REACH * nearest.clamp(min=float(nearest.median()))


def _distance(rows_pos: Tensor, pos: Tensor, rows: Tensor) -> Tensor:
    distance = torch.cdist(rows_pos, pos, compute_mode="donot_use_mm_for_euclid_dist")
    distance[torch.arange(len(rows)), rows] = math.inf  # none is its own neighbour
    return distance


def _nearest(pos: Tensor, axes: Tensor, rows: Tensor, limit: Tensor, num_sectors: int) -> Tensor:
    # The neighbours of some taxels in each sector, -1 where there is none (R, S).
    distance = _distance(pos[rows], pos, rows)
    offset = torch.einsum("rki,rni->krn", axes[:, :2], pos - pos[rows].unsqueeze(1))
    width = 2 * math.pi / num_sectors
    turn = torch.atan2(offset[1], offset[0]) / width  # in sectors
    sector = (turn + 0.5 + _TIE).floor()
    off_middle = (turn - sector).abs()
    flat = offset.square().sum(dim=0).sqrt()
    reached = (distance <= limit.unsqueeze(1) * (1 + _TIE)) & (flat > _TIE * distance)
    sector = sector.long() % num_sectors
    found = []
    for number in range(num_sectors):
        here = reached & (sector == number)
        for value, step in ((distance, _TIE), (off_middle, 0.0)):
            value = value.masked_fill(~here, math.inf)
            least = value.amin(dim=1, keepdim=True)
            here = here & (value <= least * (1 + step) + _TIE * (step == 0))
        first = here.int().argmax(dim=1)
        found.append(torch.where(here.any(dim=1), first, -1))
    return torch.stack(found, dim=1)
