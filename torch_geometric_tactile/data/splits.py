r"""Shorthand functions for common splits by :class:`~torch_geometric_tactile.data.Protocol`."""

from collections.abc import Iterator
from typing import NamedTuple

from torch import Tensor

from torch_geometric_tactile.data._shared_samples import (
    SharedDataWarning,
    num_shared,
    shared_recordings,
    shared_units,
)
from torch_geometric_tactile.data.protocol import Protocol, Samples, Split, Unit

__all__ = [
    "Fold",
    "Protocol",
    "SharedDataWarning",
    "Split",
    "Unit",
    "by_frame",
    "by_group",
    "by_trial",
    "k_fold",
    "leave_one_group_out",
    "num_shared",
    "shared_recordings",
    "shared_units",
]


class Fold(NamedTuple):
    r"""The sorted sample indices of one fold: :obj:`train` and the held-out :obj:`test`.

    Examples:
        >>> import torch
        >>> Fold(train=torch.tensor([0, 1]), test=torch.tensor([2])).test
        tensor([2])
    """

    train: Tensor
    test: Tensor


def by_frame(dataset: Samples, val: float = 0.1, test: float = 0.2, seed: int = 0) -> Split:
    r"""Splits samples at random, like ``Protocol("frame", val=val, test=test)``.

    Args:
        dataset (Dataset or StaticData or list of Data): The samples.
        val (float): The fraction of the samples held out for validation.
        test (float): The fraction of the samples held out for the test.
        seed (int): Selects one of the random splits.

    Examples:
        >>> from torch_geometric_tactile.datasets import FakeTactileDataset
        >>> dataset = FakeTactileDataset(num_samples=10)
        >>> [len(part) for part in by_frame(dataset)]
        [7, 1, 2]
    """
    return Protocol("frame", val=val, test=test).split(dataset, seed)


def by_trial(dataset: Samples, val: float = 0.1, test: float = 0.2, seed: int = 0) -> Split:
    r"""Splits trials at random, like ``Protocol("trial", val=val, test=test)``.

    Args:
        dataset (Dataset or StaticData or list of Data): The samples, with :obj:`trial`.
        val (float): The fraction of the trials held out for validation.
        test (float): The fraction of the trials held out for the test.
        seed (int): Selects one of the random splits.

    Examples:
        >>> from torch_geometric_tactile.datasets import FakeTactileDataset
        >>> dataset = FakeTactileDataset(num_samples=40)
        >>> split = by_trial(dataset)
        >>> set(dataset.trial[split.train].tolist()) & set(dataset.trial[split.test].tolist())
        set()
    """
    return Protocol("trial", val=val, test=test).split(dataset, seed)


def by_group(dataset: Samples, val: float = 0.1, test: float = 0.2, seed: int = 0) -> Split:
    r"""Splits groups at random, like ``Protocol("group", val=val, test=test)``.

    Args:
        dataset (Dataset or StaticData or list of Data): The samples, with :obj:`group`.
        val (float): The fraction of the groups held out for validation.
        test (float): The fraction of the groups held out for the test.
        seed (int): Selects one of the random splits.

    Examples:
        >>> from torch_geometric_tactile.datasets import FakeTactileDataset
        >>> dataset = FakeTactileDataset(num_samples=40)
        >>> split = by_group(dataset)
        >>> set(dataset.group[split.train].tolist()) & set(dataset.group[split.test].tolist())
        set()
    """
    return Protocol("group", val=val, test=test).split(dataset, seed)


def leave_one_group_out(dataset: Samples) -> Iterator[Fold]:
    r"""Yields the folds of ``Protocol("group", leave_one_out=True)`` in the order of the groups.

    Args:
        dataset (Dataset or StaticData or list of Data): The samples, with :obj:`group`.

    Examples:
        >>> from torch_geometric_tactile.datasets import FakeTactileDataset
        >>> dataset = FakeTactileDataset(num_samples=40)
        >>> folds = list(leave_one_group_out(dataset))
        >>> len(folds) == len(dataset.group.unique())
        True
    """
    protocol = Protocol("group", leave_one_out=True)
    for fold in range(protocol.num_folds(dataset)):
        train, _, test = protocol.split(dataset, fold=fold)
        yield Fold(train, test)


def k_fold(
    dataset: Samples,
    folds: int = 5,
    by: Unit = "trial",
    seed: int = 0,
    stratify: str | None = None,
) -> list[Fold]:
    r"""Returns the folds of ``Protocol(by, folds=folds, stratify=stratify)``.

    Args:
        dataset (Dataset or StaticData or list of Data): The samples.
        folds (int): Number of folds.
        by (str): The unit that stays together, as in :class:`Protocol`.
        seed (int): Selects one of the random partitions.
        stratify (str, optional): The attribute with the classes by which the folds are stratified.

    Examples:
        >>> from torch_geometric_tactile.datasets import FakeTactileDataset
        >>> folds = k_fold(FakeTactileDataset(num_samples=40), folds=4)
        >>> len(folds)
        4
    """
    protocol = Protocol(by, folds=folds, stratify=stratify)
    splits = (protocol.split(dataset, seed, fold) for fold in range(folds))
    return [Fold(split.train, split.test) for split in splits]
