r"""Planar arrays of taxels."""

import torch
from torch import Tensor

from torch_geometric_tactile.sensors._content_checks import MOST_TAXELS
from torch_geometric_tactile.sensors.layout import TaxelLayout

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
    if rows < 1 or cols < 1:
        raise ValueError(f"'rows' and 'cols' must be at least 1 (got {rows} and {cols})")
    if rows * cols > MOST_TAXELS:
        raise ValueError(
            f"'rows' and 'cols' must make {MOST_TAXELS} taxels at most (got {rows} and {cols})"
        )
    if not 0 < pitch < float("inf"):
        raise ValueError(f"'pitch' must be a positive length in metres (got {pitch})")
    cell = torch.cartesian_prod(torch.arange(rows), torch.arange(cols)).view(-1, 2)
    zero = torch.zeros(rows * cols)
    axes = torch.eye(3, dtype=torch.double)
    return TaxelLayout(
        name=f"grid_{rows}x{cols}",
        pos=torch.stack([cell[:, 1] * pitch, cell[:, 0] * pitch, zero], dim=1),
        normal=torch.stack([zero, zero, zero + 1], dim=1),
        tangent=axes[:2].expand(rows * cols, 2, 3),
        image_map=cell,
        adjacency={
            "original": _grid_edges(rows, cols, _STRAIGHT),
            "slanted": _grid_edges(rows, cols, _SLANTED),
            "dense": _grid_edges(rows, cols, _STRAIGHT + _SLANTED),
        },
        source="planar grid",
    )


def _grid_edges(rows: int, cols: int, steps: tuple[tuple[int, int], ...]) -> Tensor:
    index = torch.arange(rows * cols).view(rows, cols)
    pairs = [torch.empty(2, 0, dtype=torch.long)]
    for down, right in steps:
        first = index[: rows - down, max(0, -right) : cols - max(0, right)]
        second = index[down:, max(0, right) : cols + min(0, right)]
        pairs.append(torch.stack([first.reshape(-1), second.reshape(-1)]))
    edges = torch.cat(pairs, dim=1)
    return torch.cat([edges, edges.flip(0)], dim=1)
