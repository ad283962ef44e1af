r"""The arithmetic of scaling."""

from collections.abc import Iterable
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from torch_geometric_tactile.data import split_frames
from torch_geometric_tactile.transforms._samples import Samples
from torch_geometric_tactile.transforms._windows import require_num_frames

if TYPE_CHECKING:
    from torch_geometric_tactile.transforms.base import FittedTransform


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
    transform: "FittedTransform", samples: Samples, index: Tensor
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
    first = samples.first[transform.attr]
    dims = first.dim() - (0 if samples.first.is_shared(transform.attr) else 1)
    moments = transform.moments(part.double().flatten(end_dim=-2) for part in parts)
    center, scale = (value.cpu().view(*(1,) * (dims - 1), -1) for value in moments)
    return center, scale


def check_size(transform: "FittedTransform", x: Tensor, size: torch.Size) -> None:
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
