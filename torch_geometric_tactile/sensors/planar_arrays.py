r"""Planar arrays of taxels."""

import math
from collections.abc import Mapping, Sequence

import torch
from torch import Tensor

from torch_geometric_tactile._checks import need
from torch_geometric_tactile.sensors._content_checks import MOST_TAXELS
from torch_geometric_tactile.sensors.layout import TaxelLayout

_Pairs = Sequence[tuple[Tensor, Tensor]]  # of the numbers of taxels
_STRAIGHT = ((0, 1), (1, 0))
_SLANTED = ((1, 1), (1, -1))


def grid(rows: int, cols: int, pitch: float) -> TaxelLayout:
    r"""A planar array of taxels, numbered row by row, in the :math:`xy` plane with normals along
    :math:`+z`: columns along :math:`x`, rows along :math:`y`, the first taxel at the origin. The
    taxels' own axes are these :math:`x` (to the next column) and :math:`y` (to the next row).

    Its adjacencies are :obj:`"original"` (the four straight neighbours), :obj:`"slanted"` (the four
    diagonal ones) and :obj:`"dense"` (all eight), each edge in both directions.

    Args:
        rows (int): Number of rows.
        cols (int): Number of columns.
        pitch (float): Distance between neighbouring taxels in metres.

    Raises:
        ValueError: If :obj:`rows`, :obj:`cols` or :obj:`pitch` is not positive, or they make more
            than a million taxels.

    Examples:
        >>> layout = grid(4, 4, pitch=0.004667)
        >>> layout
        TaxelLayout('grid_4x4', num_taxels=16, patches=1, digits=1)
        >>> layout.edge_index("original").shape
        torch.Size([2, 48])
    """
    cell, numbers = _cells(rows, cols, pitch)
    pairs = {
        "original": _neighbours(numbers, _STRAIGHT),
        "slanted": _neighbours(numbers, _SLANTED),
        "dense": _neighbours(numbers, _STRAIGHT + _SLANTED),
    }
    x, y = cell[:, 1] * pitch, cell[:, 0] * pitch
    return _planar(f"grid_{rows}x{cols}", cell, x, y, pairs, "planar grid")


def hexagonal(rows: int, cols: int, pitch: float) -> TaxelLayout:
    r"""A planar array of taxels with six neighbours each, numbered row by row, in the :math:`xy`
    plane with normals along :math:`+z` and the first taxel at the origin. Rows run along :math:`x`,
    follow one another along :math:`y` at :math:`\sqrt{3} / 2` of the pitch, and every second one
    (the second, the fourth) is shifted by half a pitch along :math:`+x`. The taxels' own axes are
    :math:`x` and :math:`y`.

    Its adjacency :obj:`"original"` joins these six, all at the pitch, in both directions. The image
    map is that of offset coordinates, row and number in the row: a convolutional network sees a
    picture that is sheared by half a pixel from row to row.

    Args:
        rows (int): Number of rows.
        cols (int): Number of taxels of each row.
        pitch (float): Distance between neighbouring taxels in metres.

    Raises:
        ValueError: If :obj:`rows`, :obj:`cols` or :obj:`pitch` is not positive, or they make more
            than a million taxels.

    Examples:
        >>> layout = hexagonal(3, 4, pitch=0.00125)
        >>> layout
        TaxelLayout('hexagonal_3x4', num_taxels=12, patches=1, digits=1)
        >>> layout.edge_index("original").shape
        torch.Size([2, 46])
    """
    cell, numbers = _cells(rows, cols, pitch)
    pairs = [
        (numbers[:, :-1], numbers[:, 1:]),
        (numbers[:-1], numbers[1:]),  # of the same number in the next row
        (numbers[:-1:2, 1:], numbers[1::2, :-1]),  # from a row to the shifted one behind it,
        (numbers[1:-1:2, :-1], numbers[2::2, 1:]),  # and from a shifted row
    ]
    row, col = cell.double().unbind(dim=1)
    x, y = pitch * (col + 0.5 * (row % 2)), pitch * math.sqrt(0.75) * row
    name, source = f"hexagonal_{rows}x{cols}", "planar hexagonal array"
    return _planar(name, cell, x, y, {"original": pairs}, source)


def _cells(rows: int, cols: int, pitch: float) -> tuple[Tensor, Tensor]:
    # Row and column of each taxel (N, 2), and the number in each cell (rows, cols).
    need(rows >= 1 and cols >= 1, f"'rows' and 'cols' must be at least 1 (got {rows} and {cols})")
    if rows * cols > MOST_TAXELS:
        raise ValueError(
            f"'rows' and 'cols' must make {MOST_TAXELS} taxels at most (got {rows} and {cols})"
        )
    need(0 < pitch < float("inf"), "'pitch' must be a positive length in metres", pitch)
    cell = torch.cartesian_prod(torch.arange(rows), torch.arange(cols)).view(-1, 2)
    return cell, torch.arange(rows * cols).view(rows, cols)


def _neighbours(numbers: Tensor, steps: tuple[tuple[int, int], ...]) -> _Pairs:
    rows, cols = numbers.shape
    return [
        (
            numbers[: rows - down, max(0, -right) : cols - max(0, right)],
            numbers[down:, max(0, right) : cols + min(0, right)],
        )
        for down, right in steps
    ]


def _planar(
    name: str, cell: Tensor, x: Tensor, y: Tensor, pairs: Mapping[str, _Pairs], source: str
) -> TaxelLayout:
    axes = torch.eye(3, dtype=torch.double)
    adjacency = {}
    for key, found in pairs.items():
        ends = [torch.stack([first.reshape(-1), second.reshape(-1)]) for first, second in found]
        edges = torch.cat(ends, dim=1)
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
