r"""Reading, in chunks, of the samples on which a transform is fitted."""

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

_CHUNK_BYTES = 2**22  # size of the samples that are transformed at a time

AnySamples = StaticData | Dataset | Sequence[Data]


def as_static_data(data: AnySamples) -> StaticData:
    r"""Returns all samples as one object, before the :obj:`transform` of their data set."""
    if isinstance(data, StaticData):
        return data
    if isinstance(data, StaticDataset):
        return data.data
    samples = Samples(data)
    return samples.select(torch.arange(samples.num_samples))


class Samples:
    r"""Samples on one topology, after earlier transforms. The samples are read and transformed in
    chunks, so that neither a memory-mapped data set nor the transformed samples need to fit into
    memory.

    Args:
        data (Dataset or StaticData or list of Data): The samples.
        before (BaseTransform, optional): The earlier transforms.
        max_samples (int): The largest number of samples in a chunk.
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
        # In other data, an attribute that all samples of one chunk share may differ in the next
        # chunk.
        self._is_single_set = isinstance(self._data, StaticData | StaticDataset)
        self._first: StaticData | None = None
        self._columns: dict[str, Tensor] = {}

    @property
    def first(self) -> StaticData:
        r"""The first sample after the earlier transforms. There must be at least one sample."""
        if self._first is None:
            self._first = self.select(torch.tensor([0]))
        return self._first

    def is_shared(self, key: str) -> bool:
        r"""Returns whether all samples share one value of an attribute."""
        return self._is_single_set and self.first.is_shared(key)

    def select(self, index: Tensor, key: str | None = None) -> StaticData:
        r"""Returns a selection of the samples after the earlier transforms.

        Args:
            index (torch.Tensor): Increasing indices :math:`(B,)`.
            key (str, optional): The only attribute that the caller needs.
        """
        data = self._data
        if isinstance(data, StaticDataset):
            chunk = data.batch(index)
        elif isinstance(data, StaticData):
            # A slice needs no copy.
            start, stop = int(index[0]), int(index[-1]) + 1
            is_consecutive = stop - start == len(index)
            chunk = data.index_select(slice(start, stop) if is_consecutive else index)
        elif self._is_static:
            chunk = static_batch(data, index.tolist())
        else:
            samples = [data[i] for i in index.tolist()]
            # Other attributes may have different shapes, which cannot be stacked.
            if key is not None and self._before is None:
                samples = [Data(**{key: sample[key]}) for sample in samples]
            chunk = StaticData.from_data_list(samples)
        return apply_transform(self._before, chunk)

    def parts(self, index: Tensor) -> Sequence[Tensor]:
        r"""Splits indices into chunks of samples that are read at a time."""
        size = sum(
            value.numel() * value.element_size()
            for key, value in self.first.to_dict().items()
            if isinstance(value, Tensor) and not self.first.is_shared(key)
        )
        chunk_size = max(1, min(self._max_samples, _CHUNK_BYTES // max(size, 1)))
        return index.split(chunk_size)

    def __contains__(self, key: str) -> bool:
        return getattr(self.first, key, None) is not None

    def __getitem__(self, key: str) -> Tensor:
        r"""Returns an attribute of all samples, which should be small since it is cached."""
        if key not in self._columns:
            self._columns[key] = self._column(key)
        return self._columns[key]

    def _column(self, key: str) -> Tensor:
        # Without earlier transforms, the other attributes need not be read.
        if self._before is None and self._is_single_set:
            data = self._data
            value = data.column(key) if isinstance(data, StaticDataset) else data[key]
            assert value is not None
            return value
        index = torch.arange(self.num_samples)
        if self.is_shared(key):
            return self.first[key]
        return torch.cat(list(self.values(key, index)))

    def values(self, key: str, index: Tensor) -> Iterator[Tensor]:
        r"""Yields an attribute of the samples chunk by chunk. An attribute that all samples share
        is yielded once, as the attribute of one sample.
        """
        for rows in self.parts(index):
            chunk = self.select(rows, key)
            value = chunk[key]
            if not chunk.is_shared(key):
                yield value
            elif self._is_single_set:
                yield value.unsqueeze(0)
                return
            else:
                yield value.expand(len(rows), *value.shape)


def _static_parts(data: Any) -> list[StaticDataset]:
    try:
        return list(static_parts(data))
    except TypeError:
        return []


class FlatSamples:
    r"""Samples whose taxels may differ, after earlier transforms, which are applied sample by
    sample. The values of an attribute are its rows in all samples, one sample after another.

    Args:
        data (Dataset or list of Data): The samples.
        before (BaseTransform, optional): The earlier transforms.
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
        r"""The first sample after the earlier transforms."""
        return self._sample(0)

    def is_shared(self, key: str) -> bool:
        r"""Returns :obj:`False`, since the samples share no attributes."""
        return False

    def __contains__(self, key: str) -> bool:
        return self.first.to_dict().get(key) is not None

    def __getitem__(self, key: str) -> Tensor:
        r"""Returns an attribute of all samples, which should be small since it is cached."""
        if key not in self._columns:
            value = self._samples.column(key) if self._before is None else None
            if value is None:
                value = GraphSamples([self._sample(i) for i in range(self.num_samples)]).column(key)
            assert value is not None
            self._columns[key] = value
        return self._columns[key]

    def values(self, key: str, index: Tensor) -> Iterator[Tensor]:
        r"""Yields the rows of an attribute, chunk by chunk."""
        size = self.first[key].numel() * self.first[key].element_size()
        for chunk in index.split(max(1, _CHUNK_BYTES // max(size, 1))):
            rows = torch.cat([self._sample(i)[key] for i in chunk.tolist()])
            if len(rows):
                yield rows


def is_static(data: AnySamples) -> bool:
    r"""Returns whether all samples share one topology, according to the class of their data set."""
    return isinstance(data, StaticData) or bool(_static_parts(data))
