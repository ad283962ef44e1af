r"""Whole batches cut from one tensor."""

import copy
from collections.abc import Sequence
from typing import Any

import torch
from torch.utils.data import ConcatDataset, DataLoader, Dataset, Subset
from torch_geometric.data import Data

from torch_geometric_tactile.data import StaticData, StaticDataset
from torch_geometric_tactile.data.apply_transform import stack_like
from torch_geometric_tactile.data.batches import check_joinable, static_batch, static_parts
from torch_geometric_tactile.data.static_samples import StaticSamples


class StaticCollater:
    r"""Turns what a loader has fetched into one :class:`StaticData`.

    Args:
        dataset (torch.utils.data.Dataset): The data set of the loader.
    """

    def __init__(self, dataset: Dataset) -> None:
        self.dataset = dataset

    def __call__(self, samples: Any) -> StaticData:
        r"""Returns the samples of a batch in one piece, if they were not read yet.

        Args:
            samples (StaticSamples or StaticData or StaticDataset or list or Data): The samples.
        """
        if isinstance(samples, StaticData):
            return samples
        if isinstance(samples, StaticSamples):
            return samples.batch()
        if isinstance(samples, StaticDataset):  # of a sampler that yields lists
            return samples.batch(range(len(samples)))
        samples = [samples] if isinstance(samples, Data) else list(samples)
        if not samples:
            return static_batch(self.dataset, [])
        return stack_like(samples, static_batch(self.dataset, []))


class _Joined(Dataset):
    # A ConcatDataset fetches one sample at a time; this cuts a batch from each of its parts.
    def __init__(self, dataset: Dataset) -> None:
        self.dataset = dataset

    def __len__(self) -> int:
        return len(self.dataset)  # type: ignore[arg-type]

    def __getitem__(self, index: Any) -> StaticData:  # one, or what a sampler of lists yields
        return static_batch(self.dataset, torch.as_tensor(index).view(-1).tolist())

    def __getitems__(self, index: Sequence[int]) -> StaticData:
        return static_batch(self.dataset, index)


class StaticLoader(DataLoader):
    r"""Loads batches of a :class:`~torch_geometric_tactile.data.StaticDataset` as
    :class:`~torch_geometric_tactile.data.StaticData`: readings :math:`(B, N, F)` together with the
    one :obj:`edge_index` of all samples.

    It yields the numbers of :class:`torch_geometric.loader.DataLoader` without building a
    :class:`~torch_geometric.data.Data` object for each sample. Shuffling, workers, pinned memory,
    samplers and distributed sampling are those of :class:`torch.utils.data.DataLoader`.

    Args:
        dataset (StaticDataset): The data set; or a :class:`~torch.utils.data.Subset` of one, such
            as the parts of :func:`~torch.utils.data.random_split`, or a
            :class:`~torch.utils.data.ConcatDataset` of several with one layout, the same edges and
            the same attributes.
        batch_size (int, optional): Number of samples of a batch. With :obj:`None`, each index of
            the sampler (or list of indices) is a batch.
        shuffle (bool, optional): Whether to draw the samples in a new order every epoch.
        **kwargs: Further arguments of :class:`torch.utils.data.DataLoader`, but :obj:`collate_fn`.

    Raises:
        TypeError: If :obj:`dataset` is of another kind, or :obj:`collate_fn`,
            :obj:`follow_batch` or :obj:`exclude_keys` are given.
        ValueError: If the parts of a :class:`~torch.utils.data.ConcatDataset` differ in their
            layouts, edges or attributes.

    Examples:
        >>> from torch_geometric_tactile.datasets import FakeTactileDataset
        >>> loader = StaticLoader(FakeTactileDataset(num_samples=5), batch_size=4)
        >>> [batch.x.shape for batch in loader]
        [torch.Size([4, 24, 3]), torch.Size([1, 24, 3])]
    """

    def __init__(
        self,
        dataset: Dataset,
        batch_size: int | None = 1,
        shuffle: bool | None = None,
        **kwargs: Any,
    ) -> None:
        _refuse(kwargs)
        parts = list(static_parts(dataset))
        if len(parts) > 1:
            check_joinable(parts)
        super().__init__(dataset, batch_size, shuffle, collate_fn=StaticCollater(dataset), **kwargs)

    def _get_iterator(self) -> Any:
        # Not public, and only for speed: without it `StaticCollater` stacks the single samples.
        if self.batch_size is not None and not _has_several(self.dataset):
            return super()._get_iterator()
        loader = copy.copy(self)
        loader.__dict__["dataset"] = _Joined(self.dataset)
        return DataLoader._get_iterator(loader)


def _refuse(kwargs: dict[str, Any]) -> None:
    # Lightning builds a loader again from its attributes, and passes our own collater.
    collate_fn = kwargs.pop("collate_fn", None)
    if collate_fn is not None and not isinstance(collate_fn, StaticCollater):
        raise TypeError(
            "StaticLoader must not be given a 'collate_fn', since it cuts each batch in one piece: "
            "use the 'transform' of the data set, or torch_geometric.loader.DataLoader"
        )
    advice = {
        "follow_batch": "in (B, N, F) each sample has its own row: use "
        "torch_geometric.loader.DataLoader for assignment vectors",
        "exclude_keys": "drop attributes in the 'transform' of the data set, or use "
        "torch_geometric.loader.DataLoader",
    }
    for key, text in advice.items():
        value = kwargs.pop(key, None)
        if value:
            raise TypeError(f"StaticLoader must not be given '{key}' (got {value}): {text}")


def _has_several(dataset: Dataset) -> bool:
    if isinstance(dataset, Subset):
        return _has_several(dataset.dataset)
    return isinstance(dataset, ConcatDataset)
