r"""The computing of descriptors, and what it needs to know of a layout."""

import math
from functools import lru_cache
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import one_hot

from torch_geometric_tactile.sensors.layout import TaxelLayout
from torch_geometric_tactile.sensors.sector_edges import layout_sectors

_QUANTILES = (0.02, 0.1, 0.25, 0.5, 0.75, 0.9, 0.98)
_LEVELS = (0.1, 0.5, 1.0)  # of the scaled reading, above which a taxel counts as touched
DIRECTIONS = 8
_NEAREST = 6
_COARSE, _FINE = 4, 9  # cells of a layout of one patch
_ROUNDS = 20  # of k-means
_FLAT = 1e-5  # squared extents
_TINY = 1e-12
NAMES = (
    *("mean", "deviation", "largest"),
    *(f"quantile_{round(100 * share)}" for share in _QUANTILES),
    "skewness",
    *("centroid_x", "centroid_y", "centroid_z"),
    *("moment_xx", "moment_yy", "moment_zz", "moment_xy", "moment_xz", "moment_yz"),
    *("extent_1", "extent_2", "extent_3"),
    *(f"area_{level:g}" for level in _LEVELS),
    *("contrast_mean", "contrast_largest", "contrast_correlation"),
)


class DescriptorTables(NamedTuple):
    r"""What :func:`described` needs to know of a layout.

    Shapes:
        - **pos:** places in units of the layout's extent, about its centre :math:`(N, 3)`
        - **nearest:** numbers of neighbours :math:`(N, 6)`, and their weights
        - **around:** neighbours in eight directions and the taxel itself :math:`(N, 9)`
        - **slope:** their weights in the two slopes of a taxel :math:`(N, 2, 9)`
        - **cells:** the share of each taxel in the mean of each cell :math:`(N, 1 + K_1 + K_2)`
    """

    pos: Tensor
    nearest: Tensor
    weight: Tensor
    around: Tensor
    slope: Tensor
    cells: Tensor
    bounds: tuple[int, ...]

    def like(self, x: Tensor) -> "DescriptorTables":
        r"""Returns them on the device and in the precision of readings."""
        pos, nearest, weight, around, slope, cells, bounds = self
        nearest, around = nearest.to(x.device), around.to(x.device)
        tables = (pos.to(x), nearest, weight.to(x), around, slope.to(x), cells.to(x))
        return DescriptorTables(*tables, bounds)


@lru_cache(maxsize=16)
def descriptor_tables(layout: TaxelLayout) -> DescriptorTables:
    r"""Returns the tables of a layout."""
    pos = layout.pos.double()
    group = _groups(layout)
    nearest, weight = _nearest(pos, group)
    around, slope = _slopes(layout)
    levels = _cells(layout, pos, group)
    bounds = (0, *torch.tensor([level.size(1) for level in levels]).cumsum(0).tolist())
    return DescriptorTables(
        in_extents(pos).float(),
        nearest,
        weight.float(),
        around,
        slope.float(),
        torch.cat(levels, dim=1).float(),
        bounds,
    )


def described(x: Tensor, tables: DescriptorTables, pos: Tensor | None = None) -> Tensor:
    r"""Returns the descriptors of many samples, by operations that an exported graph may hold.

    Shapes:
        - **x:** :math:`(B, N, F)`
        - **pos:** in units of the extent :math:`(N, 3)` or :math:`(B, N, 3)`
        - **output:** :math:`(B, F \cdot D)`
    """
    x = x.transpose(1, 2)
    near = tables.nearest.flatten()
    x = _filled(x, near, tables.weight)
    around = (x[..., near].unflatten(-1, tables.nearest.shape) * tables.weight).sum(dim=-1)
    pos = tables.pos if pos is None else pos
    fine = tables.cells[:, tables.bounds[2] :]
    parts = [*_statistics(x), *_places(x, pos), *_contact(x, around), x @ fine, _rises(x, tables)]
    return torch.cat(parts, dim=-1).flatten(1)


def _filled(x: Tensor, near: Tensor, weight: Tensor) -> Tensor:
    missing = x.isnan()
    if not torch.compiler.is_compiling() and not missing.any():
        return x
    known = torch.where(missing, 0.0, 1.0).to(x.dtype)
    values = torch.where(missing, 0.0, x)
    around = (values[..., near].unflatten(-1, weight.shape) * weight).sum(dim=-1)
    part = (known[..., near].unflatten(-1, weight.shape) * weight).sum(dim=-1)
    mean = values.sum(dim=-1, keepdim=True) / known.sum(dim=-1, keepdim=True).clamp(min=1)
    guess = torch.where(part > 0, around / part.clamp(min=_TINY), mean)
    return torch.where(missing, guess, values)


