r"""Layouts of planar arrays of taxels."""

import math
from collections.abc import Mapping, Sequence

import torch
from torch import Tensor

from torch_geometric_tactile._checks import need
from torch_geometric_tactile.sensors._content_checks import MAX_TAXELS
from torch_geometric_tactile.sensors.layout import TaxelLayout

_Pairs = Sequence[tuple[Tensor, Tensor]]  # taxel indices of the two ends of edges
_STRAIGHT = ((0, 1), (1, 0))
_SLANTED = ((1, 1), (1, -1))


def grid(rows: int, cols: int, pitch: float) -> TaxelLayout:
    r"""Returns the layout of a rectangular array of taxels, numbered row by row, in the :math:`xy`
    plane with normals along :math:`+z`. The first taxel is at the origin, :math:`x` points to the
    next column and :math:`y` to the next row. These are also the axes of the taxels.

    The adjacencies are :obj:`"original"` (four straight neighbours), :obj:`"slanted"` (four
    diagonal neighbours) and :obj:`"dense"` (all eight). Each edge exists in both directions.

    Args:
        rows (int): Number of rows.
        cols (int): Number of columns.
        pitch (float): Distance between neighbouring taxels in metres.

    Raises:
        ValueError: If :obj:`rows`, :obj:`cols` or :obj:`pitch` is not positive, or there are more
            than a million taxels.

    Examples:
        >>> layout = grid(4, 4, pitch=0.004667)
        >>> layout
        TaxelLayout('grid_4x4', num_taxels=16, patches=1, digits=1)
        >>> layout.edge_index("original").shape
        torch.Size([2, 48])
    """
    cell, index = _cells(rows, cols, pitch)
    pairs = {
        "original": _neighbour_pairs(index, _STRAIGHT),
        "slanted": _neighbour_pairs(index, _SLANTED),
        "dense": _neighbour_pairs(index, _STRAIGHT + _SLANTED),
    }
    x, y = cell[:, 1] * pitch, cell[:, 0] * pitch
    return _planar(f"grid_{rows}x{cols}", cell, x, y, pairs, "planar grid")


def hexagonal(rows: int, cols: int, pitch: float) -> TaxelLayout:
    r"""Returns the layout of an array of taxels with six neighbours each, numbered row by row, in
    the :math:`xy` plane with normals along :math:`+z`. The first taxel is at the origin. Rows are
    parallel to :math:`x`, and their distance along :math:`y` is :math:`\sqrt{3} / 2` of the pitch.
    Every second row (the second, the fourth) is shifted by half a pitch along :math:`+x`. The axes
    of the taxels are :math:`x` and :math:`y`.

    The adjacency :obj:`"original"` joins each taxel with its six neighbours, in both directions.
    The image map uses offset coordinates: the row, and the index within the row. In the image of a
    convolutional network, every second row is therefore shifted by half a pixel.

    Args:
        rows (int): Number of rows.
        cols (int): Number of taxels in each row.
        pitch (float): Distance between neighbouring taxels in metres.

    Raises:
        ValueError: If :obj:`rows`, :obj:`cols` or :obj:`pitch` is not positive, or there are more
            than a million taxels.

    Examples:
        >>> layout = hexagonal(3, 4, pitch=0.00125)
        >>> layout
        TaxelLayout('hexagonal_3x4', num_taxels=12, patches=1, digits=1)
        >>> layout.edge_index("original").shape
        torch.Size([2, 46])
    """
    cell, index = _cells(rows, cols, pitch)
    pairs = [
        (index[:, :-1], index[:, 1:]),  # along a row
        (index[:-1], index[1:]),  # to the same index in the next row
        (index[:-1:2, 1:], index[1::2, :-1]),  # to the next row, if that is shifted
        (index[1:-1:2, :-1], index[2::2, 1:]),  # to the next row, from a shifted row
    ]
    row, col = cell.double().unbind(dim=1)
    x, y = pitch * (col + 0.5 * (row % 2)), pitch * math.sqrt(0.75) * row
    name, source = f"hexagonal_{rows}x{cols}", "planar hexagonal array"
    return _planar(name, cell, x, y, {"original": pairs}, source)


def _cells(rows: int, cols: int, pitch: float) -> tuple[Tensor, Tensor]:
    # Row and column of each taxel (N, 2), and the index of the taxel in each cell (rows, cols).
    need(rows >= 1 and cols >= 1, f"'rows' and 'cols' must be at least 1 (got {rows} and {cols})")
    if rows * cols > MAX_TAXELS:
        raise ValueError(
            f"'rows' and 'cols' must give at most {MAX_TAXELS} taxels (got {rows} and {cols})"
        )
    need(0 < pitch < float("inf"), "'pitch' must be a positive length in metres", pitch)
    cell = torch.cartesian_prod(torch.arange(rows), torch.arange(cols)).view(-1, 2)
    return cell, torch.arange(rows * cols).view(rows, cols)


def _neighbour_pairs(index: Tensor, steps: tuple[tuple[int, int], ...]) -> _Pairs:
    # The indices of the taxels that are one of the steps (down, right) apart.
    rows, cols = index.shape
    return [
        (
            index[: rows - down, max(0, -right) : cols - max(0, right)],
            index[down:, max(0, right) : cols + min(0, right)],
        )
        for down, right in steps
    ]


def _planar(
    name: str, cell: Tensor, x: Tensor, y: Tensor, pairs: Mapping[str, _Pairs], source: str
) -> TaxelLayout:
    axes = torch.eye(3, dtype=torch.double)
    adjacency = {}
    for key, ends in pairs.items():
        blocks = [torch.stack([first.reshape(-1), second.reshape(-1)]) for first, second in ends]
        edges = torch.cat(blocks, dim=1)
        adjacency[key] = torch.cat([edges, edges.flip(0)], dim=1)
    return TaxelLayout(
        name=name,
        pos=torch.stack([x, y, torch.zeros_like(x)], dim=1),
        normal=axes[2].float().repeat(len(cell), 1),
        tangent=axes[:2].expand(len(cell), 2, 3),
        image_map=cell,
        adjacency=adjacency,
        source=source,
    )
