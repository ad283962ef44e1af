r"""The centre and scale of each sample, looked up in what a transform was fitted to."""

from math import prod
from typing import TYPE_CHECKING, NamedTuple

import torch
from torch import Tensor
from torch_geometric.data import Batch, Data

from torch_geometric_tactile.data import StaticData
from torch_geometric_tactile.transforms._windows import repeated, require_num_frames

if TYPE_CHECKING:
    from torch_geometric_tactile.transforms.base import FittedTransform


class KeptTables(NamedTuple):
    r"""Centre and scale in the precision and on the device of some readings."""

    center: Tensor
    scale: Tensor
    place: tuple[torch.dtype, torch.device, int | None]
    tables: tuple[Tensor, Tensor, Tensor]


def num_frames_of(transform: "FittedTransform", data: Data) -> int | None:
    r"""Returns the number of frames over which a transform has one centre and scale, or
    :obj:`None` if it has not.
    """
    return require_num_frames(transform, data) if transform.per == "signal" else None


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


def expand_shared(transform: "FittedTransform", data: Data, x: Tensor) -> Tensor:
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


def by_sample(
    transform: "FittedTransform", data: Data, x: Tensor, size: torch.Size
) -> tuple[Tensor, Tensor]:
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


def _row(transform: "FittedTransform", data: Data, num_samples: int) -> Tensor:
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
