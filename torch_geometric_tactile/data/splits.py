r"""Splits that say what they hold out. All are deterministic by seed.

A split by frame puts frames of one trial on both sides and recognises the trial; a split by trial
does not; a split by group (by object) asks for what was never touched before.
"""

from collections.abc import Iterator
from typing import Literal, NamedTuple

import numpy as np
import torch
from sklearn.model_selection import GroupKFold, KFold, LeaveOneGroupOut
from torch import Tensor

from torch_geometric_tactile.data.static_data import StaticData
from torch_geometric_tactile.data.static_dataset import StaticDataset

Unit = Literal["frame", "trial", "group"]


class Split(NamedTuple):
    r"""Indices into a data set, sorted: :obj:`train`, :obj:`val` and :obj:`test`."""

    train: Tensor
    val: Tensor
    test: Tensor


class Fold(NamedTuple):
    r"""Indices into a data set, sorted: :obj:`train` and what is held out, :obj:`test`."""

    train: Tensor
    test: Tensor


def by_frame(
    dataset: StaticDataset | StaticData, val: float = 0.1, test: float = 0.2, seed: int = 0
) -> Split:
    r"""Splits at random, sample by sample, whatever trial or object a sample belongs to.

    Args:
        dataset (StaticDataset or StaticData): The samples.
        val (float): The part held out for validation.
        test (float): The part held out for the test.
        seed (int): Which of the random splits.

    Raises:
        ValueError: If a part is not within 0 and 1, or a non-zero part would get nothing.

    Examples:
        >>> data = StaticData(x=torch.zeros(10, 1, 1))
        >>> [len(part) for part in by_frame(data)]
        [7, 1, 2]
    """
    return _split(_units(dataset, "frame"), "frame", val, test, seed)


def by_trial(
    dataset: StaticDataset | StaticData, val: float = 0.1, test: float = 0.2, seed: int = 0
) -> Split:
    r"""Splits at random, trial by trial: no trial is on two sides.

    Args:
        dataset (StaticDataset or StaticData): The samples, with :obj:`trial`.
        val (float): The part of the trials held out for validation.
        test (float): The part of the trials held out for the test.
        seed (int): Which of the random splits.

    Raises:
        ValueError: If a part is not within 0 and 1, a non-zero part would get nothing, or the
            samples have no :obj:`trial`.
    """
    return _split(_units(dataset, "trial"), "trial", val, test, seed)


def by_group(
    dataset: StaticDataset | StaticData, val: float = 0.1, test: float = 0.2, seed: int = 0
) -> Split:
    r"""Splits at random, group by group (object by object): no group is on two sides.

    Args:
        dataset (StaticDataset or StaticData): The samples, with :obj:`group`.
        val (float): The part of the groups held out for validation.
        test (float): The part of the groups held out for the test.
        seed (int): Which of the random splits.

    Raises:
        ValueError: If a part is not within 0 and 1, a non-zero part would get nothing, or the
            samples have no :obj:`group`.
    """
    return _split(_units(dataset, "group"), "group", val, test, seed)


def leave_one_group_out(dataset: StaticDataset | StaticData) -> Iterator[Fold]:
    r"""Yields one fold for each group: trained on all others, tested on it, in order of the groups.

    Args:
        dataset (StaticDataset or StaticData): The samples, with :obj:`group`.

    Raises:
        ValueError: If there are fewer than two groups.
    """
    groups = _units(dataset, "group")
    count = len(np.unique(groups))
    if count < 2:
        raise ValueError(f"'dataset' must have at least 2 groups to leave one out (got {count})")
    for train, test in LeaveOneGroupOut().split(groups, groups=groups):
        yield Fold(torch.from_numpy(train), torch.from_numpy(test))


def k_fold(
    dataset: StaticDataset | StaticData, k: int = 5, by: Unit = "trial", seed: int = 0
) -> list[Fold]:
    r"""Cuts the samples into :obj:`k` random folds.

    Args:
        dataset (StaticDataset or StaticData): The samples.
        k (int): Number of folds.
        by (str): What stays together: :obj:`"frame"` (nothing), :obj:`"trial"` or
            :obj:`"group"`.
        seed (int): Which of the random partitions.

    Raises:
        ValueError: If :obj:`by` is unknown, or there are fewer units than folds.
    """
    units = _units(dataset, by)
    count = len(np.unique(units))
    if not 2 <= k <= count:
        raise ValueError(f"'k' must be between 2 and the {count} {by}s there are (got {k})")
    folds = (KFold if by == "frame" else GroupKFold)(k, shuffle=True, random_state=seed)
    return [
        Fold(torch.from_numpy(train), torch.from_numpy(test))
        for train, test in folds.split(units, groups=None if by == "frame" else units)
    ]


def _units(dataset: StaticDataset | StaticData, by: Unit) -> np.ndarray:
    if by == "frame":
        return np.arange(
            len(dataset) if isinstance(dataset, StaticDataset) else dataset.num_samples
        )
    if by not in ("trial", "group"):
        raise ValueError(f"'by' must be 'frame', 'trial' or 'group' (got '{by}')")
    if isinstance(dataset, StaticDataset):
        column = dataset.column(by)
    else:
        column = dataset[by] if by in dataset else None  # noqa: SIM401 - Data is no mapping
    if column is None:
        raise ValueError(f"'dataset' must have '{by}' to be split by {by} (got none)")
    units: np.ndarray = column.numpy()
    return units


def _split(units: np.ndarray, by: str, val: float, test: float, seed: int) -> Split:
    for name, part in (("val", val), ("test", test), ("val + test", val + test)):
        if not 0 <= part < 1:
            raise ValueError(f"'{name}' must be at least 0 and below 1 (got {part})")
    names = np.unique(units)
    num_val, num_test = round(val * len(names)), round(test * len(names))
    for name, part, num in (("val", val, num_val), ("test", test, num_test)):
        if part > 0 and num == 0:
            raise ValueError(f"'{name}' of {part} leaves nothing of {len(names)} {by}s")
    if num_val + num_test >= len(names):
        raise ValueError(f"'val' and 'test' leave nothing of {len(names)} {by}s to train on")
    order = np.random.default_rng(seed).permutation(names)
    held = (order[num_test + num_val :], order[num_test : num_test + num_val], order[:num_test])
    return Split(*(torch.from_numpy(np.flatnonzero(np.isin(units, part))) for part in held))
