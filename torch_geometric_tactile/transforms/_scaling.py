r"""The arithmetic of scaling: centre and scale, measured on samples and looked up for them."""

from collections.abc import Iterable
from math import prod
from typing import NamedTuple, Protocol

import torch
from torch import Tensor
from torch_geometric.data import Batch, Data

from torch_geometric_tactile.data import StaticData, split_frames
from torch_geometric_tactile.transforms._samples import FlatSamples, Samples
from torch_geometric_tactile.transforms._windows import repeated, require_num_frames


class Scaler(Protocol):
    r"""What is asked of a :class:`~torch_geometric_tactile.transforms.FittedTransform`."""

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
        - **input:** at least one part :math:`(S_i, \ldots)`, with :math:`S_i \ge 1`
        - **output:** :math:`(\ldots)` each
    """
    shift: Tensor | None = None
    for part in parts:
        if shift is None:
            shift = part[0].nan_to_num()  # keeps the sum of squares small
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
    r"""Returns centre and scale of the samples with one value of a transform's key.

    Shapes:
        - **output:** that of the attribute in a sample each, :math:`(1, F)` of channels, or
          :math:`(N, C)` of signals
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
    r"""Checks that readings have the shape of those that a transform was fitted on."""
    num_dims = len(size)
    if transform.per == "channel":
        if x.dim() in (num_dims, num_dims + 1) and x.shape[-1:] == size[-1:]:
            return
        what = f"{size[-1]} channels, in its last of {num_dims} or {num_dims + 1} dimensions"
    else:
        if x.dim() == num_dims + 1 and x.shape[1:] == size:
            return
        is_joined = x.dim() == num_dims > 0 and x.shape[1:] == size[1:]
        if is_joined and x.size(0) % max(size[0], 1) == 0:
            return
        what = f"shape {tuple(size)} a sample"
        if transform.attr == "x":
            what = f"{size[0]} taxels and {size[1]} features"
    raise ValueError(
        f"'{transform.attr}' must have {what}, as {type(transform).__name__} was fitted on "
        f"(got shape {tuple(x.shape)})"
    )


class KeptTables(NamedTuple):
    r"""Centre and scale in the precision and on the device of some readings."""

    center: Tensor
    scale: Tensor
    place: tuple[torch.dtype, torch.device, int | None]
    tables: tuple[Tensor, Tensor, Tensor]


def tables_like(
    kept: KeptTables | None,
    center: Tensor,
    scale: Tensor,
    x: Tensor,
    num_frames: int | None = None,
) -> KeptTables:
    r"""Returns centre and scale in the precision and on the device of readings: those that were
    kept if they are the same, since converting them costs as much as scaling a batch.
    """
    place = (x.dtype, x.device, num_frames)
    if kept is not None and kept.center is center and kept.scale is scale and kept.place == place:
        return kept
    near = center.to(x.dtype)  # and what that leaves over: together as good as double
    tables = near.to(x.device), (center - near).to(x), scale.to(x)
    if num_frames is not None:
        near, rest, scaled = (repeated(table, num_frames) for table in tables)
        tables = near, rest, scaled
    return KeptTables(center, scale, place, tables)


def expand_shared(transform: Scaler, data: Data, x: Tensor) -> Tensor:
    r"""Returns an attribute with a value for each sample, also where all samples share one."""
    if not isinstance(data, StaticData) or not data.is_shared(transform.attr):
        return x
    if transform.attr in data.schema["shared"]:
        raise ValueError(
            f"'{transform.attr}' must have a value for each sample, since "
            f"{type(transform).__name__} scales them by '{transform.key}' (got one that is "
            "declared in 'shared')"
        )
    return x.expand(data.num_samples, *x.shape)


def by_sample(transform: Scaler, data: Data, x: Tensor, size: torch.Size) -> tuple[Tensor, Tensor]:
    r"""Returns the readings of each sample, and the row of its centre and scale."""
    if transform.per != "channel":
        return x.reshape(-1, *size), _row(transform, data, x.numel() // prod(size))
    if isinstance(data, Batch):
        row = _row(transform, data, data.num_graphs)
        counts = data._slice_dict[transform.attr].diff()  # of rows; samples may differ in them
        return x.reshape(-1, *size), row.repeat_interleave(counts)
    num_samples = data.num_samples if isinstance(data, StaticData) else 1
    row = _row(transform, data, num_samples)
    return x.reshape(num_samples, *x.shape[-len(size) :]), row


def _row(transform: Scaler, data: Data, num_samples: int) -> Tensor:
    assert transform.key is not None
    assert transform.key_values is not None
    wanted = transform.sample_values(data, transform.key, num_samples).long()
    row = torch.searchsorted(transform.key_values, wanted)
    row = row.clamp(max=len(transform.key_values) - 1)
    unknown = transform.key_values[row] != wanted
    if unknown.any():
        raise ValueError(
            f"{type(transform).__name__} has not seen {transform.key} {int(wanted[unknown][0])}: "
            "call 'adapt' with its (unlabelled) samples first"
        )
    return row