def _statistics(x: Tensor) -> list[Tensor]:
    mean = x.mean(dim=-1, keepdim=True)
    off = x - mean
    deviation = off.square().mean(dim=-1, keepdim=True).sqrt()
    skewness = off.pow(3).mean(dim=-1, keepdim=True) / deviation.pow(3).clamp(min=_TINY)
    place = [share * (x.size(-1) - 1) for share in _QUANTILES]
    below = [math.floor(p) for p in place]
    above = [math.ceil(p) for p in place]
    part = x.new_tensor([p - b for p, b in zip(place, below, strict=True)])
    sorted_x = x.sort(dim=-1).values
    quantiles = sorted_x[..., below] * (1 - part) + sorted_x[..., above] * part
    return [mean, deviation, x.abs().amax(dim=-1, keepdim=True), quantiles, skewness]


def _places(x: Tensor, pos: Tensor) -> list[Tensor]:
    # Centroid, second moments and their eigenvalues, weighted by |x|.
    a, b = pos[..., [0, 1, 2, 0, 0, 1]], pos[..., [0, 1, 2, 1, 2, 2]]
    weight = x.abs()
    total = weight.sum(dim=-1, keepdim=True).clamp(min=_TINY)
    mean = weight @ torch.cat([pos, a * b], dim=-1) / total
    centre = mean[..., :3]
    moments = mean[..., 3:] - centre[..., [0, 1, 2, 0, 0, 1]] * centre[..., [0, 1, 2, 1, 2, 2]]
    return [centre, moments, _eigenvalues(moments)]


def _eigenvalues(moments: Tensor) -> Tensor:
    # Of symmetric 3 x 3 matrices, the largest first (Smith, 1961).
    diagonal, across = moments[..., :3], moments[..., 3:]
    middle = diagonal.mean(dim=-1, keepdim=True)
    off = diagonal - middle
    spread = off.square().sum(-1, keepdim=True) + 2 * across.square().sum(-1, keepdim=True)
    scale = (spread / 6).sqrt().clamp(min=_TINY)
    (u, v, w), (xy, xz, yz) = (off / scale).unbind(-1), (across / scale).unbind(-1)
    half = (u * (v * w - yz * yz) - xy * (xy * w - yz * xz) + xz * (xy * yz - v * xz)) / 2
    angle = half.clamp(-1, 1).acos().unsqueeze(-1) / 3
    turns = angle + angle.new_tensor([0.0, 4 * math.pi / 3, 2 * math.pi / 3])
    found = middle + 2 * scale * turns.cos()
    # The third of a flat layout is zero, not rounding errors, which a scaler would blow up.
    return torch.where(found < _FLAT, 0.0, found)


def _contact(x: Tensor, around: Tensor) -> list[Tensor]:
    areas = [(x > level).to(x.dtype).mean(dim=-1, keepdim=True) for level in _LEVELS]
    difference = (x - around).abs()
    own = x - x.mean(dim=-1, keepdim=True)
    other = around - around.mean(dim=-1, keepdim=True)
    size = own.square().mean(-1, keepdim=True).sqrt() * other.square().mean(-1, keepdim=True).sqrt()
    correlation = (own * other).mean(dim=-1, keepdim=True) / size.clamp(min=_TINY)
    contrast = [difference.mean(dim=-1, keepdim=True), difference.amax(dim=-1, keepdim=True)]
    return [*areas, *contrast, correlation]


