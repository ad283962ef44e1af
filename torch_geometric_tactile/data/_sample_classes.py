r"""The units of a split, and the classes that it is stratified by."""

import warnings

import numpy as np

from torch_geometric_tactile.data.static_data import StaticData
from torch_geometric_tactile.data.static_dataset import StaticDataset

Samples = StaticDataset | StaticData
_NAMED = {"y": "class_names", "group": "group_names", "session": "session_names"}


class Classes:
    r"""The classes of a stratified split: of each unit, or of each sample where units are mixed.

    Shapes:
        - **unit:** The number of the unit of each sample :math:`(S,)`.
    """

    def __init__(self, dataset: Samples, key: str, unit: np.ndarray, by: str) -> None:
        value = column(dataset, key, f"stratified by '{key}'")
        if not np.array_equal(value, np.round(value)):
            raise ValueError(f"'{key}' must hold integers to be stratified by (got {value.dtype})")
        found, of_sample = np.unique(value.astype(np.int64), axis=0, return_inverse=True)
        self.of_sample = of_sample.reshape(-1)
        self.names = _class_names(dataset, key, found)
        self.what = {"y": "class", "group": "object"}.get(key, key)
        self.key, self.by = key, by
        _, first = np.unique(unit, return_index=True)
        self._one = self.of_sample[first]
        mixed = np.flatnonzero(self._one[unit] != self.of_sample)
        self.of_unit = None if len(mixed) else self._one
        pairs = np.unique(np.stack([self.of_sample, unit]), axis=1)
        self.num_units = np.bincount(pairs[0], minlength=len(found))

    def require_units(self) -> list[tuple[int, str]]:
        r"""Returns number and name of each class."""
        if self.of_unit is None:
            raise ValueError(
                f"every {self.by} must have one '{self.key}' for all its samples to be stratified "
                "by it in fractions (got several): choose 'folds' without 'val', or no 'stratify'"
            )
        return list(enumerate(self.names))

    def check_folds(self, folds: int) -> None:
        r"""Warns of classes that cannot be in every fold."""
        if self.of_unit is not None and folds > self.num_units.max():
            raise ValueError(
                f"'folds' must be at most {self.num_units.max()}, the {self.by}s of the most "
                f"frequent {self.what}, to be stratified by '{self.key}' (got {folds})"
            )
        few = [
            f"'{name}' ({count})"
            for name, count in zip(self.names, self.num_units, strict=True)
            if count < folds
        ]
        if few:
            warnings.warn(
                f"some of the {folds} folds cannot have every {self.what}: fewer {self.by}s than "
                f"folds have {', '.join(few)}",
                UserWarning,
                stacklevel=5,
            )


def label_classes(dataset: Samples, unit: np.ndarray, by: str, needed: int) -> Classes | None:
    r"""Returns the classes of :obj:`y` where they allow to stratify: each has enough units, and
    each unit one class.

    Shapes:
        - **unit:** The number of the unit of each sample :math:`(S,)`.
    """
    try:
        classes = Classes(dataset, "y", unit, by)
    except ValueError:  # no labels, or numbers of a regression
        return None
    allowed = classes.of_unit is not None and classes.num_units.min(initial=needed) >= needed
    return classes if allowed else None


def _class_names(dataset: Samples, key: str, found: np.ndarray) -> list[str]:
    names = getattr(dataset, _NAMED[key]) if key in _NAMED and not _is_data(dataset) else ()
    if found.ndim > 1 or (len(found) and not 0 <= found.min() <= found.max() < len(names)):
        return [str(value) for value in found.tolist()]
    return [names[i] for i in found]


def _is_data(dataset: Samples) -> bool:
    return isinstance(dataset, StaticData)


def column(dataset: Samples, key: str, how: str | None = None) -> np.ndarray:
    r"""Returns an attribute of the samples, or their numbers for :obj:`"frame"`."""
    if key == "frame":
        return np.arange(
            len(dataset) if isinstance(dataset, StaticDataset) else dataset.num_samples
        )
    if isinstance(dataset, StaticDataset):
        column = dataset.column(key)
    else:
        column = dataset[key] if key in dataset else None  # noqa: SIM401 - Data is no mapping
    if column is None:
        raise ValueError(f"'dataset' must have '{key}' to be {how or f'split by {key}'} (got none)")
    values: np.ndarray = column.numpy(force=True)
    return values
