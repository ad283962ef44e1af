r"""Batches of data sets that are parts of others, or several in one."""

from collections.abc import Iterable, Iterator, Sequence
from typing import Any

import torch
from torch import Tensor
from torch.utils.data import ConcatDataset, Subset

from torch_geometric_tactile.data._levels import NAMED
from torch_geometric_tactile.data.static_data import StaticData
from torch_geometric_tactile.data.static_dataset import StaticDataset


def static_parts(dataset: Any) -> Iterator[StaticDataset]:
    r"""Yields the data sets that a data set consists of: itself, or those in a
    :class:`~torch.utils.data.Subset` or :class:`~torch.utils.data.ConcatDataset`, nested or not.
    """
    if isinstance(dataset, StaticDataset):
        yield dataset
    elif isinstance(dataset, Subset):
        yield from static_parts(dataset.dataset)
    elif isinstance(dataset, ConcatDataset):
        for part in dataset.datasets:
            yield from static_parts(part)
    else:
        raise TypeError(
            f"'dataset' must be a StaticDataset, or a Subset or ConcatDataset of some (got "
            f"{type(dataset).__name__}); use torch_geometric.loader.DataLoader for others"
        )


def static_batch(dataset: Any, index: Sequence[int]) -> StaticData:
    r"""Returns some samples of a data set in one piece, after the :obj:`transform` of each part.

    Shapes:
        - **index:** Indices :math:`(B,)`.
    """
    if isinstance(dataset, StaticDataset):
        return dataset.batch(torch.as_tensor(index, dtype=torch.long))
    if isinstance(dataset, Subset):
        return static_batch(dataset.dataset, [dataset.indices[i] for i in index])
    ends = torch.tensor(dataset.cumulative_sizes)
    rows = torch.as_tensor(index, dtype=torch.long)
    rows = torch.where(rows < 0, rows + len(dataset), rows)
    part_of = torch.bucketize(rows, ends, right=True)
    batches, places = [], []
    # An empty batch has the attributes of the first part.
    for i in part_of.unique().tolist() or [0]:
        place = (part_of == i).nonzero().view(-1)
        start = int(ends[i - 1]) if i else 0
        batches.append(static_batch(dataset.datasets[i], (rows[place] - start).tolist()))
        places.append(place)
    if len(batches) == 1:
        return batches[0]
    return joined(batches, places)


def check_joinable(parts: Sequence[StaticDataset]) -> None:
    r"""Checks that the samples of several data sets can be in one batch."""
    first, firsts = parts[0], None
    for i, part in enumerate(parts):
        if not first.layout.matches(part.layout):
            raise ValueError(
                f"all parts of 'dataset' must have layout '{first.layout.name}', as part 0 (got "
                f"'{part.layout.name}', with other taxels, in part {i})"
            )
        if len(part) == 0:
            continue
        sample = part.batch([0])
        if firsts is None:
            first, firsts = part, sample
            continue
        _check_same(firsts, sample, i)
        check_same_names(first, part, sample.keys(), f"part {i} of 'dataset'")


def check_same_names(first: Any, other: Any, keys: Iterable[str], what: str) -> None:
    r"""Checks that the numbers of classes, groups and sessions mean the same in two data sets."""
    for key in sorted(NAMED.keys() & {*keys}):
        names, others = (getattr(part, f"{NAMED[key]}_names") for part in (first, other))
        if names != others:
            raise ValueError(
                f"{what} must have the {NAMED[key]}_names {names} of the first, since '{key}' "
                f"holds their numbers (got {others}): give both one list, read both as one data "
                f"set, or remove '{key}' by the 'transform' of each"
            )


def _check_same(first: StaticData, other: StaticData, i: int) -> None:
    keys, others = set(first.keys()), set(other.keys())
    if keys != others:
        raise ValueError(
            f"all parts of 'dataset' must have the same attributes (got {sorted(keys ^ others)} "
            f"in one of the first and part {i} only)"
        )
    if first.edge_index is not None and not torch.equal(first.edge_index, other.edge_index):
        raise ValueError(
            f"all parts of 'dataset' must have the same edges (got others in part {i}); give each "
            "the same 'pre_transform' and 'transform'"
        )


def joined(batches: Sequence[StaticData], places: Sequence[Tensor]) -> StaticData:
    r"""Returns the samples of several batches as one.

    An attribute that each batch shares stays shared if it is the same in all; otherwise each sample
    gets its own.

    Shapes:
        - **places:** Where the samples of each batch shall be
          :math:`(B_i,)`.
    """
    first = batches[0]
    for i, other in enumerate(batches):
        _check_same(first, other, i)
    values: dict[str, Any] = {}
    declared = first.schema["shared"]
    for key, value in first.to_dict().items():
        if all(batch.is_shared(key) and _is_same(batch[key], value) for batch in batches):
            values[key] = value
        elif key in declared or not isinstance(value, Tensor):
            raise ValueError(f"all batches must have the same '{key}', which their samples share")
        else:
            values[key] = _joined_rows([_rows(batch, key) for batch in batches], places, key)
    num_samples = sum(batch.num_samples for batch in batches)
    return type(first)(**(values | first.schema), num_samples=num_samples)


def _rows(batch: StaticData, key: str) -> Tensor:
    value: Tensor = batch[key]
    return value.expand(batch.num_samples, *value.shape) if batch.is_shared(key) else value


def _joined_rows(rows: Sequence[Tensor], places: Sequence[Tensor], key: str) -> Tensor:
    kinds = {(part.dtype, part.shape[1:]) for part in rows}
    if len(kinds) > 1:
        found = " and ".join(f"{dtype} {tuple(shape)}" for dtype, shape in sorted(kinds, key=str))
        raise ValueError(f"all batches must have '{key}' in one type and shape (got {found})")
    # Filled in order, which copies once, whereas joining and sorting copies twice.
    out = rows[0].new_empty((sum(map(len, rows)), *rows[0].shape[1:]))
    for part, place in zip(rows, places, strict=True):
        out[place] = part
    return out


def _is_same(value: Any, other: Any) -> bool:
    if value is other:
        return True
    if isinstance(value, Tensor) and isinstance(other, Tensor):
        return torch.equal(value, other)
    return type(value) is type(other) and bool(value == other)
