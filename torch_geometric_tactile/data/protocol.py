r"""Protocols: which samples of a data set are held out for validation and test.

A split by frame puts frames of one trial in both the training and the test part, so that a model
can recognise the trial. A split by trial avoids this. A split by group tests on objects that the
model was not trained on.
"""

import warnings
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import KW_ONLY, asdict, dataclass, fields
from typing import Any, NamedTuple, Self

import numpy as np
import torch
from torch import Tensor

from torch_geometric_tactile._checks import Argument, ArgumentError, need
from torch_geometric_tactile.data._frame_view import dataset_part
from torch_geometric_tactile.data._graph_samples import AnySamples as Samples
from torch_geometric_tactile.data._graph_samples import GraphSamples, as_samples, sample_column
from torch_geometric_tactile.data._sample_units import (
    missing_unit,
    require_units,
    unit_column,
    unit_names,
)
from torch_geometric_tactile.data._shared_samples import warn_of_shared
from torch_geometric_tactile.data.static_dataset import StaticDataset
from torch_geometric_tactile.data.windows import Windows

#: The name of a unit that a split keeps together, such as ``"trial"``; ``"frame"`` is one sample.
Unit = str
_TRAIN, _VAL, _TEST, _NONE = range(4)


class Split(NamedTuple):
    r"""The sorted sample indices of the three parts of a data set: :obj:`train`, :obj:`val` and
    :obj:`test`.

    Examples:
        >>> split = Split(torch.tensor([0, 1]), torch.tensor([2]), torch.tensor([3]))
        >>> split.test
        tensor([3])
    """

    train: Tensor
    val: Tensor
    test: Tensor


