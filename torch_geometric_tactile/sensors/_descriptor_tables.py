r"""Computation of the descriptors of readings, with constant tables of a layout."""

import math
from functools import lru_cache
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import one_hot

from torch_geometric_tactile.sensors.layout import TaxelLayout
from torch_geometric_tactile.sensors.sector_edges import layout_sectors

_QUANTILES = (0.02, 0.1, 0.25, 0.5, 0.75, 0.9, 0.98)
_CONTACT_LEVELS = (0.1, 0.5, 1.0)  # scaled readings above which a taxel counts as touched
NUM_DIRECTIONS = 8
_NUM_NEIGHBOURS = 6
_NUM_COARSE_CELLS, _NUM_FINE_CELLS = 4, 9  # of a layout of one patch
_KMEANS_ITERATIONS = 20
_MIN_EIGENVALUE = 1e-5  # in squared extents; smaller ones are rounding errors
_EPS = 1e-12
NAMES = (
    *("mean", "deviation", "largest"),
    *(f"quantile_{round(100 * quantile)}" for quantile in _QUANTILES),
    "skewness",
    *("centroid_x", "centroid_y", "centroid_z"),
    *("moment_xx", "moment_yy", "moment_zz", "moment_xy", "moment_xz", "moment_yz"),
    *("extent_1", "extent_2", "extent_3"),
    *(f"area_{level:g}" for level in _CONTACT_LEVELS),
    *("contrast_mean", "contrast_largest", "contrast_correlation"),
)


class DescriptorTables(NamedTuple):
    r"""Constants of a layout for :func:`compute_descriptors`.

    Shapes:
        - **pos:** positions relative to the layout's centre, in units of its extent :math:`(N, 3)`
        - **nearest:** indices of six neighbours of each taxel :math:`(N, 6)`
        - **weight:** their weights in the mean of the neighbours :math:`(N, 6)`
        - **around:** neighbours in eight directions, then the taxel itself :math:`(N, 9)`
        - **slope:** their weights in the two slopes of a taxel :math:`(N, 2, 9)`
        - **cells:** weight of each taxel in the mean of each cell :math:`(N, 1 + K_1 + K_2)`
        - **bounds:** the first column of each level in :obj:`cells`, then the number of columns
    """

    pos: Tensor
    nearest: Tensor
    weight: Tensor
    around: Tensor
    slope: Tensor
    cells: Tensor
    bounds: tuple[int, ...]

    def like(self, x: Tensor) -> "DescriptorTables":
        r"""Returns the tables on the device and in the precision of readings."""
        pos, nearest, weight, around, slope, cells, bounds = self
        nearest, around = nearest.to(x.device), around.to(x.device)
        tables = (pos.to(x), nearest, weight.to(x), around, slope.to(x), cells.to(x))
        return DescriptorTables(*tables, bounds)


@lru_cache(maxsize=16)
def descriptor_tables(layout: TaxelLayout) -> DescriptorTables:
    r"""Returns the constants of a layout."""
    pos = layout.pos.double()
    group = _groups(layout)
    nearest, weight = _nearest(pos, group)
    around, slope = _slopes(layout)
    levels = _cells(layout, pos, group)
    bounds = (0, *torch.tensor([level.size(1) for level in levels]).cumsum(0).tolist())
    return DescriptorTables(
        pos_to_extents(pos).float(),
        nearest,
        weight.float(),
        around,
        slope.float(),
        torch.cat(levels, dim=1).float(),
        bounds,
    )


def compute_descriptors(x: Tensor, tables: DescriptorTables, pos: Tensor | None = None) -> Tensor:
    r"""Returns the descriptors of a batch of samples. All operations can be exported to a graph.

    Shapes:
        - **x:** :math:`(B, N, F)`
        - **pos:** in units of the extent :math:`(N, 3)` or :math:`(B, N, 3)`
        - **output:** :math:`(B, F \cdot D)`
    """
    x = x.transpose(1, 2)
    nearest = tables.nearest.flatten()
    x = _fill_missing(x, nearest, tables.weight)
    around = (x[..., nearest].unflatten(-1, tables.nearest.shape) * tables.weight).sum(dim=-1)
    pos = tables.pos if pos is None else pos
    fine_cells = tables.cells[:, tables.bounds[2] :]
    parts = [
        *_statistics(x),
        *_moments(x, pos),
        *_contact(x, around),
        x @ fine_cells,
        _slope_histograms(x, tables),
    ]
    return torch.cat(parts, dim=-1).flatten(1)


