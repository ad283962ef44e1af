r"""The samples that a transform is fitted on, read a few at a time."""

from collections.abc import Iterator, Sequence
from functools import cached_property
from typing import Any

import torch
from torch import Tensor
from torch.utils.data import Dataset
from torch_geometric.data import Data
from torch_geometric.transforms import BaseTransform

from torch_geometric_tactile.data import StaticData, StaticDataset, apply_transform
from torch_geometric_tactile.data._batches import check_joinable, static_batch, static_parts
from torch_geometric_tactile.data._graph_samples import GraphSamples, without_transform

_BYTES = 2**22  # of the attributes of the samples that are transformed at a time

AnySamples = StaticData | Dataset | Sequence[Data]


def as_static_data(data: AnySamples) -> StaticData:
    r"""Returns all samples at once, before the :obj:`transform` of their data set."""
    if isinstance(data, StaticData):
        return data
    if isinstance(data, StaticDataset):
        return data.data
    samples = Samples(data)
    return samples.select(torch.arange(samples.num_samples))


class Samples:
    r"""Samples as a transform sees them that comes after others: these are applied to a few samples
    at a time, so that neither their results nor a memory-mapped data set need to fit into memory.
    """

    def __init__(
        self, data: AnySamples, before: BaseTransform | None = None, max_samples: int = 8192
    ) -> None:
        self._data = without_transform(data)
        self.num_samples = data.num_samples if isinstance(data, StaticData) else len(self._data)
        self._before = before
        self._max_samples = max_samples
        parts = _static_parts(self._data)
        self._is_static = len(parts) > 0
        if len(parts) > 1:
            check_joinable(parts)
        # Of others, what some samples share the next ones need not.
        self._is_one = isinstance(self._data, StaticData | StaticDataset)
        self._first: StaticData | None = None
        self._columns: dict[str, Tensor] = {}

    @property
    def first(self) -> StaticData:
        r"""The first sample, transformed; there must be one."""
        if self._first is None:
            self._first = self.select(torch.tensor([0]))
        return self._first

    def is_shared(self, key: str) -> bool:
        r"""Tells whether all samples share one value of an attribute."""
        return self._is_one and self.first.is_shared(key)

    def select(self, index: Tensor, key: str | None = None) -> StaticData:
        r"""Returns some samples, transformed."""
        data = self._data
        if isinstance(data, StaticDataset):
            chunk = data.batch(index)
        elif isinstance(data, StaticData):
            # A slice of what is read in order copies nothing.
            start, stop = int(index[0]), int(index[-1]) + 1
            in_order = stop - start == len(index)
            chunk = data.index_select(slice(start, stop) if in_order else index)
        elif self._is_static:
            chunk = static_batch(data, index.tolist())
        else:
            samples = [data[i] for i in index.tolist()]
            if key is not None and self._before is None:  # the others may have any shape
                samples = [Data(**{key: sample[key]}) for sample in samples]
            chunk = StaticData.from_data_list(samples)
        return apply_transform(self._before, chunk)

    def parts(self, index: Tensor) -> Sequence[Tensor]:
        r"""Returns indices in parts, of as many samples as are read at a time."""
        size = sum(
            value.numel() * value.element_size()
            for key, value in self.first.to_dict().items()
            if isinstance(value, Tensor) and not self.first.is_shared(key)
        )
        most = max(1, min(self._max_samples, _BYTES // max(size, 1)))
        return index.split(most)

    def __contains__(self, key: str) -> bool:
        return getattr(self.first, key, None) is not None

    def __getitem__(self, key: str) -> Tensor:
        r"""One attribute of all samples, which should be small."""
        if key not in self._columns:
            self._columns[key] = self._column(key)
        return self._columns[key]

    def _column(self, key: str) -> Tensor:
        if self._before is None and self._is_one:
            data = self._data
            value = data.column(key) if isinstance(data, StaticDataset) else data[key]
            assert value is not None
            return value
        index = torch.arange(self.num_samples)
        if self.is_shared(key):
            return self.first[key]
        return torch.cat(list(self.values(key, index)))

    def values(self, key: str, index: Tensor) -> Iterator[Tensor]:
        r"""Yields an attribute of the samples, a few at a time, or once with one sample if they
        all share it.
        """
        for part in self.parts(index):
            chunk = self.select(part, key)
            value = chunk[key]
            if not chunk.is_shared(key):
                yield value
            elif self._is_one:
                yield value.unsqueeze(0)
                return
            else:
                yield value.expand(len(part), *value.shape)


def _static_parts(data: Any) -> list[StaticDataset]:
    try:
        return list(static_parts(data))
    except TypeError:
        return []


class FlatSamples:
    r"""Samples that need not share their taxels, as a transform sees them that comes after others:
    the rows of all of them, one after the other. Transforms are applied to each by itself.
    """

    def __init__(self, data: AnySamples, before: BaseTransform | None = None) -> None:
        self._samples = GraphSamples(without_transform(data))
        self._before = before
        self.num_samples = len(self._samples)
        self._columns: dict[str, Tensor] = {}

    def _sample(self, i: int) -> Data:
        sample = self._samples[i]
        return sample if self._before is None else self._before(sample)

    @cached_property
    def first(self) -> Data:
        r"""The first sample, transformed."""
        return self._sample(0)

    def is_shared(self, key: str) -> bool:
        r"""Tells whether all samples share one value of an attribute: they do not."""
        return False

    def __contains__(self, key: str) -> bool:
        return self.first.to_dict().get(key) is not None

    def __getitem__(self, key: str) -> Tensor:
        r"""One attribute of all samples, which should be small."""
        if key not in self._columns:
            value = self._samples.column(key) if self._before is None else None
            if value is None:
                value = GraphSamples([self._sample(i) for i in range(self.num_samples)]).column(key)
            assert value is not None
            self._columns[key] = value
        return self._columns[key]

    def values(self, key: str, index: Tensor) -> Iterator[Tensor]:
        r"""Yields the rows of an attribute, of a few samples at a time."""
        size = self.first[key].numel() * self.first[key].element_size()
        for part in index.split(max(1, _BYTES // max(size, 1))):
            rows = torch.cat([self._sample(i)[key] for i in part.tolist()])
            if len(rows):
                yield rows


def is_static(data: AnySamples) -> bool:
    r"""Tells whether all samples share one topology, by the kind of their data set."""
    return isinstance(data, StaticData) or bool(_static_parts(data))