@dataclass(frozen=True)
class Protocol:
    r"""The rule by which samples of a data set are held out for validation and test.

    A protocol is frozen. Two protocols with the same arguments are equal. The :obj:`seed` of
    :meth:`split` selects one of the random splits.

    * ``Protocol("trial")`` holds out random fractions, :obj:`val` and :obj:`test`.
    * ``Protocol("trial", folds=5)`` tests on each of five random folds in turn.
    * ``Protocol("group", leave_one_out=True)`` tests on each group (object) in turn.
    * ``Protocol("person", folds=5)`` tests on people that the model was not trained on. The samples
      or the metadata of their trials must name each person.
    * ``Protocol("given")`` uses the parts of the data set. Its :obj:`part` :math:`(S,)`, an
      attribute of the samples or a property of the data set, is 0 for training, 1 for validation
      and 2 for the test.

    With :obj:`unseen`, as in ``Protocol("group", folds=5, unseen="session")``, each fold is divided
    by session. For each session, the model is trained without the samples of the fold and without
    the samples of the session, and tested on the samples of the fold in this session: these samples
    show new objects *and* a new session. Every sample is still tested once.

    With :obj:`stratify`, an attribute of integers such as :obj:`"y"` or :obj:`"group"`, all parts
    have the same class proportions:

    * *Fractions* are drawn class by class. Each class has at least one unit to train on and one to
      test on; a class with three or more units also has one to validate on. The draw of a class
      depends only on the seed and the name of the class, not on other classes. A
      :class:`ValueError` is raised for a class with one unit, and for a trial or group with several
      classes.
    * *Folds* are drawn by scikit-learn's :class:`~sklearn.model_selection.StratifiedKFold` over the
      units, or by :class:`~sklearn.model_selection.StratifiedGroupKFold` if a unit has several
      classes. A :class:`UserWarning` names classes with fewer units than folds, which cannot be in
      every fold.

    Args:
        by (str): The unit that stays together. :obj:`"frame"` is a single sample. Other units are
            :obj:`"trial"`, :obj:`"group"` (an object), :obj:`"session"`, :obj:`"placement"` (of the
            hand), :obj:`"size"` (of the object) and any other attribute with an integer for each
            sample. A unit may also be a name such as :obj:`"person"` in the metadata of recordings,
            in the names of their files or in ``labels.csv``. :obj:`"given"` uses the parts of the
            data set.
        val (float, optional): The fraction of the units held out for validation; with folds, a
            fraction of the units outside the tested fold. The default is 0.1 without folds and 0
            with folds.
        test (float, optional): The fraction of the units held out for the test. The default is 0.2.
            Must be left out with folds.
        folds (int, optional): Number of random folds.
        leave_one_out (bool): Whether each unit is a fold.
        stratify (str, optional): The attribute with the classes by which the split is stratified.
            With :obj:`"auto"`, it is :obj:`"y"` if each class has enough units and each unit has
            one class; otherwise the split is not stratified.
        unseen (str, optional): With folds, an attribute of integers. Samples with the tested value
            of this attribute are left out of the training.

    Raises:
        ValueError: If :obj:`by` is not a name, a fraction is not between 0 and 1, there are fewer
            than two folds, or arguments contradict each other.

    Examples:
        >>> from torch_geometric_tactile.data import StaticData
        >>> data = StaticData(x=torch.zeros(10, 1, 1), y=torch.arange(10) % 2)
        >>> [len(part) for part in Protocol("frame").split(data)]
        [7, 1, 2]
        >>> protocol = Protocol("frame", folds=5, stratify="y")
        >>> protocol.describe()
        '5 folds by frame, stratified by y'
        >>> [data.y[protocol.split(data, fold=i).test].bincount().tolist() for i in range(2)]
        [[1, 1], [1, 1]]
    """

    by: Unit = "trial"
    _: KW_ONLY
    val: float | None = None
    test: float | None = None
    folds: int | None = None
    leave_one_out: bool = False
    stratify: str | None = None
    unseen: str | None = None

    def __post_init__(self) -> None:
        if not isinstance(self.by, str) or not self.by:
            raise ArgumentError(
                Argument("by"),
                " must be 'frame', 'given' or the name of a unit, such as 'trial' (got "
                f"{self.by!r})",
            )
        if self.by == "given":
            for field in fields(self)[1:]:
                if getattr(self, field.name) != field.default:
                    raise ValueError(
                        f"'{field.name}' must be left out with by='given' (got "
                        f"{getattr(self, field.name)})"
                    )
            return
        if self.folds is not None and self.folds < 2:
            raise ArgumentError(Argument("folds"), f" must be at least 2 (got {self.folds})")
        if self.folds is not None and self.leave_one_out:
            raise ArgumentError(
                Argument("folds"), f" must be None with 'leave_one_out' (got {self.folds})"
            )
        if self.stratify is not None and self.leave_one_out:
            raise ValueError(f"'stratify' must be None with 'leave_one_out' (got {self.stratify})")
        if self.unseen is not None and not self._has_folds:
            raise ValueError(f"'unseen' must be None without folds (got '{self.unseen}')")
        if self.test is not None and self._has_folds:
            raise ValueError(f"'test' must be None with folds (got {self.test})")
        val = (0.0 if self._has_folds else 0.1) if self.val is None else self.val
        test = (0.0 if self._has_folds else 0.2) if self.test is None else self.test
        for name, part in (("val", val), ("test", test), ("val + test", val + test)):
            if not 0 <= part < 1:
                raise ArgumentError(Argument(name), f" must be at least 0 and below 1 (got {part})")
        object.__setattr__(self, "val", float(val))
        object.__setattr__(self, "test", None if self._has_folds else float(test))

    @property
    def _has_folds(self) -> bool:
        return self.leave_one_out or self.folds is not None

    @property
    def has_test(self) -> bool:
        r"""Whether :meth:`split` holds out a test part."""
        return self.by == "given" or self._has_folds or bool(self.test)

    def num_folds(self, dataset: Samples) -> int:
        r"""Returns the number of splits that test on different samples: 1 without folds.

        Args:
            dataset (Dataset or StaticData or list of Data): The samples, as in :meth:`split`.

        Raises:
            ValueError: If there are fewer than two units to leave out, the samples lack the
                attribute by which they are split, or :obj:`unseen` has fewer than two values.
        """
        dataset = as_samples(dataset)
        count = self._num_unit_folds(dataset)
        return count if self.unseen is None else count * len(_unseen_values(dataset, self.unseen))

    def _num_unit_folds(self, dataset: Samples) -> int:
        if not self.leave_one_out:
            return self.folds or 1
        units = _split_column(dataset, self.by)
        count = len(np.unique(units))
        need(count >= 2, f"'dataset' must have at least 2 {self.by}s to leave one out", count)
        return count

    def split(self, dataset: Samples, seed: int = 0, fold: int = 0) -> Split:
        r"""Returns the indices of the samples to train, validate and test on.

        Args:
            dataset (Dataset or StaticData or list of Data): The samples: a data set of PyG, a
                :class:`~torch.utils.data.Subset`, a :class:`~torch.utils.data.ConcatDataset` or a
                list. They may come from different sensors. The attribute by which they are split
                must be a number or a text in each sample.
            seed (int): Selects one of the random splits.
            fold (int): Index of the fold to test on, below :meth:`num_folds`.

        Raises:
            TypeError: If :obj:`dataset` does not hold samples of PyG.
            ValueError: If overlapping windows are split by frame, there is no such fold, the
                samples lack an attribute by which they are split or stratified, there are fewer
                units than folds, a part with a fraction above 0 would be empty, or the split cannot
                be stratified by the classes.

        Warns:
            UserWarning: If ``by="given"``, but the data set was built with only one of its parts.
            SharedDataWarning: If the parts of ``by="given"`` share a trial, or different parts have
                copies of a recording.
        """
        dataset = as_samples(dataset)
        if self.by == "frame" and isinstance(dataset, Windows) and dataset.overlap:
            raise ValueError(
                "overlapping windows must be split by trial, group or session, since otherwise "
                f"the training and the test part share frames (got 'frame', with windows "
                f"of {dataset.length} frames, one every {dataset.hop}); or use hop="
                f"{dataset.length}"
            )
        split = self._split(dataset, seed, fold)
        # A split by frame distributes the frames of a trial over the parts on purpose.
        if self.by != "frame" or sample_column(dataset, "trial") is None:
            warn_of_shared(dataset, split, with_units=self.by == "given")
        return split

    def _split(self, dataset: Samples, seed: int, fold: int) -> Split:
        num_folds = self.num_folds(dataset)
        need(0 <= fold < num_folds, f"'fold' must be between 0 and {num_folds - 1}", fold)
        if self.by == "given":
            parts = _given_parts(dataset)
            selected = dataset_part(dataset)
            if selected is not None and len(np.unique(parts)) == 1:
                warnings.warn(
                    f"the data set holds only its part '{selected}' and cannot be split: build it "
                    "with split=None, which uses all samples",
                    stacklevel=4,
                )
            return _parts_to_split(parts)
        if self.unseen is not None:
            values = _unseen_values(dataset, self.unseen)
            fold, number = divmod(fold, len(values))
            is_unseen = _split_column(dataset, self.unseen, "unseen") == values[number]
            part = self._parts(dataset, seed, fold)
            # Samples of the tested units in other sessions, and samples of other units in the
            # tested session, belong to no part.
            part = np.where((part == _TEST) == is_unseen, part, _NONE)
            if not (part == _TEST).any():
                raise ValueError(
                    f"'dataset' must have samples of '{self.unseen}' {values[number]} in each "
                    f"fold (got none in fold {fold})"
                )
            return _parts_to_split(part)
        return _parts_to_split(self._parts(dataset, seed, fold))

    def _parts(self, dataset: Samples, seed: int, fold: int) -> np.ndarray:
        names, unit = np.unique(_split_column(dataset, self.by), return_inverse=True)
        units = np.arange(len(names))
        if self.stratify == "auto":
            classes = _label_classes(dataset, unit, self.by, self.folds or 2 + bool(self.val))
        else:
            key = self.stratify
            classes = None if key is None else _Classes(dataset, key, unit, self.by)
        part = np.full(len(names), _TRAIN)
        seeds = [seed]
        if self._has_folds:
            if self.folds is None:
                held_out = units[fold : fold + 1]
            else:
                held_out = _Folds(self.folds, self.by).draw(unit, classes, seed, fold)
            part[held_out] = _TEST
            units = np.setdiff1d(units, held_out)
            seeds = [seed, fold]
        if self.val or not self._has_folds:
            fractions = _Fractions(self.val or 0.0, self.test or 0.0, self.by)
            val, test = fractions.draw(units, classes, seeds)
            part[val], part[test] = _VAL, _TEST
        parts: np.ndarray = part[unit]
        return parts

    def describe(self) -> str:
        r"""Returns a description of the protocol in words, for captions.

        Examples:
            >>> Protocol("group", folds=5).describe()
            '5 folds by group'
            >>> Protocol("trial", val=0, test=0.3, stratify="group").describe()
            'by trial, 30 % for the test, stratified by group'
        """
        if self.by == "given":
            return "the given parts"
        if self.leave_one_out:
            text = f"leave one {self.by} out"
        elif self.folds is not None:
            text = f"{self.folds} folds by {self.by}"
        else:
            text = f"by {self.by}"
        if self.unseen is not None:
            text += f", each {self.unseen} tested on unseen"
        if self.val:
            text += f", {100 * self.val:g} % for validation"
        if self.test:
            text += f", {100 * self.test:g} % for the test"
        if self.stratify == "auto":
            return f"{text}, stratified by class where classes allow"
        return text if self.stratify is None else f"{text}, stratified by {self.stratify}"

    def to_dict(self) -> dict[str, Any]:
        r"""Returns the arguments as JSON values; equal protocols have equal values."""
        return asdict(self)

    @classmethod
    def from_dict(cls, content: Mapping[str, Any]) -> Self:
        r"""Builds a protocol from the output of :meth:`to_dict`.

        Args:
            content (Mapping): The arguments.

        Raises:
            ValueError: If a key is not an argument, or an argument is invalid.
        """
        names = [field.name for field in fields(cls)]
        unknown = [key for key in content if key not in names]
        if unknown:
            raise ValueError(f"a protocol must have keys of {names} (got '{unknown[0]}')")
        return cls(**content)