def _fill_missing(x: Tensor, nearest: Tensor, weight: Tensor) -> Tensor:
    # Replaces NaN by the mean of the neighbours, or of all taxels if they are missing as well.
    missing = x.isnan()
    # An exported graph must not depend on values; otherwise complete readings are unchanged.
    if not torch.compiler.is_compiling() and not missing.any():
        return x
    present = torch.where(missing, 0.0, 1.0).to(x.dtype)
    values = torch.where(missing, 0.0, x)
    total = (values[..., nearest].unflatten(-1, weight.shape) * weight).sum(dim=-1)
    total_weight = (present[..., nearest].unflatten(-1, weight.shape) * weight).sum(dim=-1)
    mean = values.sum(dim=-1, keepdim=True) / present.sum(dim=-1, keepdim=True).clamp(min=1)
    estimate = torch.where(total_weight > 0, total / total_weight.clamp(min=_EPS), mean)
    return torch.where(missing, estimate, values)


def _statistics(x: Tensor) -> list[Tensor]:
    mean = x.mean(dim=-1, keepdim=True)
    centred = x - mean
    deviation = centred.square().mean(dim=-1, keepdim=True).sqrt()
    skewness = centred.pow(3).mean(dim=-1, keepdim=True) / deviation.pow(3).clamp(min=_EPS)
    # Linear interpolation between sorted readings, by operations that can be exported.
    rank = [quantile * (x.size(-1) - 1) for quantile in _QUANTILES]
    below = [math.floor(r) for r in rank]
    above = [math.ceil(r) for r in rank]
    fraction = x.new_tensor([r - b for r, b in zip(rank, below, strict=True)])
    sorted_x = x.sort(dim=-1).values
    quantiles = sorted_x[..., below] * (1 - fraction) + sorted_x[..., above] * fraction
    return [mean, deviation, x.abs().amax(dim=-1, keepdim=True), quantiles, skewness]


def _moments(x: Tensor, pos: Tensor) -> list[Tensor]:
    # Centroid, second moments and their eigenvalues, weighted by |x|.
    a, b = pos[..., [0, 1, 2, 0, 0, 1]], pos[..., [0, 1, 2, 1, 2, 2]]
    weight = x.abs()
    total = weight.sum(dim=-1, keepdim=True).clamp(min=_EPS)
    mean = weight @ torch.cat([pos, a * b], dim=-1) / total
    centre = mean[..., :3]
    moments = mean[..., 3:] - centre[..., [0, 1, 2, 0, 0, 1]] * centre[..., [0, 1, 2, 1, 2, 2]]
    return [centre, moments, _eigenvalues(moments)]


def _eigenvalues(moments: Tensor) -> Tensor:
    # The eigenvalues of symmetric 3 x 3 matrices in closed form, the largest first (Smith, 1961):
    # ONNX has no operation for eigenvalues.
    diagonal, off_diagonal = moments[..., :3], moments[..., 3:]
    mean = diagonal.mean(dim=-1, keepdim=True)
    centred = diagonal - mean
    spread = centred.square().sum(-1, keepdim=True) + 2 * off_diagonal.square().sum(
        -1, keepdim=True
    )
    scale = (spread / 6).sqrt().clamp(min=_EPS)
    (u, v, w), (xy, xz, yz) = (centred / scale).unbind(-1), (off_diagonal / scale).unbind(-1)
    half_det = (u * (v * w - yz * yz) - xy * (xy * w - yz * xz) + xz * (xy * yz - v * xz)) / 2
    angle = half_det.clamp(-1, 1).acos().unsqueeze(-1) / 3
    angles = angle + angle.new_tensor([0.0, 4 * math.pi / 3, 2 * math.pi / 3])
    eigenvalues = mean + 2 * scale * angles.cos()
    # The third of a flat layout must be zero: a scaler would amplify its rounding errors.
    return torch.where(eigenvalues < _MIN_EIGENVALUE, 0.0, eigenvalues)