def _rises(x: Tensor, tables: DescriptorTables) -> Tensor:
    around = x[..., tables.around.flatten()].unflatten(-1, tables.around.shape)
    along, across = ((around * tables.slope[:, i]).sum(dim=-1) for i in range(2))
    # The length times the fourth power of the cosine.
    per_length = (along.square() + across.square()).clamp(min=_TINY).rsqrt().pow(3)
    up: list[Tensor] = []
    down: list[Tensor] = []
    for i in range(DIRECTIONS // 2):
        angle = 2 * math.pi * i / DIRECTIONS
        rise = math.cos(angle) * along + math.sin(angle) * across
        for found, positive in ((up, rise.relu()), (down, (-rise).relu())):
            found.append((positive.square().square() * per_length) @ tables.cells)
    rises = torch.stack([*up, *down], dim=-1)
    levels = []
    # Of equal lengths: PyTorch 2.8 compiles no other `zip`.
    for start, stop in zip(tables.bounds[:-1], tables.bounds[1:], strict=True):
        level = rises[..., start:stop, :].flatten(-2)
        size = level.square().sum(dim=-1, keepdim=True).sqrt()
        levels.append((level / size.clamp(min=_TINY)).sqrt())
    return torch.cat(levels, dim=-1)


def in_extents(pos: Tensor, of: Tensor | None = None) -> Tensor:
    # Places about the layout's centre, of which the largest side is two.
    of = pos if of is None else of
    low, high = of.amin(dim=0), of.amax(dim=0)
    return 2 * (pos - (low + high) / 2) / (high - low).max().clamp(min=_TINY)


def _groups(layout: TaxelLayout) -> Tensor:
    # The patch of each taxel, on each link by itself, as each link has a frame of its own.
    assert layout.link is not None
    assert layout.patch is not None
    return torch.stack([layout.link, layout.patch]).unique(dim=1, return_inverse=True)[1]


def _nearest(pos: Tensor, group: Tensor) -> tuple[Tensor, Tensor]:
    # Six neighbours of each taxel on its patch and their weights, zero where there are fewer.
    distance = torch.cdist(pos, pos, compute_mode="donot_use_mm_for_euclid_dist")
    distance[group.view(-1, 1) != group] = math.inf
    distance.fill_diagonal_(math.inf)
    count = min(_NEAREST, max(1, len(pos) - 1))
    found = distance.topk(min(count, len(pos)), largest=False)
    there = found.values.isfinite()
    own = torch.arange(len(pos)).view(-1, 1)
    alone = ~there.any(dim=1, keepdim=True)  # is its own neighbour
    weight = there.double() / there.sum(dim=1, keepdim=True).clamp(min=1)
    weight = torch.where(alone, 1.0 / found.values.size(1), weight)
    return torch.where(there, found.indices, own), weight


def _slopes(layout: TaxelLayout) -> tuple[Tensor, Tensor]:
    # Of each taxel its neighbours in eight sectors, and what of their differences is the slope.
    edges = layout_sectors(layout, DIRECTIONS)
    source, target = edges.edge_index
    own = torch.arange(layout.num_taxels).view(-1, 1).expand(-1, DIRECTIONS)
    around = own.clone()
    around[target, edges.sector] = source
    pos, axes = layout.pos.double(), layout.axes(torch.double)[:, :2]
    offset = torch.einsum("nkd,nad->nka", pos[around] - pos.unsqueeze(1), axes)
    there = around != own
    length = offset.norm(dim=-1).sum(dim=1) / there.sum(dim=1).clamp(min=1)
    offset = offset / length.clamp(min=_TINY).view(-1, 1, 1)
    slope = torch.linalg.pinv(offset, rtol=1e-3) * there.unsqueeze(1)
    own_slope = -slope.sum(dim=-1, keepdim=True)
    return torch.cat([around, own[:, :1]], dim=1), torch.cat([slope, own_slope], dim=-1)


def _cells(layout: TaxelLayout, pos: Tensor, group: Tensor) -> list[Tensor]:
    # Shares of the taxels in the means of the whole, of its parts and of its cells.
    count = int(group.max()) + 1
    assert layout.digit is not None
    digits = layout.digit.unique(return_inverse=True)[1]
    if int(digits.max()) > 0:
        parts = one_hot(digits)
    elif count > 1:
        parts = one_hot(group)
    else:
        parts = _soft_cells(pos, _COARSE)
    each = max(1, round(_FINE / count))
    cells = torch.zeros(len(pos), 0, dtype=torch.double)
    for number in range(count):
        nodes = (group == number).nonzero().view(-1)
        own = _soft_cells(pos[nodes], each)
        wide = torch.zeros(len(pos), own.size(1), dtype=torch.double)
        wide[nodes] = own
        cells = torch.cat([cells, wide], dim=1)
    whole = torch.ones(len(pos), 1)
    return [w.double() / w.double().sum(dim=0) for w in (whole, parts, cells)]


def _soft_cells(pos: Tensor, count: int) -> Tensor:
    # What each taxel has of cells about centres that lie as far apart as they can.
    count = min(count, len(pos))
    if count == 1:
        return torch.ones(len(pos), 1, dtype=pos.dtype)
    distance = torch.cdist(pos, pos.mean(dim=0, keepdim=True)).view(-1)
    chosen = [int(distance.argmax())]
    distance = torch.full_like(distance, math.inf)
    while len(chosen) < count:
        distance = distance.minimum((pos - pos[chosen[-1]]).norm(dim=1))
        chosen.append(int(distance.argmax()))
    centre = pos[chosen]
    for _ in range(_ROUNDS):  # k-means
        nearest = torch.cdist(pos, centre).argmin(dim=1)
        own = one_hot(nearest, count).to(pos.dtype)
        size = own.sum(dim=0).view(-1, 1)
        centre = torch.where(size > 0, own.t() @ pos / size.clamp(min=1), centre)
    apart = torch.cdist(centre, centre).fill_diagonal_(math.inf).amin(dim=1).mean()
    return (-(torch.cdist(pos, centre) / apart).square() * 2).softmax(dim=1)
