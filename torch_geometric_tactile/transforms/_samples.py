r"""The samples that a transform is fitted on, read a few at a time."""

import copy
from collections.abc import Iterator

import torch
from torch import Tensor
from torch_geometric.transforms import BaseTransform

from torch_geometric_tactile.data import StaticData, StaticDataset, apply_transform

_BYTES = 2**22  # of the attributes of the samples that are transformed at a time


class Samples:
    r"""Samples as a transform sees them that comes after others: these are applied to a few samples
    at a time, so that neither their results nor a memory-mapped data set need to fit into memory.

    Args:
        data (StaticDataset or StaticData): The samples, before any transform of the data set.
        before (BaseTransform, optional): What is applied to them.
        max_samples (int): Number of samples that are read at a time, at most.
    """

    def __init__(
        self,
        data: StaticDataset | StaticData,
        before: BaseTransform | None = None,
        max_samples: int = 8192,
    ) -> None:
        if isinstance(data, StaticDataset):
            data = copy.copy(data)
            data.transform = None
            self.num_samples = len(data)
        else:
            self.num_samples = data.num_samples
        self._data = data
        self._before = before
        self._max_samples = max_samples
        self._first: StaticData | None = None
        self._columns: dict[str, Tensor] = {}

    @property
    def first(self) -> StaticData:
        r"""The first sample, transformed; there must be one."""
        if self._first is None:
            self._first = self._select(torch.tensor([0]))
        return self._first

    def _select(self, index: Tensor) -> StaticData:
        data = self._data
        if isinstance(data, StaticDataset):
            chunk = data.batch(index)
        else:
            # A slice of what is read in order copies nothing.
            start, stop = int(index[0]), int(index[-1]) + 1
            in_order = stop - start == len(index)
            chunk = data.index_select(slice(start, stop) if in_order else index)
        return apply_transform(self._before, chunk)

    def chunks(self, index: Tensor) -> Iterator[StaticData]:
        r"""Yields samples, transformed, a few at a time.

        Args:
            index (torch.Tensor): Indices of the samples, ascending.
        """
        size = sum(
            value.numel() * value.element_size()
            for key, value in self.first.to_dict().items()
            if isinstance(value, Tensor) and not self.first.is_shared(key)
        )
        most = max(1, min(self._max_samples, _BYTES // max(size, 1)))
        for part in index.split(most):
            yield self._select(part)

    def __contains__(self, key: str) -> bool:
        return getattr(self.first, key, None) is not None

    def __getitem__(self, key: str) -> Tensor:
        r"""One attribute of all samples, which should be small."""
        if key not in self._columns:
            self._columns[key] = self._column(key)
        return self._columns[key]

    def _column(self, key: str) -> Tensor:
        if self._before is None:
            data = self._data
            value = data.column(key) if isinstance(data, StaticDataset) else data[key]
            assert value is not None
            return value
        parts = []
        for chunk in self.chunks(torch.arange(self.num_samples)):
            if chunk.is_shared(key):
                return chunk[key]
            parts.append(chunk[key])
        return torch.cat(parts)

    def values(self, key: str, index: Tensor) -> Iterator[Tensor]:
        r"""Yields an attribute of the samples, a few at a time, or once with one sample if they
        all share it.

        Args:
            key (str): Name of the attribute.
            index (torch.Tensor): Indices of the samples, ascending.
        """
        for chunk in self.chunks(index):
            if chunk.is_shared(key):
                yield chunk[key].unsqueeze(0)
                return
            yield chunk[key]
