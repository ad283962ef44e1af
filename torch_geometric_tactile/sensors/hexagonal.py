r"""Planar arrays of taxels whose rows are shifted against each other."""

import math

import torch
from torch import Tensor

from torch_geometric_tactile.sensors._content_checks import MOST_TAXELS
from torch_geometric_tactile.sensors.layout import TaxelLayout


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
    if rows < 1 or cols < 1:
        raise ValueError(f"'rows' and 'cols' must be at least 1 (got {rows} and {cols})")
    if rows * cols > MOST_TAXELS:
        raise ValueError(
            f"'rows' and 'cols' must make {MOST_TAXELS} taxels at most (got {rows} and {cols})"
        )
    if not 0 < pitch < float("inf"):
        raise ValueError(f"'pitch' must be a positive length in metres (got {pitch})")
    cell = torch.cartesian_prod(torch.arange(rows), torch.arange(cols)).view(-1, 2)
    row, col = cell.double().unbind(dim=1)
    zero = torch.zeros_like(row)
    place = [pitch * (col + 0.5 * (row % 2)), pitch * math.sqrt(0.75) * row, zero]
    axes = torch.eye(3, dtype=torch.double)
    return TaxelLayout(
        name=f"hexagonal_{rows}x{cols}",
        pos=torch.stack(place, dim=1),
        normal=torch.stack([zero, zero, zero + 1], dim=1),
        tangent=axes[:2].expand(rows * cols, 2, 3),
        image_map=cell,
        adjacency={"original": _hexagonal_edges(rows, cols)},
        source="planar hexagonal array",
    )


def _hexagonal_edges(rows: int, cols: int) -> Tensor:
    index = torch.arange(rows * cols).view(rows, cols)
    pairs = [
        (index[:, :-1], index[:, 1:]),
        (index[:-1], index[1:]),  # of the same number in the next row
        (index[:-1:2, 1:], index[1::2, :-1]),  # from a row to the shifted one behind it,
        (index[1:-1:2, :-1], index[2::2, 1:]),  # and from a shifted row
    ]
    ends = [torch.stack([first.reshape(-1), second.reshape(-1)]) for first, second in pairs]
    edges = torch.cat(ends, dim=1)
    return torch.cat([edges, edges.flip(0)], dim=1)
