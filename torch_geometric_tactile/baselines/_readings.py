r"""Readings as arrays, what they must be, and the base of estimators that take them."""

from typing import Any

import numpy as np
from sklearn.base import BaseEstimator
from sklearn.utils import Tags
from torch import Tensor

from torch_geometric_tactile.data import StaticData


class TakesReadings(BaseEstimator):
    r"""The base of estimators whose input has three dimensions, and may lack readings (NaN) if they
    say so.
    """

    _allows_nan = False

    def __sklearn_tags__(self) -> Tags:
        tags = super().__sklearn_tags__()
        tags.input_tags.two_d_array, tags.input_tags.three_d_array = False, True
        tags.input_tags.allow_nan = self._allows_nan
        return tags


def readings(x: Any) -> np.ndarray:
    r"""Returns readings as an array of :math:`(S, N, F)`."""
    given = x.x if isinstance(x, StaticData) else x
    values = np.asarray(given.numpy(force=True) if isinstance(given, Tensor) else given)
    if values.ndim != 3:
        raise ValueError(
            f"'x' must have shape (num_samples, num_taxels, num_channels) (got {values.shape})"
        )
    return values


def check_finite(values: np.ndarray, name: str) -> None:
    r"""Checks that no reading is missing or infinite.

    Shapes:
        - **values:** The readings :math:`(S, ...)`.
    """
    finite = np.isfinite(values)
    if finite.all():
        return
    missing = int(np.isnan(values).sum())
    rows = np.flatnonzero(~finite.reshape(len(values), -1).all(axis=1))
    infinite = int((~finite).sum()) - missing
    raise ValueError(
        f"'{name}' must hold finite readings only (got {missing} NaN and {infinite} infinite in "
        f"{len(rows)} of {len(values)} rows, the first is {rows[0]}); fill missing ones with "
        "FillMissing() before"
    )


def num_repeats(num_readings: int, num_descriptors: int) -> int:
    r"""Returns how often descriptors are repeated to be about as many as the readings."""
    return max(1, round(num_readings / num_descriptors))
