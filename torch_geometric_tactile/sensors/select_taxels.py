r"""Layouts with only some of the taxels of others."""

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor

from torch_geometric_tactile._checks import need
from torch_geometric_tactile.sensors.checks import is_whole_tensor
from torch_geometric_tactile.sensors.layout import TaxelLayout


def select_taxels(
    layout: TaxelLayout, taxels: Tensor | Sequence[int] | Sequence[bool], name: str | None = None
) -> TaxelLayout:
    r"""Returns a layout with only some taxels of another, for example without those of dead rows.
    The matching readings are :obj:`x[:, taxels]`.

    Places, normals, tangents and cells of the image map are kept as they are (a map becomes smaller
    only if its last rows or columns lose all taxels). Each adjacency keeps its name and the edges
    between the taxels that are left, which may be in several parts then; for edges over the gaps,
    take :class:`~torch_geometric_tactile.transforms.KNNGraph` or
    :func:`~torch_geometric_tactile.sensors.layout_sectors`. Patches and digits without a taxel are
    left out, and the others numbered anew; links are kept, since a hand has some without taxels.

    Args:
        layout (TaxelLayout): The layout.
        taxels (torch.Tensor or sequence): The numbers of the taxels, each once, in the order that
            they are to have, or whether each is kept :math:`(N,)`.
        name (str, optional): Name of the new layout; the other one's and the number of taxels if
            left out.

    Raises:
        ValueError: If :obj:`taxels` are neither, none, not there or not different.

    Examples:
        >>> from torch_geometric_tactile.sensors import grid
        >>> layout = grid(4, 4, pitch=0.004)
        >>> select_taxels(layout, layout.image_map[:, 0] != 2)
        TaxelLayout('grid_4x4_12', num_taxels=12, patches=1, digits=1)
    """
    chosen = _numbers(taxels, layout.num_taxels)
    new = torch.full((layout.num_taxels,), -1)
    new[chosen] = torch.arange(len(chosen))
    arguments: dict[str, Any] = {
        key: value[chosen]
        for key in ("pos", "normal", "tangent", "link", "image_map")
        if (value := getattr(layout, key)) is not None
    }
    for key in ("patch", "digit"):
        left, arguments[key] = getattr(layout, key)[chosen].unique(return_inverse=True)
        names = getattr(layout, f"{key}_names")
        arguments[f"{key}_names"] = tuple(names[i] for i in left.tolist())
    return TaxelLayout(
        name=f"{layout.name}_{len(chosen)}" if name is None else name,
        link_names=layout.link_names,
        adjacency={key: _between(edges, new) for key, edges in layout.adjacency.items()},
        source=layout.source,
        **arguments,
    )


def thinned(layout: TaxelLayout, keep: float, seed: int = 0) -> TaxelLayout:
    r"""Returns a layout with a random part of the taxels of another, in their order, by
    :func:`select_taxels`: a sensor with irregular places.

    On a large :func:`~torch_geometric_tactile.sensors.grid`, the edges between four neighbours are
    in many parts if less than 59 % of the taxels are kept, those between eight if less than 41 %,
    and those of :func:`~torch_geometric_tactile.sensors.hexagonal` if less than 50 %.

    Args:
        layout (TaxelLayout): The layout.
        keep (float): The part of the taxels, above 0 and at most 1; at least one is kept.
        seed (int): Seed of the draw. The taxels of a smaller part are among those of a larger one.

    Raises:
        ValueError: If :obj:`keep` is out of range, or the seed is negative.

    Examples:
        >>> from torch_geometric_tactile.sensors import letter_array
        >>> thinned(letter_array(), keep=0.5)
        TaxelLayout('letter_array_512', num_taxels=512, patches=1, digits=1)
    """
    need(0 < keep <= 1, "'keep' must be a part above 0 and at most 1", keep)
    need(seed >= 0, "'seed' must not be negative", seed)
    draw = torch.Generator().manual_seed(seed)
    order = torch.randperm(layout.num_taxels, generator=draw)
    count = max(1, round(keep * layout.num_taxels))
    return select_taxels(layout, order[:count].sort().values)


def _numbers(taxels: Tensor | Sequence[int] | Sequence[bool], num_taxels: int) -> Tensor:
    chosen = torch.as_tensor(taxels)
    if chosen.dim() != 1 or not (chosen.dtype == torch.bool or is_whole_tensor(chosen)):
        raise ValueError(
            "'taxels' must be a list of taxels, or tell of each whether it is kept "
            f"(got shape {tuple(chosen.shape)}, {chosen.dtype})"
        )
    if chosen.dtype == torch.bool:
        if len(chosen) != num_taxels:
            raise ValueError(
                f"'taxels' must tell of {num_taxels} taxels whether each is kept (got "
                f"{len(chosen)})"
            )
        chosen = chosen.nonzero().view(-1)
    chosen = chosen.long()
    need(len(chosen), "'taxels' must keep at least one taxel (got none)")
    first, last = int(chosen.min()), int(chosen.max())
    if first < 0 or last >= num_taxels:
        raise ValueError(
            f"'taxels' must be numbers from 0 to {num_taxels - 1} "
            f"(got {first if first < 0 else last})"
        )
    if len(chosen.unique()) < len(chosen):
        raise ValueError(
            f"'taxels' must name each taxel once (got {len(chosen)} numbers of "
            f"{len(chosen.unique())} taxels)"
        )
    return chosen


def _between(edges: Tensor, new: Tensor) -> Tensor:
    edges = new[edges]
    return edges[:, (edges >= 0).all(dim=0)]
