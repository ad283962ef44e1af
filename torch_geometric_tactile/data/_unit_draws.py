r"""The random draws of a split: which units a fold tests on, which fractions hold out, and the
classes that either is stratified by.
"""

import warnings
import zlib
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from torch_geometric_tactile._checks import Argument, ArgumentError
from torch_geometric_tactile.data._graph_samples import AnySamples as Samples
from torch_geometric_tactile.data._graph_samples import sample_column
from torch_geometric_tactile.data._levels import NAMED
from torch_geometric_tactile.data.static_data import StaticData


class Classes:
    r"""The classes of a stratified split: of each unit, or of each sample where units are mixed.

    Shapes:
        - **unit:** The number of the unit of each sample :math:`(S,)`.
    """

    def __init__(self, dataset: Samples, key: str, unit: np.ndarray, by: str) -> None:
        value = numbers_of(dataset, key, f"stratified by '{key}'")
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
            raise ArgumentError(
                Argument("folds"),
                f" must be at most {self.num_units.max()}, the {self.by}s of the most "
                f"frequent {self.what}, to be stratified by '{self.key}' (got {folds})",
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
    is_named = key in NAMED and not isinstance(dataset, StaticData)
    names = getattr(dataset, f"{NAMED[key]}_names") if is_named else ()
    if found.ndim > 1 or (len(found) and not 0 <= found.min() <= found.max() < len(names)):
        return [str(value) for value in found.tolist()]
    return [names[i] for i in found]


def numbers_of(dataset: Samples, key: str, how: str | None = None) -> np.ndarray:
    r"""Returns an attribute of the samples, or their numbers for :obj:`"frame"`."""
    if key == "frame":
        return np.arange(len(dataset))  # type: ignore[arg-type]  # checked by `as_samples`
    column = sample_column(dataset, key)
    if column is None:
        raise ValueError(f"'dataset' must have '{key}' to be {how or f'split by {key}'} (got none)")
    values: np.ndarray = column.numpy(force=True)
    return values


@dataclass(frozen=True)
class Folds:
    r"""Random folds of units."""

    count: int
    by: str

    def draw(self, unit: np.ndarray, classes: Classes | None, seed: int, fold: int) -> np.ndarray:
        r"""Returns the units of a fold.

        Shapes:
            - **unit:** The number of the unit of each sample :math:`(S,)`.
        """
        # Imported here, since it takes as long as everything else together.
        from sklearn.model_selection import GroupKFold, KFold, StratifiedGroupKFold, StratifiedKFold

        num_units = len(np.unique(unit))
        if self.count > num_units:
            raise ArgumentError(
                Argument("folds"),
                f" must be between 2 and the {num_units} {self.by}s there are (got {self.count})",
            )
        drawn = {"n_splits": self.count, "shuffle": True, "random_state": seed}
        if classes is None:
            kind = KFold if self.by == "frame" else GroupKFold
            parts = kind(**drawn).split(unit, groups=None if self.by == "frame" else unit)
            return np.unique(unit[list(parts)[fold][1]])
        classes.check_folds(self.count)
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", "The least populated class")  # ours names it
            if classes.of_unit is not None:
                parts = StratifiedKFold(**drawn).split(classes.of_unit, classes.of_unit)
                return list(parts)[fold][1]
            parts = StratifiedGroupKFold(**drawn).split(unit, classes.of_sample, groups=unit)
            return np.unique(unit[list(parts)[fold][1]])


@dataclass(frozen=True)
class Fractions:
    r"""Random fractions of units, held out for validation and for the test."""

    val: float
    test: float
    by: str

    def draw(
        self, units: np.ndarray, classes: Classes | None, seeds: Sequence[int]
    ) -> tuple[np.ndarray, np.ndarray]:
        r"""Returns the units to validate and to test on."""
        if classes is not None:
            return self._draw_by_class(units, classes, seeds)
        count = len(units)
        num_val, num_test = round(self.val * count), round(self.test * count)
        for name, part, num in (("val", self.val, num_val), ("test", self.test, num_test)):
            if part > 0 and num == 0:
                raise ArgumentError(
                    Argument(name), f" of {part} leaves nothing of {count} {self.by}s"
                )
        if num_val + num_test >= count:
            raise ValueError(f"'val' and 'test' leave nothing of {count} {self.by}s to train on")
        order = np.random.default_rng(seeds).permutation(units)
        return order[num_test : num_test + num_val], order[:num_test]

    def _draw_by_class(
        self, units: np.ndarray, classes: Classes, seeds: Sequence[int]
    ) -> tuple[np.ndarray, np.ndarray]:
        val, test = [], []
        for i, name in classes.require_units():
            mine = units[classes.of_unit[units] == i]  # type: ignore[index]  # required above
            num_val, num_test = self._num_held_out(len(mine), f"{classes.what} '{name}'")
            # By name, so that other classes in the data set do not change the draw of this one.
            rng = np.random.default_rng([*seeds, zlib.crc32(name.encode())])
            order = rng.permutation(mine)
            test.append(order[:num_test])
            val.append(order[num_test : num_test + num_val])
        return np.concatenate(val), np.concatenate(test)

    def _num_held_out(self, count: int, what: str) -> tuple[int, int]:
        num_val, num_test = (
            max(1, round(part * count)) if part else 0 for part in (self.val, self.test)
        )
        while num_val + num_test >= count and num_val + num_test > 0:
            if num_val > num_test or (num_val and num_test == 1):
                num_val -= 1
            elif num_test > 1:
                num_test -= 1
            else:
                raise ValueError(
                    f"{what} must have at least 2 {self.by}s to train and to test on (got {count})"
                )
        return num_val, num_test
