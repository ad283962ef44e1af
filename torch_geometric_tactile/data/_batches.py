r"""Batches of data sets, of selections from data sets, and of concatenated data sets."""

from collections.abc import Iterable, Iterator, Sequence
from typing import Any

import torch
from torch import Tensor
from torch.utils.data import ConcatDataset, Subset

from torch_geometric_tactile.data._levels import NAMED
from torch_geometric_tactile.data.static_data import StaticData
from torch_geometric_tactile.data.static_dataset import StaticDataset


def static_parts(dataset: Any) -> Iterator[StaticDataset]:
    r"""Yields the data sets of which a data set consists: the data set itself, or the data sets in
    a :class:`~torch.utils.data.Subset` or :class:`~torch.utils.data.ConcatDataset`, also nested.

    Raises:
        TypeError: If a part is not a :class:`~torch_geometric_tactile.data.StaticDataset`.
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
            f"'dataset' must be a StaticDataset, or a Subset or ConcatDataset of them (got "
            f"{type(dataset).__name__}); use torch_geometric.loader.DataLoader for other data sets"
        )


def static_batch(dataset: Any, index: Sequence[int]) -> StaticData:
    r"""Returns samples of a data set as one batch, after the :obj:`transform` of each of its parts.

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
    part_numbers = torch.bucketize(rows, ends, right=True)
    batches, places = [], []
    # An empty batch has the attributes of the first part.
    for i in part_numbers.unique().tolist() or [0]:
        place = (part_numbers == i).nonzero().view(-1)
        start = int(ends[i - 1]) if i else 0
        batches.append(static_batch(dataset.datasets[i], (rows[place] - start).tolist()))
        places.append(place)
    if len(batches) == 1:
        return batches[0]
    return join_batches(batches, places)


def check_joinable(parts: Sequence[StaticDataset]) -> None:
    r"""Checks that the samples of several data sets can be in one batch.

    Raises:
        ValueError: If the data sets differ in their layout, their attributes, their edges or the
            names of their classes, groups or sessions.
    """
    first, first_sample = parts[0], None
    for i, part in enumerate(parts):
        if not first.layout.matches(part.layout):
            raise ValueError(
                f"all parts of 'dataset' must have the layout of part 0, '{first.layout.name}' "
                f"(got '{part.layout.name}', with different taxels, in part {i})"
            )
        if len(part) == 0:
            continue
        sample = part.batch([0])
        if first_sample is None:
            first, first_sample = part, sample
            continue
        _check_same_graph(first_sample, sample, i)
        check_same_names(first, part, sample.keys(), f"part {i} of 'dataset'")


def check_same_names(first: Any, second: Any, keys: Iterable[str], second_name: str) -> None:
    r"""Checks that the numbers of classes, groups and sessions have the same meaning in two data
    sets.

    Args:
        first (Dataset): A data set with :obj:`class_names`, :obj:`group_names` and
            :obj:`session_names`.
        second (Dataset): The data set to compare with it.
        keys (iterable of str): The attributes that the samples have.
        second_name (str): Name of the second data set in the message.

    Raises:
        ValueError: If the names of an attribute in :obj:`keys` differ.
    """
    for key in sorted(NAMED.keys() & {*keys}):
        names, second_names = (getattr(part, f"{NAMED[key]}_names") for part in (first, second))
        if names != second_names:
            raise ValueError(
                f"{second_name} must have the {NAMED[key]}_names of the first, {names}, since "
                f"'{key}' holds their numbers (got {second_names}): pass the same list to both, "
                f"read both as one data set, or remove '{key}' in the 'transform' of each"
            )


def _check_same_graph(first: StaticData, batch: StaticData, i: int) -> None:
    keys, batch_keys = set(first.keys()), set(batch.keys())
    if keys != batch_keys:
        raise ValueError(
            f"all parts of 'dataset' must have the same attributes (got "
            f"{sorted(keys ^ batch_keys)} only in part 0 or only in part {i})"
        )
    if first.edge_index is not None and not torch.equal(first.edge_index, batch.edge_index):
        raise ValueError(
            f"all parts of 'dataset' must have the same edges (got different edges in part {i}); "
            "use the same 'pre_transform' and 'transform' for all of them"
        )


def join_batches(batches: Sequence[StaticData], places: Sequence[Tensor]) -> StaticData:
    r"""Joins several batches into one.

    An attribute that is shared in each batch stays shared if it is equal in all batches; otherwise
    it is stored for each sample.

    Shapes:
        - **places:** The rows of the samples of each batch in the output :math:`(B_i,)`.

    Raises:
        ValueError: If the batches differ in their attributes, edges, types or shapes.
    """
    first = batches[0]
    for i, batch in enumerate(batches):
        _check_same_graph(first, batch, i)
    values: dict[str, Any] = {}
    declared = first.schema["shared"]
    for key, value in first.to_dict().items():
        if all(batch.is_shared(key) and _is_equal(batch[key], value) for batch in batches):
            values[key] = value
        elif key in declared or not isinstance(value, Tensor):
            raise ValueError(f"'{key}' must be equal in all batches, since their samples share it")
        else:
            values[key] = _join_rows([_sample_rows(batch, key) for batch in batches], places, key)
    num_samples = sum(batch.num_samples for batch in batches)
    return type(first)(**(values | first.schema), num_samples=num_samples)


def _sample_rows(batch: StaticData, key: str) -> Tensor:
    value: Tensor = batch[key]
    return value.expand(batch.num_samples, *value.shape) if batch.is_shared(key) else value


def _join_rows(rows: Sequence[Tensor], places: Sequence[Tensor], key: str) -> Tensor:
    kinds = {(part.dtype, part.shape[1:]) for part in rows}
    if len(kinds) > 1:
        forms = " and ".join(f"{dtype} {tuple(shape)}" for dtype, shape in sorted(kinds, key=str))
        raise ValueError(f"'{key}' must have one type and shape in all batches (got {forms})")
    # Filled part by part: this copies once, while joining and sorting would copy twice.
    out = rows[0].new_empty((sum(map(len, rows)), *rows[0].shape[1:]))
    for part, place in zip(rows, places, strict=True):
        out[place] = part
    return out


def _is_equal(value: Any, reference: Any) -> bool:
    if value is reference:
        return True
    if isinstance(value, Tensor) and isinstance(reference, Tensor):
        return torch.equal(value, reference)
    return type(value) is type(reference) and bool(value == reference)
