r"""Whole batches cut from one tensor."""

from collections.abc import Sequence
from typing import Any

import torch
from torch.utils.data import DataLoader, Dataset

from torch_geometric_tactile.data import StaticData, StaticDataset


class _Batches(Dataset):
    r"""A data set that hands over the samples of a batch in one piece."""

    def __init__(self, dataset: StaticDataset) -> None:
        self.dataset = dataset

    def __len__(self) -> int:
        return len(self.dataset)

    def __getitem__(self, index: int) -> StaticData:
        return self.dataset.batch([index])

    def __getitems__(self, index: Sequence[int]) -> StaticData:
        return self.dataset.batch(torch.tensor(index, dtype=torch.long))


def _identity(batch: Any) -> Any:
    return batch


class StaticLoader(DataLoader):
    r"""Loads batches of a :class:`~torch_geometric_tactile.data.StaticDataset` as
    :class:`~torch_geometric_tactile.data.StaticData`: readings :math:`(B, N, F)` beside the one
    :obj:`edge_index` of all samples.

    It yields the numbers of :class:`torch_geometric.loader.DataLoader` without building a
    :class:`~torch_geometric.data.Data` object for each sample. Shuffling, workers, pinned memory
    and distributed sampling are those of :class:`torch.utils.data.DataLoader`.

    Args:
        dataset (StaticDataset): The data set.
        batch_size (int): Number of samples of a batch.
        shuffle (bool, optional): Whether to draw the samples in a new order every epoch.
        **kwargs: Further arguments of :class:`torch.utils.data.DataLoader`, but :obj:`collate_fn`.

    Raises:
        TypeError: If :obj:`dataset` is no :class:`StaticDataset`.

    Examples:
        >>> from torch_geometric_tactile.datasets import FakeTactileDataset
        >>> loader = StaticLoader(FakeTactileDataset(num_samples=5), batch_size=4)
        >>> [batch.x.shape for batch in loader]
        [torch.Size([4, 24, 3]), torch.Size([1, 24, 3])]
    """

    def __init__(
        self,
        dataset: StaticDataset,
        batch_size: int | None = 1,
        shuffle: bool | None = None,
        **kwargs: Any,
    ) -> None:
        kwargs.pop("collate_fn", None)  # a batch is whole already
        if isinstance(dataset, _Batches):  # Lightning builds the loader again from its attributes
            dataset = dataset.dataset
        if not isinstance(dataset, StaticDataset):
            raise TypeError(
                f"'dataset' must be a StaticDataset (got {type(dataset).__name__}); use "
                "torch_geometric.loader.DataLoader for others"
            )
        super().__init__(_Batches(dataset), batch_size, shuffle, collate_fn=_identity, **kwargs)
