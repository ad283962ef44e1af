r"""The computations of scaling transforms: fitting centre and scale, and selecting the centre and
scale of each sample.
"""

from collections.abc import Iterable
from math import prod
from typing import NamedTuple, Protocol

import torch
from torch import Tensor
from torch_geometric.data import Batch, Data

from torch_geometric_tactile.data import StaticData, split_frames
from torch_geometric_tactile.transforms._samples import FlatSamples, Samples
from torch_geometric_tactile.transforms._windows import repeat_frames, require_num_frames


class Scaler(Protocol):
    r"""The part of :class:`~torch_geometric_tactile.transforms.FittedTransform` that this module
    uses.
    """

    attr: str
    per: str
    key: str | None
    key_values: Tensor | None

    def measured(self, samples: Samples | FlatSamples, index: Tensor, /) -> Tensor: ...
    def moments(self, parts: Iterable[Tensor], /) -> tuple[Tensor, Tensor]: ...
    def sample_values(self, data: Data, key: str, num_samples: int, /) -> Tensor: ...


def mean_and_deviation(parts: Iterable[Tensor]) -> tuple[Tensor, Tensor]:
    r"""Returns mean and standard deviation over the first dimension, without missing readings.

    Shapes:
        - **parts:** at least one part :math:`(S_i, \ldots)`, with :math:`S_i \ge 1`
        - **output:** :math:`(\ldots)` each
    """
    shift: Tensor | None = None
    for part in parts:
        if shift is None:
            # Without a shift, the squares of large offsets would hide small deviations.
            shift = part[0].nan_to_num()
            count = torch.zeros_like(shift)
            total, square = torch.zeros_like(shift), torch.zeros_like(shift)
        value = part - shift
        count += (~value.isnan()).sum(0)
        total += value.nansum(0)
        square += value.square().nansum(0)
    assert shift is not None
    count = count.clamp(min=1)
    mean = total / count
    deviation = (square / count - mean.square()).clamp(min=0).sqrt()
    return shift + mean, deviation


def center_and_scale(
    transform: Scaler, samples: Samples | FlatSamples, index: Tensor
) -> tuple[Tensor, Tensor]:
    r"""Fits centre and scale on the samples with one value of a transform's key.

    Args:
        transform (Scaler): The transform.
        samples (Samples or FlatSamples): All samples.
        index (torch.Tensor): Indices of the samples with this value.

    Shapes:
        - **output:** centre and scale with the shape of the attribute in a sample, :math:`(1, F)`
          for channels, or :math:`(N, C)` for signals
    """
    parts = samples.values(transform.attr, transform.measured(samples, index))
    if transform.per == "taxel":
        center, scale = transform.moments(part.double() for part in parts)
        return center.cpu(), scale.cpu()
    if transform.per == "signal":
        num_frames = require_num_frames(transform, samples.first)
        frames = (split_frames(part.double(), num_frames).transpose(1, 2) for part in parts)
        center, scale = transform.moments(part.flatten(0, 1) for part in frames)
        return center.cpu(), scale.cpu()
    dims = samples.first[transform.attr].dim()  # of a sample
    if isinstance(samples.first, StaticData) and not samples.first.is_shared(transform.attr):
        dims -= 1
    moments = transform.moments(part.double().flatten(end_dim=-2) for part in parts)
    center, scale = (value.cpu().view(*(1,) * (dims - 1), -1) for value in moments)
    return center, scale


def check_size(transform: Scaler, x: Tensor, size: torch.Size) -> None:
    r"""Checks that readings have the shape of the samples on which a transform was fitted.

    Args:
        transform (Scaler): The transform.
        x (torch.Tensor): The readings, or another attribute.
        size (torch.Size): The shape of the attribute in one sample.

    Raises:
        ValueError: If the shape differs.
    """
    num_dims = len(size)
    if transform.per == "channel":
        if x.dim() in (num_dims, num_dims + 1) and x.shape[-1:] == size[-1:]:
            return
        expected = f"{size[-1]} channels, in its last of {num_dims} or {num_dims + 1} dimensions"
    else:
        if x.dim() == num_dims + 1 and x.shape[1:] == size:
            return
        is_joined = x.dim() == num_dims > 0 and x.shape[1:] == size[1:]
        if is_joined and x.size(0) % max(size[0], 1) == 0:
            return
        expected = f"shape {tuple(size)} in each sample"
        if transform.attr == "x":
            expected = f"{size[0]} taxels and {size[1]} features"
    raise ValueError(
        f"'{transform.attr}' must have {expected}, as in the samples on which "
        f"{type(transform).__name__} was fitted (got shape {tuple(x.shape)})"
    )


