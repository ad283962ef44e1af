r"""Selection of taxels of a layout."""

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor

from torch_geometric_tactile._checks import need
from torch_geometric_tactile.sensors._checks import is_integer_tensor
from torch_geometric_tactile.sensors.layout import TaxelLayout


def select_taxels(
    layout: TaxelLayout, taxels: Tensor | Sequence[int] | Sequence[bool], name: str | None = None
) -> TaxelLayout:
    r"""Returns a layout with a selection of the taxels of another layout, for example without dead
    rows. The corresponding readings are :obj:`x[:, taxels]`.

    Positions, normals, tangents and cells of the image map stay the same. Each adjacency has the
    edges between selected taxels, so the graph may be disconnected. For edges across gaps, use
    :class:`~torch_geometric_tactile.transforms.KNNGraph` or
    :func:`~torch_geometric_tactile.sensors.layout_sectors`. Patches and digits without a taxel are
    removed, and the others are renumbered. All links are kept, since a hand may have links
    without taxels.

    Args:
        layout (TaxelLayout): The layout.
        taxels (torch.Tensor or sequence): Different indices of taxels, in the order of the new
            layout, or a boolean for each taxel :math:`(N,)`.
        name (str, optional): Name of the new layout. By default the name of the layout followed by
            the number of taxels.

    Raises:
        ValueError: If :obj:`taxels` are not indices or booleans, are empty, or an index does not
            exist or is repeated.

    Examples:
        >>> from torch_geometric_tactile.sensors import grid
        >>> layout = grid(4, 4, pitch=0.004)
        >>> select_taxels(layout, layout.image_map[:, 0] != 2)
        TaxelLayout('grid_4x4_12', num_taxels=12, patches=1, digits=1)
    """
    indices = _taxel_indices(taxels, layout.num_taxels)
    new_index = torch.full((layout.num_taxels,), -1)
    new_index[indices] = torch.arange(len(indices))
    arguments: dict[str, Any] = {
        key: value[indices]
        for key in ("pos", "normal", "tangent", "link", "image_map")
        if (value := getattr(layout, key)) is not None
    }
    for key in ("patch", "digit"):
        remaining, arguments[key] = getattr(layout, key)[indices].unique(return_inverse=True)
        names = getattr(layout, f"{key}_names")
        arguments[f"{key}_names"] = tuple(names[i] for i in remaining.tolist())
    return TaxelLayout(
        name=f"{layout.name}_{len(indices)}" if name is None else name,
        link_names=layout.link_names,
        adjacency={key: _reindex(edges, new_index) for key, edges in layout.adjacency.items()},
        source=layout.source,
        **arguments,
    )


def thinned(layout: TaxelLayout, keep: float, seed: int = 0) -> TaxelLayout:
    r"""Returns a layout with a random fraction of the taxels of another layout, in the same order
    (see :func:`select_taxels`). Use it to simulate a sensor with irregular positions.

    On a large :func:`~torch_geometric_tactile.sensors.grid`, the graph of four neighbours is
    disconnected if less than 59 % of the taxels are kept, and the graph of eight neighbours if less
    than 41 %. On :func:`~torch_geometric_tactile.sensors.hexagonal`, the limit is 50 %.

    Args:
        layout (TaxelLayout): The layout.
        keep (float): Fraction of the taxels, above 0 and at most 1. At least one taxel is kept.
        seed (int): Seed of the selection. With the same seed, the taxels of a smaller fraction are
            among those of a larger one.

    Raises:
        ValueError: If :obj:`keep` is out of range, or the seed is negative.

    Examples:
        >>> from torch_geometric_tactile.sensors import letter_array
        >>> thinned(letter_array(), keep=0.5)
        TaxelLayout('letter_array_512', num_taxels=512, patches=1, digits=1)
    """
    need(0 < keep <= 1, "'keep' must be a fraction above 0 and at most 1", keep)
    need(seed >= 0, "'seed' must not be negative", seed)
    generator = torch.Generator().manual_seed(seed)
    order = torch.randperm(layout.num_taxels, generator=generator)
    count = max(1, round(keep * layout.num_taxels))
    return select_taxels(layout, order[:count].sort().values)


def _taxel_indices(taxels: Tensor | Sequence[int] | Sequence[bool], num_taxels: int) -> Tensor:
    indices = torch.as_tensor(taxels)
    if indices.dim() != 1 or not (indices.dtype == torch.bool or is_integer_tensor(indices)):
        raise ValueError(
            "'taxels' must be a list of taxels, or a boolean for each taxel "
            f"(got shape {tuple(indices.shape)}, {indices.dtype})"
        )
    if indices.dtype == torch.bool:
        if len(indices) != num_taxels:
            raise ValueError(
                f"'taxels' must have a boolean for each of {num_taxels} taxels (got {len(indices)})"
            )
        indices = indices.nonzero().view(-1)
    indices = indices.long()
    need(len(indices), "'taxels' must keep at least one taxel (got none)")
    first, last = int(indices.min()), int(indices.max())
    if first < 0 or last >= num_taxels:
        raise ValueError(
            f"'taxels' must be numbers from 0 to {num_taxels - 1} "
            f"(got {first if first < 0 else last})"
        )
    if len(indices.unique()) < len(indices):
        raise ValueError(
            f"'taxels' must name each taxel once (got {len(indices)} indices for "
            f"{len(indices.unique())} taxels)"
        )
    return indices


def _reindex(edges: Tensor, new_index: Tensor) -> Tensor:
    # The edges with the new indices of their taxels. Edges of removed taxels (-1) are left out.
    edges = new_index[edges]
    return edges[:, (edges >= 0).all(dim=0)]