def _unseen_values(dataset: Samples, key: str) -> np.ndarray:
    values = np.unique(_split_column(dataset, key, "unseen"))
    if len(values) < 2:
        raise ValueError(
            f"'dataset' must have at least 2 values of '{key}' to leave one out (got {len(values)})"
        )
    return values


def _given_parts(dataset: Samples) -> np.ndarray:
    part = getattr(dataset, "part", None)
    if part is None and isinstance(dataset, StaticDataset | GraphSamples):
        part = dataset.column("part")
    if part is None:
        raise ValueError(
            "'dataset' must have a 'part' for each sample with by='given': 0 for training, 1 for "
            "validation and 2 for the test (got none)"
        )
    parts: np.ndarray = torch.as_tensor(part).numpy(force=True)
    if not np.isin(parts, (_TRAIN, _VAL, _TEST)).all():
        raise ValueError(f"'part' must hold 0, 1 and 2 (got {np.unique(parts).tolist()})")
    return parts


def _parts_to_split(part: np.ndarray) -> Split:
    return Split(*(torch.from_numpy(np.flatnonzero(part == i)) for i in (_TRAIN, _VAL, _TEST)))


class _Classes:
    r"""The classes by which a split is stratified: one class for each sample and, if all samples of
    each unit have one class, one for each unit.

    Args:
        dataset (Dataset or StaticData): The samples.
        key (str): The attribute whose values are the classes.
        unit (numpy.ndarray): The index of the unit of each sample :math:`(S,)`.
        by (str): Name of the units, such as :obj:`"trial"`.

    Raises:
        ValueError: If the samples lack the attribute, or it does not hold integers.
    """

    def __init__(self, dataset: Samples, key: str, unit: np.ndarray, by: str) -> None:
        value = _split_column(dataset, key, "stratify")
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
        r"""Checks the number of folds, and warns about classes that cannot be in every fold.

        Raises:
            ArgumentError: If there are more folds than units of the most frequent class.
        """
        if self.unit_class is not None and folds > self.num_units.max():
            raise ArgumentError(
                Argument("folds"),
                f" must be at most {self.num_units.max()} to be stratified by '{self.key}', the "
                f"number of {self.by}s of the most frequent {self.kind} (got {folds})",
            )
        rare_classes = [
            f"'{name}' ({count})"
            for name, count in zip(self.names, self.num_units, strict=True)
            if count < folds
        ]
        if rare_classes:
            warnings.warn(
                f"some of the {folds} folds will lack a {self.kind}, since these have fewer "
                f"{self.by}s than folds: {', '.join(rare_classes)}",
                UserWarning,
                stacklevel=5,
            )