class CachedTables(NamedTuple):
    r"""Centre and scale in the precision and on the device of the readings.

    Args:
        center (torch.Tensor): The centre from which the tables were computed.
        scale (torch.Tensor): The scale from which the tables were computed.
        placement (tuple): Type and device of the readings, and the number of frames.
        tables (tuple of torch.Tensor): The centre, its rounding error and the scale.
    """

    center: Tensor
    scale: Tensor
    placement: tuple[torch.dtype, torch.device, int | None]
    tables: tuple[Tensor, Tensor, Tensor]


def convert_tables(
    cache: CachedTables | None,
    center: Tensor,
    scale: Tensor,
    x: Tensor,
    num_frames: int | None = None,
) -> CachedTables:
    r"""Converts centre and scale to the precision and the device of the readings. Matching cached
    tables are returned, since the conversion takes as long as scaling a batch.
    """
    placement = (x.dtype, x.device, num_frames)
    if (
        cache is not None
        and cache.center is center
        and cache.scale is scale
        and cache.placement == placement
    ):
        return cache
    # The rounded centre and its rounding error are subtracted one after the other, which is as
    # precise as double precision.
    rounded = center.to(x.dtype)
    tables = rounded.to(x.device), (center - rounded).to(x), scale.to(x)
    if num_frames is not None:
        rounded, remainder, window_scale = (repeat_frames(table, num_frames) for table in tables)
        tables = rounded, remainder, window_scale
    return CachedTables(center, scale, placement, tables)


def expand_shared(transform: Scaler, data: Data, x: Tensor) -> Tensor:
    r"""Expands an attribute that all samples share to one value for each sample.

    Raises:
        ValueError: If the attribute is declared as shared.
    """
    if not isinstance(data, StaticData) or not data.is_shared(transform.attr):
        return x
    if transform.attr in data.schema["shared"]:
        raise ValueError(
            f"'{transform.attr}' must have a value for each sample, since "
            f"{type(transform).__name__} scales it by '{transform.key}' (got one value, declared "
            "in 'shared')"
        )
    return x.expand(data.num_samples, *x.shape)


def sample_rows(
    transform: Scaler, data: Data, x: Tensor, size: torch.Size
) -> tuple[Tensor, Tensor]:
    r"""Returns the readings sample by sample, and the row in the tables for each sample."""
    if transform.per != "channel":
        return x.reshape(-1, *size), _key_rows(transform, data, x.numel() // prod(size))
    if isinstance(data, Batch):
        row = _key_rows(transform, data, data.num_graphs)
        counts = data._slice_dict[transform.attr].diff()  # rows of each sample, which may differ
        return x.reshape(-1, *size), row.repeat_interleave(counts)
    num_samples = data.num_samples if isinstance(data, StaticData) else 1
    row = _key_rows(transform, data, num_samples)
    return x.reshape(num_samples, *x.shape[-len(size) :]), row


def _key_rows(transform: Scaler, data: Data, num_samples: int) -> Tensor:
    # Returns the row in the tables of the transform that belongs to the key of each sample.
    assert transform.key is not None
    assert transform.key_values is not None
    values = transform.sample_values(data, transform.key, num_samples).long()
    row = torch.searchsorted(transform.key_values, values)
    row = row.clamp(max=len(transform.key_values) - 1)
    is_unknown = transform.key_values[row] != values
    if is_unknown.any():
        raise ValueError(
            f"{type(transform).__name__} was not fitted on {transform.key} "
            f"{int(values[is_unknown][0])}: call 'adapt' with its (unlabelled) samples first"
        )
    return row
