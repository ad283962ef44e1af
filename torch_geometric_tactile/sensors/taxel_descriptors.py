r"""What a layout feels, in a fixed list of numbers that need no training."""

from torch import Tensor

from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile.sensors._described import (
    DIRECTIONS,
    NAMES,
    described,
    descriptor_tables,
    in_extents,
)
from torch_geometric_tactile.sensors.layout import TaxelLayout
from torch_geometric_tactile.sensors.stock import as_layout


def descriptor_names(layout: TaxelLayout | PathLike) -> list[str]:
    r"""Returns the names of the numbers that :func:`taxel_descriptors` gives of a channel.

    Args:
        layout (TaxelLayout or str or PathLike): The taxels: a layout, the name of one that comes
            with the package, or a layout file.

    Examples:
        >>> names = descriptor_names("biotac_sp")
        >>> len(names), names[0], names[-1]
        (150, 'mean', 'slope_cell_9_315')
    """
    tables = descriptor_tables(as_layout(layout))
    _, whole, coarse, fine = tables.bounds
    places = ["whole"]
    places += [f"part_{i + 1}" for i in range(coarse - whole)]
    places += [f"cell_{i + 1}" for i in range(fine - coarse)]
    means = [f"mean_{place}" for place in places[coarse:]]
    angles = [round(360 * i / DIRECTIONS) for i in range(DIRECTIONS)]
    return [*NAMES, *means, *(f"slope_{place}_{angle}" for place in places for angle in angles)]


def taxel_descriptors(
    x: Tensor, layout: TaxelLayout | PathLike, pos: Tensor | None = None
) -> Tensor:
    r"""Describes what each channel of a layout feels in a fixed list of numbers, without training:
    for few labels, a forest or a support vector machine on them is a strong model.

    Of each channel:

    * its mean, deviation, largest absolute value, seven quantiles and skewness;
    * the centroid of its absolute values, their second moments about it, and the eigenvalues of
      these, in units of the layout's extent;
    * the part of the taxels above 0.1, 0.5 and 1, which is why readings should be scaled (see
      :class:`~torch_geometric_tactile.transforms.ZScore`);
    * the mean and the largest absolute difference of a taxel to the mean of its six nearest, and
      the correlation of both;
    * the mean of each cell: a patch, or one of about nine soft cells where there are few patches;
    * how strongly it rises in eight directions of the taxels' frames, over the whole, its digits
      (without digits, patches or four parts), and each cell. These are histograms of oriented
      gradients (Dalal and Triggs, 2005) on any layout: the slope of a taxel is fitted to its
      neighbours of :func:`layout_sectors`, and histograms of a level have the length one, of
      which square roots are taken.

    A missing reading (NaN) counts as the mean of its neighbours, or else of all taxels.

    Args:
        x (torch.Tensor): Readings :math:`(N, F)` or :math:`(B, N, F)`.
        layout (TaxelLayout or str or PathLike): The taxels: a layout, the name of one that comes
            with the package, or a layout file.
        pos (torch.Tensor, optional): Places of the taxels of each sample in metres, such as those
            of :class:`~torch_geometric_tactile.transforms.TaxelPose` :math:`(N, 3)` or :math:`(B,
            N, 3)`, for centroid and moments; the layout's if left out.

    Returns:
        Tensor: Descriptors :math:`(F \cdot D,)` or :math:`(B, F \cdot D)`, channel by channel, with
        the names of :func:`descriptor_names`.

    Raises:
        ValueError: If there are other taxels.

    Examples:
        >>> import torch
        >>> taxel_descriptors(torch.rand(5, 24, 3), "biotac_sp").shape
        torch.Size([5, 450])
    """
    layout = as_layout(layout)
    if x.dim() not in (2, 3) or x.size(-2) != layout.num_taxels:
        raise ValueError(
            f"'x' must have shape ({layout.num_taxels}, num_channels) or (num_samples, "
            f"{layout.num_taxels}, num_channels), as layout '{layout.name}' (got {tuple(x.shape)})"
        )
    x = x if x.is_floating_point() else x.float()
    places = None
    if pos is not None:
        pos = pos.to(x.dtype)
        places = in_extents(pos, layout.pos.to(pos))
    tables = descriptor_tables(layout).like(x)
    found = described(x if x.dim() == 3 else x.unsqueeze(0), tables, places)
    return found if x.dim() == 3 else found[0]