def _contact(x: Tensor, around: Tensor) -> list[Tensor]:
    # Contact areas, contrast to the mean of the neighbours, and correlation with it.
    areas = [(x > level).to(x.dtype).mean(dim=-1, keepdim=True) for level in _CONTACT_LEVELS]
    difference = (x - around).abs()
    centred_x = x - x.mean(dim=-1, keepdim=True)
    centred_around = around - around.mean(dim=-1, keepdim=True)
    deviations = (
        centred_x.square().mean(-1, keepdim=True).sqrt()
        * centred_around.square().mean(-1, keepdim=True).sqrt()
    )
    correlation = (centred_x * centred_around).mean(dim=-1, keepdim=True) / deviations.clamp(
        min=_EPS
    )
    contrast = [difference.mean(dim=-1, keepdim=True), difference.amax(dim=-1, keepdim=True)]
    return [*areas, *contrast, correlation]


def _slope_histograms(x: Tensor, tables: DescriptorTables) -> Tensor:
    # Histograms of oriented gradients over each cell.
    around = x[..., tables.around.flatten()].unflatten(-1, tables.around.shape)
    slope_x, slope_y = ((around * tables.slope[:, i]).sum(dim=-1) for i in range(2))
    # A taxel adds the length of its slope times the fourth power of the cosine to a direction:
    # (length * cosine) ** 4 / length ** 3.
    inverse_cube = (slope_x.square() + slope_y.square()).clamp(min=_EPS).rsqrt().pow(3)
    up: list[Tensor] = []
    down: list[Tensor] = []
    for i in range(NUM_DIRECTIONS // 2):
        angle = 2 * math.pi * i / NUM_DIRECTIONS
        rise = math.cos(angle) * slope_x + math.sin(angle) * slope_y
        for histograms, positive in ((up, rise.relu()), (down, (-rise).relu())):
            histograms.append((positive.square().square() * inverse_cube) @ tables.cells)
    rises = torch.stack([*up, *down], dim=-1)
    levels = []
    # PyTorch 2.8 compiles `zip` only for equal lengths.
    for start, stop in zip(tables.bounds[:-1], tables.bounds[1:], strict=True):
        level = rises[..., start:stop, :].flatten(-2)
        norm = level.square().sum(dim=-1, keepdim=True).sqrt()
        levels.append((level / norm.clamp(min=_EPS)).sqrt())
    return torch.cat(levels, dim=-1)


def pos_to_extents(pos: Tensor, layout_pos: Tensor | None = None) -> Tensor:
    r"""Returns positions relative to the centre of a layout, scaled so that the longest side of the
    layout is two.
    """
    layout_pos = pos if layout_pos is None else layout_pos
    low, high = layout_pos.amin(dim=0), layout_pos.amax(dim=0)
    return 2 * (pos - (low + high) / 2) / (high - low).max().clamp(min=_EPS)


def _groups(layout: TaxelLayout) -> Tensor:
    # The index of each taxel's patch. A patch on several links is split, since each link has a
    # separate frame.
    assert layout.link is not None
    assert layout.patch is not None
    return torch.stack([layout.link, layout.patch]).unique(dim=1, return_inverse=True)[1]


def _nearest(pos: Tensor, group: Tensor) -> tuple[Tensor, Tensor]:
    # Six neighbours of each taxel in its group, and their weights, zero where there are fewer.
    distance = torch.cdist(pos, pos, compute_mode="donot_use_mm_for_euclid_dist")
    distance[group.view(-1, 1) != group] = math.inf
    distance.fill_diagonal_(math.inf)
    num_neighbours = min(_NUM_NEIGHBOURS, max(1, len(pos) - 1))
    neighbours = distance.topk(min(num_neighbours, len(pos)), largest=False)
    is_neighbour = neighbours.values.isfinite()
    taxel = torch.arange(len(pos)).view(-1, 1)
    is_isolated = ~is_neighbour.any(dim=1, keepdim=True)
    weight = is_neighbour.double() / is_neighbour.sum(dim=1, keepdim=True).clamp(min=1)
    # An isolated taxel is its only neighbour.
    weight = torch.where(is_isolated, 1.0 / neighbours.values.size(1), weight)
    return torch.where(is_neighbour, neighbours.indices, taxel), weight


def _slopes(layout: TaxelLayout) -> tuple[Tensor, Tensor]:
    # The neighbours of each taxel in eight sectors, and the weights of their readings in its slope:
    # a least-squares fit of a plane through the reading of the taxel.
    edges = layout_sectors(layout, NUM_DIRECTIONS)
    source, target = edges.edge_index
    taxel = torch.arange(layout.num_taxels).view(-1, 1).expand(-1, NUM_DIRECTIONS)
    around = taxel.clone()
    around[target, edges.sector] = source
    pos, axes = layout.pos.double(), layout.axes(torch.double)[:, :2]
    offset = torch.einsum("nkd,nad->nka", pos[around] - pos.unsqueeze(1), axes)
    is_neighbour = around != taxel
    length = offset.norm(dim=-1).sum(dim=1) / is_neighbour.sum(dim=1).clamp(min=1)
    offset = offset / length.clamp(min=_EPS).view(-1, 1, 1)
    # Neighbours on a line have no slope across it: small singular values are cut off.
    slope = torch.linalg.pinv(offset, rtol=1e-3) * is_neighbour.unsqueeze(1)
    taxel_slope = -slope.sum(dim=-1, keepdim=True)
    return torch.cat([around, taxel[:, :1]], dim=1), torch.cat([slope, taxel_slope], dim=-1)


def _cells(layout: TaxelLayout, pos: Tensor, group: Tensor) -> list[Tensor]:
    # Weights of the taxels in the means of the layout, of its parts and of its cells.
    num_groups = int(group.max()) + 1
    assert layout.digit is not None
    digits = layout.digit.unique(return_inverse=True)[1]
    if int(digits.max()) > 0:
        parts = one_hot(digits)
    elif num_groups > 1:
        parts = one_hot(group)
    else:
        parts = _soft_cells(pos, _NUM_COARSE_CELLS)
    cells_per_group = max(1, round(_NUM_FINE_CELLS / num_groups))
    cells = torch.zeros(len(pos), 0, dtype=torch.double)
    for index in range(num_groups):
        nodes = (group == index).nonzero().view(-1)
        group_cells = _soft_cells(pos[nodes], cells_per_group)
        padded = torch.zeros(len(pos), group_cells.size(1), dtype=torch.double)
        padded[nodes] = group_cells
        cells = torch.cat([cells, padded], dim=1)
    all_taxels = torch.ones(len(pos), 1)
    return [w.double() / w.double().sum(dim=0) for w in (all_taxels, parts, cells)]


def _soft_cells(pos: Tensor, num_cells: int) -> Tensor:
    # The membership of each taxel in cells around k-means centres (N, K). The first centres are
    # the farthest points, so that the result does not depend on a seed.
    num_cells = min(num_cells, len(pos))
    if num_cells == 1:
        return torch.ones(len(pos), 1, dtype=pos.dtype)
    distance = torch.cdist(pos, pos.mean(dim=0, keepdim=True)).view(-1)
    seeds = [int(distance.argmax())]
    distance = torch.full_like(distance, math.inf)
    while len(seeds) < num_cells:
        distance = distance.minimum((pos - pos[seeds[-1]]).norm(dim=1))
        seeds.append(int(distance.argmax()))
    centre = pos[seeds]
    for _ in range(_KMEANS_ITERATIONS):
        nearest = torch.cdist(pos, centre).argmin(dim=1)
        members = one_hot(nearest, num_cells).to(pos.dtype)
        size = members.sum(dim=0).view(-1, 1)
        # An empty cell keeps its centre.
        centre = torch.where(size > 0, members.t() @ pos / size.clamp(min=1), centre)
    spacing = torch.cdist(centre, centre).fill_diagonal_(math.inf).amin(dim=1).mean()
    return (-(torch.cdist(pos, centre) / spacing).square() * 2).softmax(dim=1)
