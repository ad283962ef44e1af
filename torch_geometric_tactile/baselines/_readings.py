r"""Converts and checks readings, and defines the base class of estimators that take readings."""

from typing import Any

import numpy as np
from sklearn.base import BaseEstimator
from sklearn.utils import Tags
from torch import Tensor

from torch_geometric_tactile.data import StaticData


class ReadingsEstimator(BaseEstimator):
    r"""The base class of estimators with three-dimensional input. A subclass that accepts missing
    readings (NaN) sets :obj:`_allows_nan`.
    """

    _allows_nan = False

    def __sklearn_tags__(self) -> Tags:
        tags = super().__sklearn_tags__()
        tags.input_tags.two_d_array, tags.input_tags.three_d_array = False, True
        tags.input_tags.allow_nan = self._allows_nan
        return tags


def readings(x: Any) -> np.ndarray:
    r"""Returns readings as an array, from samples or an array-like object.

    Shapes:
        - **output:** :math:`(S, N, F)`

    Raises:
        ValueError: If the readings do not have three dimensions.
    """
    array = x.x if isinstance(x, StaticData) else x
    values = np.asarray(array.numpy(force=True) if isinstance(array, Tensor) else array)
    if values.ndim != 3:
        raise ValueError(
            f"'x' must have shape (num_samples, num_taxels, num_channels) (got {values.shape})"
        )
    return values


def check_finite(values: np.ndarray, name: str) -> None:
    r"""Checks that no reading is missing or infinite.

    Args:
        values (numpy.ndarray): Readings :math:`(S, ...)`.
        name (str): Name of the argument, for the error message.

    Raises:
        ValueError: If a reading is NaN or infinite.
    """
    is_finite = np.isfinite(values)
    if is_finite.all():
        return
    num_missing = int(np.isnan(values).sum())
    rows = np.flatnonzero(~is_finite.reshape(len(values), -1).all(axis=1))
    num_infinite = int((~is_finite).sum()) - num_missing
    raise ValueError(
        f"'{name}' must hold finite readings only (got {num_missing} NaN and {num_infinite} "
        f"infinite in {len(rows)} of {len(values)} rows, the first is {rows[0]}); fill missing "
        "readings with FillMissing() first"
    )


def num_repeats(num_readings: int, num_descriptors: int) -> int:
    r"""Returns how many copies of the descriptors are needed so that they are about as many as the
    readings.
    """
    return max(1, round(num_readings / num_descriptors))
