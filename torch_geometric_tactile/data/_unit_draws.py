r"""The random draws of a split: folds and fractions of units, and their stratification by class."""

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
    r"""The classes by which a split is stratified, of each sample and, where all samples of a unit
    have one class, of each unit.

    Args:
        dataset (Dataset or StaticData): The samples.
        key (str): The attribute whose values are the classes.
        unit (numpy.ndarray): The index of the unit of each sample :math:`(S,)`.
        by (str): Name of the units, such as :obj:`"trial"`.

    Raises:
        ValueError: If the samples do not have the attribute, or it does not hold integers.
    """

    def __init__(self, dataset: Samples, key: str, unit: np.ndarray, by: str) -> None:
        value = split_column(dataset, key, f"stratified by '{key}'")
        if not np.array_equal(value, np.round(value)):
            raise ValueError(f"'{key}' must hold integers to be stratified by (got {value.dtype})")
        class_values, sample_class = np.unique(value.astype(np.int64), axis=0, return_inverse=True)
        self.sample_class = sample_class.reshape(-1)
        self.names = _class_names(dataset, key, class_values)
        self.kind = {"y": "class", "group": "object"}.get(key, key)
        self.key, self.by = key, by
        _, first = np.unique(unit, return_index=True)
        self._first_class = self.sample_class[first]
        mixed = np.flatnonzero(self._first_class[unit] != self.sample_class)
        self.unit_class = None if len(mixed) else self._first_class
        pairs = np.unique(np.stack([self.sample_class, unit]), axis=1)
        self.num_units = np.bincount(pairs[0], minlength=len(class_values))

    def require_unit_classes(self) -> list[tuple[int, str]]:
        r"""Checks that each unit has one class, and returns the number and name of each class.

        Raises:
            ValueError: If a unit has several classes.
        """
        if self.unit_class is None:
            raise ValueError(
                f"all samples of a {self.by} must have the same '{self.key}' to stratify fractions "
                "by it (got several): use 'folds' without 'val', or no 'stratify'"
            )
        return list(enumerate(self.names))

    def check_folds(self, folds: int) -> None:
        r"""Checks the number of folds, and warns of classes that cannot be in every fold.

        Raises:
            ArgumentError: If there are more folds than units of the most frequent class.
        """
        if self.unit_class is not None and folds > self.num_units.max():
            raise ArgumentError(
                Argument("folds"),
                f" must be at most {self.num_units.max()}, the {self.by}s of the most "
                f"frequent {self.kind}, to be stratified by '{self.key}' (got {folds})",
            )
        rare_classes = [
            f"'{name}' ({count})"
            for name, count in zip(self.names, self.num_units, strict=True)
            if count < folds
        ]
        if rare_classes:
            warnings.warn(
                f"some of the {folds} folds cannot have every {self.kind}, since some have fewer "
                f"{self.by}s than folds: {', '.join(rare_classes)}",
                UserWarning,
                stacklevel=5,
            )


def label_classes(dataset: Samples, unit: np.ndarray, by: str, min_units: int) -> Classes | None:
    r"""Returns the classes of :obj:`y`, or :obj:`None` if a split cannot be stratified by them: a
    class has fewer than :obj:`min_units` units, or a unit has several classes.

    Shapes:
        - **unit:** The index of the unit of each sample :math:`(S,)`.
    """
    try:
        classes = Classes(dataset, "y", unit, by)
    except ValueError:  # no labels, or real numbers as targets of a regression
        return None
    is_usable = (
        classes.unit_class is not None and classes.num_units.min(initial=min_units) >= min_units
    )
    return classes if is_usable else None


def _class_names(dataset: Samples, key: str, class_values: np.ndarray) -> list[str]:
    is_named = key in NAMED and not isinstance(dataset, StaticData)
    names = getattr(dataset, f"{NAMED[key]}_names") if is_named else ()
    if class_values.ndim > 1 or (
        len(class_values) and not 0 <= class_values.min() <= class_values.max() < len(names)
    ):
        return [str(value) for value in class_values.tolist()]
    return [names[i] for i in class_values]