def _label_classes(dataset: Samples, unit: np.ndarray, by: str, min_units: int) -> _Classes | None:
    r"""Returns the classes of :obj:`y`, or :obj:`None` if a split cannot be stratified by them
    because a class has fewer than :obj:`min_units` units or a unit has several classes.

    Shapes:
        - **unit:** The index of the unit of each sample :math:`(S,)`.
    """
    try:
        classes = _Classes(dataset, "y", unit, by)
    except ValueError:  # no labels, or real numbers as targets of a regression
        return None
    is_usable = (
        classes.unit_class is not None and classes.num_units.min(initial=min_units) >= min_units
    )
    return classes if is_usable else None


def _class_names(dataset: Samples, key: str, class_values: np.ndarray) -> list[str]:
    names = unit_names(dataset, key)
    if class_values.ndim > 1 or (
        len(class_values) and not 0 <= class_values.min() <= class_values.max() < len(names)
    ):
        return [str(value) for value in class_values.tolist()]
    return [names[i] for i in class_values]


def _split_column(dataset: Samples, key: str, argument: str = "by") -> np.ndarray:
    r"""Returns the units by which samples are split, or their indices for :obj:`"frame"`.

    Args:
        dataset (Dataset or StaticData): The samples.
        key (str): Name of the units.
        argument (str): The argument of :class:`Protocol` that has this name.

    Raises:
        ValueError: If the samples lack these units. The message lists the units that they have.
    """
    if key == "frame":
        return np.arange(len(dataset))  # type: ignore[arg-type]  # checked by `as_samples`
    if argument == "by":
        column: Tensor | None = require_units(dataset, key)
    else:
        column = unit_column(dataset, key)
    if column is None:
        raise missing_unit(dataset, key, argument)
    values: np.ndarray = column.numpy(force=True)
    return values


@dataclass(frozen=True)
class _Folds:
    r"""Random folds of units."""

    count: int
    by: str

    def draw(self, unit: np.ndarray, classes: _Classes | None, seed: int, fold: int) -> np.ndarray:
        r"""Draws the folds and returns the units of one of them.

        Args:
            unit (numpy.ndarray): The index of the unit of each sample :math:`(S,)`.
            classes (_Classes, optional): The classes by which the folds are stratified.
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
class _Fractions:
    r"""Random fractions of units, held out for validation and for the test."""

    val: float
    test: float
    by: str

    def draw(
        self, units: np.ndarray, classes: _Classes | None, seeds: Sequence[int]
    ) -> tuple[np.ndarray, np.ndarray]:
        r"""Draws the units for validation and for the test.

        Args:
            units (numpy.ndarray): The indices of the units to draw from :math:`(U,)`.
            classes (_Classes, optional): The classes by which the parts are stratified.
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
        self, units: np.ndarray, classes: _Classes, seeds: Sequence[int]
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
        # Reduces the numbers, validation first, until one unit is left to train on.
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
