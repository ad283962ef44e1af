r"""The random draws of a split: which units a fold tests on, and which fractions hold out."""

import warnings
import zlib
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from torch_geometric_tactile.data._sample_classes import Classes


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
            raise ValueError(
                f"'folds' must be between 2 and the {num_units} {self.by}s there are "
                f"(got {self.count})"
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
                raise ValueError(f"'{name}' of {part} leaves nothing of {count} {self.by}s")
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