def split_column(dataset: Samples, key: str, purpose: str | None = None) -> np.ndarray:
    r"""Returns the attribute by which samples are split, or their indices for :obj:`"frame"`.

    Args:
        dataset (Dataset or StaticData): The samples.
        key (str): Name of the attribute.
        purpose (str, optional): The use of the attribute, for the message.

    Raises:
        ValueError: If the samples do not have the attribute.
    """
    if key == "frame":
        return np.arange(len(dataset))  # type: ignore[arg-type]  # checked by `as_samples`
    column = sample_column(dataset, key)
    if column is None:
        raise ValueError(
            f"'dataset' must have '{key}' to be {purpose or f'split by {key}'} (got none)"
        )
    values: np.ndarray = column.numpy(force=True)
    return values


@dataclass(frozen=True)
class Folds:
    r"""Random folds of units."""

    count: int
    by: str

    def draw(self, unit: np.ndarray, classes: Classes | None, seed: int, fold: int) -> np.ndarray:
        r"""Draws the folds and returns the units of one of them.

        Args:
            unit (numpy.ndarray): The index of the unit of each sample :math:`(S,)`.
            classes (Classes, optional): The classes by which the folds are stratified.
            seed (int): Seed of the draw.
            fold (int): Index of the fold.

        Raises:
            ArgumentError: If there are more folds than units.
        """
        # Imported here, since scikit-learn takes as long to import as the rest of the package.
        from sklearn.model_selection import GroupKFold, KFold, StratifiedGroupKFold, StratifiedKFold

        num_units = len(np.unique(unit))
        if self.count > num_units:
            raise ArgumentError(
                Argument("folds"),
                f" must be between 2 and the {num_units} {self.by}s of the data set (got "
                f"{self.count})",
            )
        options = {"n_splits": self.count, "shuffle": True, "random_state": seed}
        if classes is None:
            splitter = KFold if self.by == "frame" else GroupKFold
            parts = splitter(**options).split(unit, groups=None if self.by == "frame" else unit)
            return np.unique(unit[list(parts)[fold][1]])
        classes.check_folds(self.count)
        with warnings.catch_warnings():
            # `check_folds` has warned already, with the name of the class.
            warnings.filterwarnings("ignore", "The least populated class")
            if classes.unit_class is not None:
                parts = StratifiedKFold(**options).split(classes.unit_class, classes.unit_class)
                return list(parts)[fold][1]
            parts = StratifiedGroupKFold(**options).split(unit, classes.sample_class, groups=unit)
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
        r"""Draws the units for validation and for the test.

        Args:
            units (numpy.ndarray): The indices of the units to draw from :math:`(U,)`.
            classes (Classes, optional): The classes by which the parts are stratified.
            seeds (sequence of int): Seeds of the draw.

        Raises:
            ValueError: If a part would be empty.
        """
        if classes is not None:
            return self._draw_by_class(units, classes, seeds)
        count = len(units)
        num_val, num_test = round(self.val * count), round(self.test * count)
        for name, part, num in (("val", self.val, num_val), ("test", self.test, num_test)):
            if part > 0 and num == 0:
                raise ArgumentError(
                    Argument(name), f" of {part} is less than one of {count} {self.by}s"
                )
        if num_val + num_test >= count:
            raise ValueError(f"'val' and 'test' leave none of {count} {self.by}s to train on")
        order = np.random.default_rng(seeds).permutation(units)
        return order[num_test : num_test + num_val], order[:num_test]

    def _draw_by_class(
        self, units: np.ndarray, classes: Classes, seeds: Sequence[int]
    ) -> tuple[np.ndarray, np.ndarray]:
        val, test = [], []
        for i, name in classes.require_unit_classes():
            class_units = units[classes.unit_class[units] == i]  # type: ignore[index]  # checked
            num_val, num_test = self._num_held_out(len(class_units), f"{classes.kind} '{name}'")
            # Seeded by name, so that other classes in the data set do not change this draw.
            rng = np.random.default_rng([*seeds, zlib.crc32(name.encode())])
            order = rng.permutation(class_units)
            test.append(order[:num_test])
            val.append(order[num_test : num_test + num_val])
        return np.concatenate(val), np.concatenate(test)

    def _num_held_out(self, count: int, class_text: str) -> tuple[int, int]:
        # Reduces the numbers until one unit is left to train on, those of validation first.
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
                    f"{class_text} must have at least 2 {self.by}s to train and to test on (got "
                    f"{count})"
                )
        return num_val, num_test
