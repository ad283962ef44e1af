r"""Samples of one batch, cut together or one by one."""

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any, overload

import torch
from torch_geometric.data import Data

from torch_geometric_tactile.data.static_data import StaticData

if TYPE_CHECKING:
    from torch_geometric_tactile.data.static_dataset import StaticDataset


class StaticSamples(Sequence[Data]):
    r"""Some samples of a :class:`~torch_geometric_tactile.data.StaticDataset`, read when they are
    asked for: one by one as a list of :class:`~torch_geometric.data.Data`, as PyG's
    :class:`~torch_geometric.loader.DataLoader` does, or in one piece by :meth:`batch`, as
    :class:`~torch_geometric_tactile.loader.StaticLoader` does.

    Args:
        dataset (StaticDataset): The data set.
        index (sequence of int): Indices into its selection :math:`(B,)`.
    """

    def __init__(self, dataset: "StaticDataset", index: Sequence[int]) -> None:
        self._dataset = dataset
        self._index = index
        self._samples: list[Data] | None = None

    def batch(self) -> StaticData:
        r"""Returns all of them at once, after the :obj:`transform` of the data set."""
        return self._dataset.batch(torch.as_tensor(self._index, dtype=torch.long))

    def _list(self) -> list[Data]:
        # Kept, so that a random transform is applied once to each.
        if self._samples is None:
            self._samples = [self._dataset[int(i)] for i in self._index]
        return self._samples

    def __len__(self) -> int:
        return len(self._index)

    @overload
    def __getitem__(self, i: int) -> Data: ...

    @overload
    def __getitem__(self, i: slice) -> Sequence[Data]: ...

    def __getitem__(self, i: int | slice) -> Data | Sequence[Data]:
        return self._list()[i]

    def __iter__(self) -> Iterator[Data]:
        return iter(self._list())

    def __reduce__(self) -> Any:
        return list, (self._list(),)  # a worker sends the samples, not the data set
