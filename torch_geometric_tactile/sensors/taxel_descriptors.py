r"""Descriptors of readings that need no training."""

from torch import Tensor

from torch_geometric_tactile._typing import PathLike
from torch_geometric_tactile.sensors._descriptor_tables import (
    NAMES,
    NUM_DIRECTIONS,
    compute_descriptors,
    descriptor_tables,
    pos_to_extents,
)
from torch_geometric_tactile.sensors.layout import TaxelLayout
from torch_geometric_tactile.sensors.stock import as_layout


def descriptor_names(layout: TaxelLayout | PathLike) -> list[str]:
    r"""Returns the names of the descriptors of a channel, in the order of
    :func:`taxel_descriptors`.

    Args:
        layout (TaxelLayout or str or PathLike): The taxels: a layout, the name of a layout of the
            package, or a layout file.

    Examples:
        >>> names = descriptor_names("biotac_sp")
        >>> len(names), names[0], names[-1]
        (150, 'mean', 'slope_cell_9_315')
    """
    tables = descriptor_tables(as_layout(layout))
    _, whole_end, parts_end, cells_end = tables.bounds
    regions = ["whole"]
    regions += [f"part_{i + 1}" for i in range(parts_end - whole_end)]
    regions += [f"cell_{i + 1}" for i in range(cells_end - parts_end)]
    means = [f"mean_{region}" for region in regions[parts_end:]]
    angles = [round(360 * i / NUM_DIRECTIONS) for i in range(NUM_DIRECTIONS)]
    return [*NAMES, *means, *(f"slope_{region}_{angle}" for region in regions for angle in angles)]


def taxel_descriptors(
    x: Tensor, layout: TaxelLayout | PathLike, pos: Tensor | None = None
) -> Tensor:
    r"""Computes a fixed number of descriptors from the readings of each channel, without training.
    With few labels, a random forest or a support vector machine on these descriptors is a strong
    model.

    The descriptors of a channel are:

    * mean, standard deviation, largest absolute value, seven quantiles and skewness;
    * the centroid of the absolute values, the second moments about it and their eigenvalues, in
      units of the layout's extent;
    * the fraction of the taxels above 0.1, 0.5 and 1, for which readings should be scaled (see
      :class:`~torch_geometric_tactile.transforms.ZScore`);
    * the mean and the largest absolute difference between a taxel and the mean of its six nearest
      neighbours, and the correlation of the two;
    * the mean of each cell, which is a patch, or one of about nine soft cells if there are few
      patches;
    * histograms of oriented gradients (Dalal and Triggs, 2005) with eight directions in the frames
      of the taxels, over all taxels, over each digit (without digits, each patch or each of four
      parts) and over each cell. The slope of a taxel is fitted to its neighbours from
      :func:`layout_sectors`. The histograms of a level are divided by their norm, then their square
      roots are taken.

    A missing reading (NaN) is replaced by the mean of its neighbours, or of all taxels if they are
    missing as well.

    Args:
        x (torch.Tensor): Readings :math:`(N, F)` or :math:`(B, N, F)`.
        layout (TaxelLayout or str or PathLike): The taxels: a layout, the name of a layout of the
            package, or a layout file.
        pos (torch.Tensor, optional): Positions of the taxels in each sample in metres :math:`(N,
            3)` or :math:`(B, N, 3)`, such as the output of
            :class:`~torch_geometric_tactile.transforms.TaxelPose`. Used for the centroid and the
            moments. By default the positions of the layout.

    Returns:
        Tensor: Descriptors :math:`(F \cdot D,)` or :math:`(B, F \cdot D)`, channel by channel, in
        the order of :func:`descriptor_names`.

    Raises:
        ValueError: If :obj:`x` does not have the number of taxels of the layout.

    Examples:
        >>> import torch
        >>> taxel_descriptors(torch.rand(5, 24, 3), "biotac_sp").shape
        torch.Size([5, 450])
    """
    layout = as_layout(layout)
    if x.dim() not in (2, 3) or x.size(-2) != layout.num_taxels:
        raise ValueError(
            f"'x' must have shape ({layout.num_taxels}, num_channels) or (num_samples, "
            f"{layout.num_taxels}, num_channels) for layout '{layout.name}' (got {tuple(x.shape)})"
        )
    x = x if x.is_floating_point() else x.float()
    scaled_pos = None
    if pos is not None:
        pos = pos.to(x.dtype)
        scaled_pos = pos_to_extents(pos, layout.pos.to(pos))
    tables = descriptor_tables(layout).like(x)
    descriptors = compute_descriptors(x if x.dim() == 3 else x.unsqueeze(0), tables, scaled_pos)
    return descriptors if x.dim() == 3 else descriptors[0]
